"""What highway-env itself says of failures that the compiled engine has found, beside the records.

A record and its trace are always the engine's. highway-env takes a hundred times as long for an episode, so only the
first failures of each class are confirmed, once the search has ended, and another one when it is replayed. What comes
out is a file of its own. It changes neither a record nor a decision of the search.
"""

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np

from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.record import Record
from behavexplor.data.durable import make_folder, write_durably
from behavexplor.data.trace import Trace
from behavexplor.data.untrusted import read_file
from behavexplor.data.validation import checked
from behavexplor.errors import sentence

FOLDER: Final = "confirmations"  # in a run folder
OF_EACH_CLASS: Final = 3  # failures that are confirmed without being asked for
TOLERANCE: Final = 0.1  # greatest difference of equal motions [m]: it begins in the last bit, and traffic amplifies it
_LONGEST: Final = 10_000  # [bytes]
_ENDED: Final = ("hang", "crash")  # kinds of errors that end a process, and say nothing of an engine


@dataclass(frozen=True)
class Confirmation:
    """What came out when highway-env itself executed the scenario of a failure."""

    # "confirmed"; "disagrees", an error of this package; or "changes" if the driver or the environment does not do the
    # same twice
    state: Literal["confirmed", "disagrees", "changes"]
    words: str = ""  # how the two executions differ; empty if they do not

    def said_of(self, number: int) -> str:
        """Return a sentence on the failure in an execution of that number."""
        if self.state == "confirmed":
            return f"highway-env itself confirms the failure in execution {number}."
        ours = "an error of behavexplor and not of the driver" if self.state == "disagrees" else "not repeatable"
        what = f"highway-env does not confirm the failure in execution {number}, which is {ours}"
        return f"{what}: {sentence(self.words)}"


def unconfirmed(config: CampaignConfig, run: Path, records: Iterable[Record]) -> list[int]:
    """Return the numbers of the failures that are to be confirmed without being asked for, and have not been tried."""
    seen: Counter[str | None] = Counter()
    chosen = []
    for record in records if config.confirm else ():
        if record.failed and seen[record.violation_class] < OF_EACH_CLASS and can_be_confirmed(record):
            seen[record.violation_class] += 1
            chosen.append(record.id)
    tried = read_confirmations(run) if chosen else {}
    return [number for number in chosen if number not in tried]


def can_be_confirmed(record: Record) -> bool:
    """Return whether an execution is a failure in one of highway-env's environments that can be repeated there."""
    kind = (record.error or {}).get("kind")
    return record.failed and kind not in _ENDED and record.load_scenario().has_original


def difference(recorded: Trace | Mapping[str, str], other: Trace | Mapping[str, str]) -> str | None:
    """Return how an execution in highway-env differs from the recorded one; None if not. Failures are as in records."""
    if not (isinstance(recorded, Trace) and isinstance(other, Trace)):
        kinds = [None if isinstance(one, Trace) else one["kind"] for one in (recorded, other)]
        words = [one["message"] for one in (recorded, other) if not isinstance(one, Trace)]
        return None if kinds[0] == kinds[1] else f"the driver failed in only one of them, or in another way: {words[0]}"
    for name in ("end", "partner"):
        values = getattr(recorded, name), getattr(other, name)
        if values[0] != values[1]:
            return f"{name} is {values[0]!r}, and {values[1]!r} in highway-env"
    shapes = recorded.position.shape[:2], other.position.shape[:2]
    if shapes[0] != shapes[1]:
        return f"{shapes[0]} frames and vehicles, and {shapes[1]} in highway-env"
    apart = float(np.abs(recorded.position - other.position).max())
    return f"the vehicles are up to {apart:.3g} m apart" if apart > TOLERANCE else None


def keep(run: Path, number: int, found: Confirmation) -> None:
    """Write a confirmation into a run folder.

    Raises:
        OSError: if the folder cannot be written.
    """
    write_durably(make_folder(run, FOLDER) / f"{number:06d}.json", json.dumps(asdict(found)) + "\n")


def read_confirmations(run: Path) -> dict[int, Confirmation]:
    """Return the confirmations in a run folder by the numbers of their executions, without damaged ones."""
    found = {}
    for path in sorted((run / FOLDER).glob("*.json")):
        try:
            values = json.loads(read_file(path, _LONGEST))
            found[int(path.stem)] = checked(Confirmation, values if isinstance(values, dict) else {}, str(path))
        except (OSError, ValueError, RecursionError):
            continue
    return found


def not_confirmed(found: Mapping[int, Confirmation]) -> list[str]:
    """Return a sentence on each failure that highway-env did not confirm."""
    return [one.said_of(number) for number, one in found.items() if one.state != "confirmed"]
