"""Permission to run the code that a folder names: the user gives it now, or this machine has made the folder.

Run folders, suites and retrainings name drivers, environments, specs and search methods by the modules to import. They
also say which pickles may be executed and whether a driver is confined. All of this goes through `agreed` before
anything is imported; `accepted` does it for runs. What a user types on the command line, or passes to a function, is
the user's own word.
"""

import hashlib
import json
import os
import stat
import sys
import warnings
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from platformdirs import user_state_path

from behavexplor.ads.loading import IN_MEMORY, is_shipped
from behavexplor.ads.sb3.archive import MAX_BYTES
from behavexplor.ads.sb3.description import files_of_model, is_policy
from behavexplor.campaign.config import CampaignConfig, StoredConfig, campaign_config
from behavexplor.campaign.folder_format import CONFIG
from behavexplor.data.named_code import Code, attribute_code, env_code, traffic_code
from behavexplor.data.target import CheckedTarget, check_digests
from behavexplor.data.untrusted import parse_yaml, read_file
from behavexplor.errors import InputError
from behavexplor.execution.checked_imports import digests_of, import_checked, source_files
from behavexplor.fuzz.methods import SHIPPED

ADS, ENV, ENV_CONFIG, METHOD, SPECS = "ads", "env", "env_config", "method", "specs"  # keys that may name code
# the keys of the code that is run
DRIVING: Final = frozenset({ADS, ENV, ENV_CONFIG})  # to drive
JUDGED: Final = DRIVING | {SPECS}  # to drive and judge
ALL: Final = JUDGED | {METHOD}  # to search, too
_IN_WORKERS: Final = JUDGED  # what a process imports that executes scenarios
_HERE: Final = ALL - {ADS}  # what this process imports
NAME: Final = "own-folders"  # file with the list of the digests of folders that this machine has made
_FLAGS: Final = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0)


@dataclass(frozen=True)
class Consent:
    """What the user agrees to on this command line, or in this call.

    Raises:
        InputError: if a digest has a wrong form.
    """

    trust: tuple[str, ...] = ()  # digests ("sha256:...") of folders and of policy files
    unconfined: bool = False  # whether drivers may write files and use the network
    names: tuple[str, ...] = ()  # names of code that the user has given, such as "my_driver:MyDriver"

    def __post_init__(self) -> None:
        check_digests(self.trust)


@dataclass(frozen=True)
class Claim:
    """What a folder says that may have code run."""

    place: Path  # the file that says it
    values: Mapping[str, Any]  # the whole configuration as plain values, of which digests are made
    code: tuple[Code, ...]
    policy: str = ""  # name of the driver. If it is a policy file, this file is part of the digests.
    asks: bool = False  # whether it says something of trust or confinement
    hint: str = ""  # another way to agree, for the message

    def digests(self, *parts: Sequence[Code]) -> tuple[dict[str, str], list[str]]:
        """Return the digests of the modules, and for each part of the code the folder's as if it had only this."""
        modules = digests_of(one.module for one in self.code)
        files = files_of_model(self.policy)
        read = [(path.name, hashlib.sha256(read_file(path, MAX_BYTES)).hexdigest()) for path in files]
        return modules, [digest_of(self.values, _named_by(modules, part), read) for part in parts]


@dataclass(frozen=True)
class Permission:
    """What may be done as a folder says."""

    is_own: bool = False  # whether what the folder says of trust and confinement counts
    modules: Mapping[str, str] = field(default_factory=dict)  # digests of the named modules that workers import
    digests: tuple[str, ...] = ()  # digests of the folder, where they were needed


@dataclass(frozen=True)
class AcceptedConfig(CampaignConfig):
    """The configuration of a run folder, by which something may be executed; `accepted` makes it."""

    modules: Mapping[str, str] = field(default_factory=dict)  # see `Permission.modules`

    @property
    def target(self) -> CheckedTarget:
        """The driving system and its environment, with the modules that were checked."""
        return replace(super().target, modules=self.modules)


def digest_of(values: Mapping[str, Any], modules: Mapping[str, str], policy: Sequence[tuple[str, str]] = ()) -> str:
    """Return the digest "sha256:..." of a configuration as plain values, and of files by their names and digests."""
    text = json.dumps([values, modules, policy], sort_keys=True, default=str)
    return f"sha256:{hashlib.sha256(text.encode()).hexdigest()}"


def agreed(claim: Claim, consent: Consent = Consent(), runs: Collection[str] = ALL) -> Permission:
    """Check that the code that a folder names by the keys `runs` may be run, and import what this process needs of it.

    Raises:
        InputError: if something would be run that the user has not agreed to; the message says what, and how to agree.
    """
    left = [one for one in claim.code if one.name not in consent.names and (one.key != ADS or ADS in runs)]
    running = [one for one in left if one.key in runs]
    asks = claim.asks and ADS in runs
    if not running and not asks:
        return Permission()
    # a folder is known by all its code, or by what is left where the user has named some or the driver is not run
    modules, digests = claim.digests(claim.code, left)
    if any(digest in consent.trust or is_own(digest) for digest in digests):
        import_checked(_named_by(modules, [one for one in running if one.key in _HERE]))
        return Permission(True, _named_by(modules, [one for one in running if one.key in _IN_WORKERS]), tuple(digests))
    if running:
        raise _refusal(claim, running, digests[-1])
    return Permission(digests=tuple(digests))


