"""Checks that a run's driver and other code have not changed since it began, and returns its configuration."""

import hashlib
import warnings
from collections.abc import Collection, Iterable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Final

from behavexplor.ads.sb3.archive import MAX_BYTES
from behavexplor.ads.sb3.description import files_of_model
from behavexplor.campaign.config import CampaignConfig, stored_config
from behavexplor.campaign.identity import NOTE, Identity, begun_with, changes
from behavexplor.campaign.provenance import ADS, AcceptedConfig, Consent, accepted, code_of
from behavexplor.campaign.store import Store
from behavexplor.data.named_code import Code
from behavexplor.data.untrusted import read_file
from behavexplor.errors import InputError
from behavexplor.execution.checked_imports import digests_of
from behavexplor.execution.fingerprint import library_versions

MODULE: Final = "module "  # begins the names of digests of modules


def identity_of(config: CampaignConfig) -> Identity:
    """Return the identity of what a campaign tests now.

    Raises:
        InputError: if a file cannot be read.
    """
    code = code_of(config.env, config.ads, config.method, config.specs, config.env_config)
    return Identity(driver_digests(config.ads, code), library_versions(), str(Path.cwd()))


def driver_digests(ads: str, code: Iterable[Code]) -> dict[str, str]:
    """Return SHA-256 of the files of a policy, and of the modules of code that is named beside it, by name.

    Raises:
        InputError: if a file cannot be read.
    """
    path = Path(ads)
    files = [path] if path.is_file() and path.suffix == ".npz" else files_of_model(ads)
    try:
        found = {one.name: hashlib.sha256(read_file(one, MAX_BYTES)).hexdigest() for one in files}
    except OSError as error:
        raise InputError(f"{error.filename} cannot be read: {error.strerror}") from None
    modules = digests_of(one.module for one in code)
    return found | {f"{MODULE}{name}": digest for name, digest in modules.items()}


def check_identity(store: Store, now: Identity) -> None:
    """Keep what a campaign tests in its store, or compare it with what is kept there.

    Raises:
        InputError: if that is something else now.
    """
    begun = begun_with(store)
    if begun is None:
        store.add_note(NOTE, now.to_json())
    elif changed := changes(begun.digests, now.digests):
        raise _cannot_go_on(store.folder, changed)


def accepted_run(run: Path, consent: Consent, runs: Collection[str], *, goes_on: bool = False) -> AcceptedConfig:
    """Return the configuration of a run, by which something may be executed.

    A policy's path is also looked for in the directory where the run began. If the driver or other code has changed
    since then, a warning is issued; a campaign that `goes_on` is refused. `runs` are keys of the code that would be
    run, see `behavexplor.campaign.provenance.accepted`.

    Raises:
        InputError: see `behavexplor.campaign.provenance.accepted`; also if the file of its policy has gone, or the
            campaign would go on with other code.
    """
    stored = stored_config(run)
    try:
        config = accepted(stored, consent, runs)
    except InputError as refusal:
        raise _refused(refusal, run, stored.unverified, goes_on=goes_on) from None
    begun = _identity_at_start(run) if ADS in runs else None
    if begun is None:
        return config
    config = replace(config, ads=_name_from_here(config, begun))
    changed = changes(begun.digests, identity_of(config).digests)
    if changed and goes_on:
        raise _cannot_go_on(run, changed)
    if changed:
        warnings.warn(f"The driver or other code is not that with which {run} began: {changed}", stacklevel=3)
    return config


def _identity_at_start(run: Path) -> Identity | None:
    """Return what a run tested when it began; None if that is not known, as in a damaged folder."""
    try:
        with closing(Store.read(run)) as store:
            return begun_with(store)
    except InputError:
        return None


def _refused(refusal: InputError, run: Path, config: CampaignConfig, *, goes_on: bool) -> InputError:
    """Return the error for a run whose code may not be run, which names the modules that have changed since it began.

    If the campaign `goes_on`, the error says only that.
    """
    code = code_of(config.env, config.ads, config.method, config.specs, config.env_config)
    now = {f"{MODULE}{name}": digest for name, digest in digests_of(one.module for one in code).items()}
    begun = _identity_at_start(run)
    known = {} if begun is None else {name: digest for name, digest in begun.digests.items() if name in now}
    changed = changes(known, {name: now[name] for name in known})
    if not changed:
        return refusal
    if goes_on:
        return _cannot_go_on(run, changed)
    return InputError(f"{refusal}. Changed since the run began: {changed}")


def _cannot_go_on(run: Path, changed: str) -> InputError:
    return InputError(
        f"{run} cannot be continued, because the driver or other code of its campaign has changed: {changed}. Put "
        f"it back, or start a new run"
    )


def _name_from_here(config: CampaignConfig, begun: Identity) -> str:
    """Return the name of a campaign's driver, from this working directory."""
    is_no_file = all(name.startswith(MODULE) for name in begun.digests)
    if is_no_file or Path(config.ads).exists():
        return config.ads
    there = Path(begun.folder) / config.ads
    if there.exists():
        return str(there)
    raise InputError(
        f"The policy {config.ads} of this run is neither here nor in {begun.folder}, where the run began: put it back"
    )
