"""What a campaign tests: digests of its files, which the run folder keeps, so that another driver is noticed."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Final, Self

from behavexplor.campaign.store import Store
from behavexplor.data.untrusted import parse_json

NOTE: Final = "driver"  # name of the note in the store


@dataclass(frozen=True)
class Identity:
    """The files and libraries that decide how a driving system drives in a campaign."""

    digests: Mapping[str, str] = field(default_factory=dict)  # SHA-256 of the files of policy and named code, by name
    libraries: Mapping[str, str] = field(default_factory=dict)  # versions of libraries that compute results, by name
    folder: str = ""  # working directory when the campaign began, to which the path of a policy is relative

    @classmethod
    def from_json(cls, text: bytes) -> Self | None:
        """Return a stored identity; None if there is none, or it cannot be read."""
        try:
            values = parse_json(text.decode(), "the identity of the driver")
            return cls(dict(values["digests"]), dict(values["libraries"]), str(values["folder"]))
        except (ValueError, KeyError, TypeError):
            return None

    def to_json(self) -> str:
        """Return this identity as JSON, for `from_json`."""
        return json.dumps(asdict(self))


def changes(before: Mapping[str, str], now: Mapping[str, str]) -> str:
    """Return which digests have gone, come or changed, in words; empty if none has."""
    names = sorted(name for name in {*before, *now} if before.get(name) != now.get(name))
    return " and ".join(f"{name} ({_shown(before.get(name))}, now {_shown(now.get(name))})" for name in names)


def _shown(digest: str | None) -> str:
    return "no such file" if digest is None else f"SHA-256 {digest[:12]}..."


def begun_with(store: Store) -> Identity | None:
    """Return what a campaign tested when it began; None if that is not known."""
    return Identity.from_json(store.note(NOTE))