def accepted(stored: StoredConfig, consent: Consent = Consent(), runs: Collection[str] = ALL) -> AcceptedConfig:
    """Return the configuration of a run folder, by which something may be executed.

    What the folder says of trust and confinement counts only if this machine has made it, or if the user trusts it.
    """
    config = stored.unverified
    found = agreed(claim_of(config, stored.folder / CONFIG), consent, runs)
    trust = tuple(digest for digest in consent.trust if digest not in found.digests)
    values = config.stated()
    values["trust"] = tuple(dict.fromkeys((*config.trust, *trust))) if found.is_own else trust
    values["unconfined"] = consent.unconfined or (found.is_own and config.unconfined)
    return AcceptedConfig(**values, modules=found.modules)


def claim_of(config: CampaignConfig, place: Path) -> Claim:
    """Return what a campaign's configuration says that may have code run; not its budget, which may change later."""
    usual = CampaignConfig().stated() | {"budget": config.budget}
    values = {name: value for name, value in config.stated().items() if value != usual[name]}
    code = code_of(config.env, config.ads, config.method, config.specs, config.env_config)
    asks = bool(config.trust or config.unconfined) and not is_shipped(config.ads)
    return Claim(place, {**values, "revision": config.revision}, code, config.ads, asks)


def code_of(
    env: str, ads: str = "", method: str = "", specs: Sequence[str] = (), env_config: Mapping[str, Any] | None = None
) -> tuple[Code, ...]:
    """Return the code that the values of a configuration name; see `behavexplor.campaign.config.CampaignConfig`."""
    is_module = ":" in ads and not (is_shipped(ads) or is_policy(ads))
    return (
        *(attribute_code(ADS, ads) if is_module and ads.partition(":")[0] != IN_MEMORY else ()),
        *env_code(env),
        *(attribute_code(METHOD, method) if method and method not in SHIPPED else ()),
        *(one for spec in specs for one in attribute_code(SPECS, spec)),
        *traffic_code(env_config),
    )


def own_run(config: CampaignConfig, folder: Path) -> tuple[str, ...]:
    """Return the digests by which a run folder will be known as this machine's; see `own_digests`."""
    as_read = campaign_config(parse_yaml(config.to_yaml()))
    return own_digests(claim_of(as_read, folder / CONFIG))


def own_digests(claim: Claim) -> tuple[str, ...]:
    """Return the digests by which a folder will be known as this machine's: with its driver, and without it.

    The latter counts where the user names the driver. Campaigns and retrainings take them before any code is run. A
    folder that brings no code needs none.
    """
    if not (claim.code or claim.asks):
        return ()
    return tuple(claim.digests(claim.code, [one for one in claim.code if one.key != ADS])[1])


def remember(digests: Iterable[str]) -> None:
    """Write durably that a folder is this machine's, so that it can be continued. Warn if that is not possible.

    A new folder is remembered before it is filled, so that a crash leaves none that is not.
    """
    try:
        for digest in dict.fromkeys(digests):
            add_own(digest)
    except OSError as error:
        why = f"{list_path()} cannot be written ({error.strerror or error})"
        warnings.warn(f"{why}, so to continue here, the folder will have to be trusted", stacklevel=3)


def _named_by(modules: Mapping[str, str], code: Iterable[Code]) -> dict[str, str]:
    """Return the digests of the modules of code, and of their packages."""
    inside = tuple(f"{one.module}." for one in code)
    return {name: digest for name, digest in modules.items() if any(one.startswith(f"{name}.") for one in inside)}


def _refusal(claim: Claim, running: Sequence[Code], digest: str) -> InputError:
    roots = {one.module.partition(".")[0]: one for one in running}
    for root, code in roots.items():
        if root and root not in sys.modules and find_spec(root) is None:
            return InputError(
                f"{claim.place} names {code}, but there is no module {root} here: call this in the folder that holds "
                "it, or add that folder to PYTHONPATH"
            )
    listed = " and ".join(f"{one}{_place(one)}" for one in running)
    hint = claim.hint if any(one.key == ADS for one in running) else ""
    return InputError(
        f"{claim.place} would have {listed} run, but this machine has not made this folder, or it has changed since: "
        f"if you trust it, add --trust {digest} (in Python, trust){hint}"
    )


def _place(code: Code) -> str:
    """Return where code is, for messages."""
    path = source_files(code.module).get(code.module)
    return "" if path is None else f" from {path}"


def list_path() -> Path:
    """Return the path of the list: on Linux, in $XDG_STATE_HOME or ~/.local/state."""
    return user_state_path("behavexplor") / NAME


def is_own(digest: str) -> bool:
    """Return whether a digest is in the list. A list that other users may have written does not count."""
    try:
        file = os.open(list_path(), os.O_RDONLY | _FLAGS)
    except OSError:
        return False
    with os.fdopen(file, "rb") as lines:
        return _is_users(os.fstat(lines.fileno())) and digest.encode() in lines.read().split()


def add_own(digest: str) -> None:
    """Add a digest to the list, and flush it to disk. Several processes may do so at a time.

    Raises:
        OSError: if the list cannot be written.
    """
    if is_own(digest):
        return
    path = list_path()
    if not path.is_absolute():  # without a home folder
        raise FileNotFoundError(f"there is no folder for {path}")
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    is_new = not path.exists()
    file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | _FLAGS, 0o600)
    try:
        os.write(file, f"\n{digest}\n".encode())  # the first newline ends what a crash may have cut off
        os.fsync(file)
    finally:
        os.close(file)
    if is_new:
        _flush_folder(path.parent)


def _is_users(status: os.stat_result) -> bool:
    if not hasattr(os, "getuid"):  # Windows keeps other users out of a user's folder
        return True
    return status.st_uid == os.getuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _flush_folder(folder: Path) -> None:
    """Flush the names of a folder to disk, where the system can."""
    if hasattr(os, "O_DIRECTORY"):
        file = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(file)
        finally:
            os.close(file)
