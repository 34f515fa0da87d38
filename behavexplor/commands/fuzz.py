"""`behavexplor fuzz`: run a campaign."""

import signal
import sqlite3
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from behavexplor import FUNCTIONAL_SCENARIOS
from behavexplor.ads.loading import SYSTEMS
from behavexplor.campaign.campaign import Campaign, ExecutionError, run_folder
from behavexplor.campaign.config import Budget, CampaignConfig, campaign_config, read_config, stored_config
from behavexplor.campaign.opening import opened
from behavexplor.campaign.store import Store
from behavexplor.commands import CHECK_FAILED, EXECUTION_FAILED, INTERRUPTED, OK, program
from behavexplor.commands.display import Display, summary
from behavexplor.commands.interrupts import stopped_by_signals
from behavexplor.errors import InputError
from behavexplor.execution.cluster.address import MAX_NODES, parse_cluster
from behavexplor.execution.executor import available_cores
from behavexplor.fuzz.methods import METHODS, describe_method

_DEFAULTS = CampaignConfig()
_MAX_WORKERS = 64
_ENVS = f"Environment: {', '.join(FUNCTIONAL_SCENARIOS)}, or a gymnasium id."
_SYSTEMS = (
    f"System under test: {', '.join(SYSTEMS)} (docs/policies.md), a policy's file, or package.module:attribute of "
    "anything with a predict method."
)
_WAITING = "Waiting for the ADS: one that is compiled takes its time once, up to a minute ..."
_WAITING_FOR_NODE = "Waiting for a node of the cluster that has loaded the ADS ..."


def _flag(metavar: str, default: object, text: str | None = None) -> Any:
    """A flag that may be left to the configuration."""
    return tyro.conf.arg(
        metavar=metavar, help_behavior_hint=f"(default: {default})" if default is not None else "", help=text
    )


def _methods() -> str:
    """The search methods, a line each."""
    lines = [f"{name}: {describe_method(name)}" for name in METHODS]
    return "\n".join(["Search method, or package.module:attribute of your own:", *lines])


def fuzz(  # noqa: PLR0913 - one argument for each flag
    *,
    env: Annotated[str | None, _flag("NAME", _DEFAULTS.env, _ENVS)] = None,
    ads: Annotated[str | None, _flag("NAME", _DEFAULTS.ads, _SYSTEMS)] = None,
    method: Annotated[str | None, _flag("NAME", _DEFAULTS.method, _methods())] = None,
    config: Annotated[str | None, _flag("FILE", None)] = None,
    budget: Annotated[str | None, _flag("N|TIME", _DEFAULTS.budget)] = None,
    seed: Annotated[int | None, _flag("N", _DEFAULTS.seed)] = None,
    batch: Annotated[int | None, _flag("N", _DEFAULTS.batch)] = None,
    workers: Annotated[int | None, _flag("N", "the available cores")] = None,
    cluster: Annotated[str | None, _flag("ray|dask[:ADDRESS]", None)] = None,
    trust: Annotated[str | None, _flag("DIGEST", None)] = None,
    spec: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, _flag("MODULE:NAME", None)] = (),
    out: Annotated[Path | None, _flag("FOLDER", "a new one in runs/")] = None,
    resume: Annotated[Path | None, _flag("RUN", None)] = None,
    unconfined: bool = False,
    quiet: bool = False,
    fail_on_violation: bool = False,
) -> int:
    """Search for scenarios in which a driving system fails, and keep all that happened in a run folder.

    Args:
        env: Environment.
        ads: System under test.
        method: Search method.
        config: Campaign as a YAML file, or the name of a preset such as "paper"; flags override it.
        budget: Executions (750), or a time (90s, 30m, 1h30m).
        seed: The same seed gives the same records.
        batch: Candidates in flight: each is chosen without the results of that many before it.
        workers: Processes that execute scenarios; the records do not depend on it. 0 is this process, where
            nothing limits or confines the ADS.
        cluster: Have the workers on a cluster of Ray's or Dask's (see docs/robustness.md); without an address one is
            started on this machine.
        trust: Let the policy's file of this digest ("sha256:...") run code of its own while it is loaded.
        spec: A requirement of your own beside R1, R2 and R3: a function of a trace that returns its signed robustness
            (docs/specs.md). May be given several times; adds to those of --config.
        out: Run folder, new or empty.
        resume: Go on with the campaign in this run folder; a larger --budget extends it, a smaller one ends it earlier
            this time.
        unconfined: Let an ADS of yours write files and use the network.
        quiet: Only the summary.
        fail_on_violation: Exit with code 1 if any spec was violated, as a check in CI wants it.
    """
    flags: dict[str, Any] = {"env": env, "ads": ads, "method": method, "budget": budget, "seed": seed, "batch": batch}
    flags |= {"trust": (trust,) if trust else None, "unconfined": unconfined or None}
    given = {name: value for name, value in flags.items() if value is not None}
    workers = _checked_workers(workers, cluster)
    if resume and (config or out or spec):
        raise InputError(
            "--config, --spec and --out cannot be given with --resume: the run folder has its configuration"
        )
    chosen = _resumed_config(resume, given) if resume else _new_config(given, spec, config)
    display = Display(sys.stderr, Budget.parse(chosen.budget), quiet=quiet)
    display.say(f"Fuzzing {chosen.ads} in {chosen.env} with {chosen.method}, seed {chosen.seed}")
    folder = resume or out or run_folder(chosen, Path("runs"))
    making = opened(
        chosen,
        folder,
        workers,
        resume=resume is not None,
        cluster=cluster or "",
        patience=display.patience(_WAITING_FOR_NODE, 0.5) if cluster else display.patience(_WAITING),
    )
    with making as ready, _stoppable(ready.campaign, display):
        if ready.store.repaired:
            display.say(ready.store.repaired)
        for warning in ready.warnings:
            display.say(f"Warning: {warning}")
        code = _run(ready.campaign, ready.store, display, fail_on_violation=fail_on_violation)
        if code == OK and 0 < ready.campaign.progress.executions == ready.campaign.progress.resumed:
            display.say("There was nothing left to do: a larger --budget extends the run.")
        return code


def _run(campaign: Campaign, store: Store, display: Display, *, fail_on_violation: bool) -> int:
    code, failure = OK, None
    with display:
        try:
            ended = campaign.run(display.show)
        except ExecutionError as error:
            code, failure = EXECUTION_FAILED, str(error)
        except (sqlite3.Error, OSError) as error:
            code, failure = EXECUTION_FAILED, f"The run folder cannot be written any more: {error}"
        else:
            failure = ended
    if campaign.progress.executions:
        print(summary(campaign.progress, store, program()))
    if failure:
        print(f"{program()}: {failure}", file=sys.stderr)
    if campaign.stopping:
        print(f"Interrupted; go on with: {program()} fuzz --resume {store.folder}", file=sys.stderr)
        return INTERRUPTED
    if code == OK and fail_on_violation and campaign.progress.failed:
        return CHECK_FAILED
    return code


def _checked_workers(workers: int | None, cluster: str | None) -> int:
    """How many; see `behavexplor.campaign.opening.opened`."""
    if cluster is None:
        least, most, default = 0, _MAX_WORKERS, min(available_cores(), _MAX_WORKERS)
    else:
        parse_cluster(cluster)
        least, most, default = 1, MAX_NODES, 0
    if workers is not None and not least <= workers <= most:
        where = " on a cluster" if cluster else ""
        raise InputError(f"--workers {workers} must lie between {least} and {most}{where}")
    return default if workers is None else workers


def _new_config(given: dict[str, Any], specs: Sequence[str], file: str | None) -> CampaignConfig:
    values = {**(read_config(file) if file else {}), **given}
    if specs:
        values["specs"] = [*values.get("specs", ()), *specs]
    return campaign_config(values)


def _resumed_config(run: Path, given: dict[str, Any]) -> CampaignConfig:
    """The configuration in a run folder; only its budget may be changed."""
    stored = stored_config(run)
    for name, value in given.items():
        if name != "budget" and value != getattr(stored, name):
            raise InputError(f"--{name} cannot be changed on --resume: the run has {getattr(stored, name)!r}")
    return replace(stored, budget=given.get("budget", stored.budget))


def _stoppable(campaign: Campaign, display: Display) -> AbstractContextManager[None]:
    def stop() -> None:
        campaign.stop()
        display.say("Stopping after the execution that is running; once more to stop at once.")

    return stopped_by_signals(stop, signal.SIG_DFL)
