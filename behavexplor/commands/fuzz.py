"""`behavexplor fuzz`: search for failures of a driving system, also as a check in CI."""

import gc
import json
import os
import shlex
import signal
import sys
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, TextIO

import tyro

from behavexplor.ads.loading import check_name
from behavexplor.ads.sb3.description import named_env
from behavexplor.campaign.campaign import Campaign, ExecutionError
from behavexplor.campaign.config import (
    Budget,
    CampaignConfig,
    campaign_config,
    check_said_twice,
    read_config,
    run_folder,
    stored_config,
)
from behavexplor.campaign.folder_format import failure_path
from behavexplor.campaign.opening import opened, stopped_by_signals
from behavexplor.campaign.progress import ClassSummary, Progress
from behavexplor.campaign.provenance import ALL, Consent
from behavexplor.campaign.run_summary import RunSummary, class_count, summarize
from behavexplor.campaign.same_driver import accepted_run
from behavexplor.campaign.store import Store
from behavexplor.commands import CHECK_FAILED, EXECUTION_FAILED, INTERRUPTED, OK, program
from behavexplor.commands.config_flags import Shown, settings
from behavexplor.commands.display import Display
from behavexplor.commands.display import summary as campaign_summary
from behavexplor.commands.outputs import CaseResult, JsonFile, JUnitFile, check_outputs, write_json, write_junit
from behavexplor.commands.shared_flags import Switch, check_unchanged, chosen_workers, flag, patience
from behavexplor.commands.wording import counted, say, wrapped
from behavexplor.data.untrusted import read_file
from behavexplor.errors import InputError, sentence
from behavexplor.execution.ray_cluster import MAX_NODES, parse_cluster
from behavexplor.execution.simulation import default_method
from behavexplor.fuzz.methods import METHODS, describe_method
from behavexplor.judge.specs import ERROR


@dataclass(frozen=True)
class RunFlags:
    """How a campaign runs.

    Attributes:
        config: YAML file with a configuration, or name of a preset such as "paper". Flags override it.
        out: Run folder, new or empty.
        resume: Resume the campaign in this run folder. A larger --budget extends it; a smaller one stops it earlier.
        stop_after: Stop after this many failures, before the budget is used up.
        workers: Greatest number of worker processes (no effect on the records). 0: this process, with no limits for the
            ADS; an ADS that is not shipped with behavexplor then needs --unconfined.
        cluster: Run the workers on a Ray cluster (docs/scale.md); without ADDRESS, on this machine.
    """

    config: Annotated[str | None, flag("FILE", None)] = None
    out: Annotated[Path | None, flag("FOLDER", "a new one in runs/")] = None
    resume: Annotated[Path | None, flag("RUN", None)] = None
    stop_after: Annotated[int | None, flag("N", None)] = None
    workers: Annotated[int | None, flag("N", "the available cores")] = None
    cluster: Annotated[str | None, flag("ray[:ADDRESS]", None)] = None


@dataclass(frozen=True)
class Output:
    """What is printed and written.

    Attributes:
        json_file: Also write the findings to this JSON file; - is standard output, here and below.
        junit: Also write the classes of failures to this file as JUnit XML, which CI systems show.
        quiet: Print only the summary.
    """

    json_file: JsonFile = None
    junit: JUnitFile = None
    quiet: Switch = False

    @cached_property
    def text(self) -> TextIO:
        """The stream for everything else that is printed; see `check_outputs`.

        Raises:
            InputError: if a file cannot be written.
        """
        return check_outputs(self.json_file, self.junit)


@dataclass(frozen=True)
class Checks:
    """What makes a campaign fail as a check.

    Attributes:
        fail_on_violation: Exit with code 1 if any spec is violated, for checks in CI.
        fail_above: Exit with code 1 if more than this share of the executions failed, such as 0.05.
        known_classes: File with one class in each line, or a --json file. Failures of these classes do not count for
            --fail-on-violation and --fail-above.

    Raises:
        InputError: if the share is out of range.
    """

    fail_on_violation: Switch = False
    fail_above: Annotated[float | None, flag("SHARE", None)] = None
    known_classes: Annotated[Path | None, flag("FILE", None)] = None

    def __post_init__(self) -> None:
        if self.fail_above is not None and not 0.0 <= self.fail_above < 1.0:
            raise InputError(f"--fail-above {self.fail_above} must be a share from 0 to below 1, such as 0.05")

    @cached_property
    def known(self) -> frozenset[str]:
        """Classes of failures that do not count; see `read_known_classes`."""
        return read_known_classes(self.known_classes)

    def new_classes(self, found: RunSummary) -> Sequence[ClassSummary]:
        """Return the classes of a run that are not known."""
        return [one for one in found.classes if one.id not in self.known]

    def outcome(self, found: RunSummary) -> tuple[bool, str]:
        """Return whether a run passes, and a sentence on it; an empty one if nothing is checked."""
        if self.fail_above is None and not self.fail_on_violation:
            return True, ""
        new = self.new_classes(found)
        failed = found.failed - sum(one.count for one in found.classes if one.id in self.known)
        share = failed / max(found.executions, 1)
        kind = " that are not known" if self.known else ""
        what = f"{failed} of {found.executions} executions ({share:.1%}) failed, in {class_count(len(new))}{kind}"
        has_failed = self.fail_on_violation and failed > 0
        if self.fail_above is not None:
            is_above = share > self.fail_above
            has_failed = has_failed or is_above
            what += f"; {'more' if is_above else 'not more'} than {self.fail_above:.1%}"
        return not has_failed, f"The check {'failed' if has_failed else 'passed'}: {what}"


def read_known_classes(path: Path | None) -> frozenset[str]:
    """Return the classes in a file: one in each line, after which a # begins a comment, or a summary in JSON.

    Raises:
        InputError: if the file cannot be read.
    """
    if path is None:
        return frozenset()
    try:
        text = read_file(path, pipes=True).decode()
        if text.lstrip().startswith(("{", "[")):
            return frozenset(str(one["id"]) for one in json.loads(text)["classes"])
    except InputError:  # a ValueError, which the last clause would catch
        raise
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, RecursionError):
        raise InputError(
            f"{path} is neither a list of classes, one in each line, nor a summary that --json has written"
        ) from None
    lines = (line.partition("#")[0].strip() for line in text.splitlines())
    return frozenset(line for line in lines if line)


def tested_classes(found: RunSummary, run: Path, checks: Checks) -> list[CaseResult]:
    """Return a test case of JUnit for each class of failures, which fails if the class is not known."""
    new = {one.id for one in checks.new_classes(found)}
    words = {one.id: f"{one.words}: {one.count} times, first in execution {one.first}" for one in found.classes}
    return [
        CaseResult(one.id, words[one.id] if one.id in new else "", file=failure_path(run, one.first))
        for one in found.classes
    ] or [CaseResult("no failures")]


def _methods() -> str:
    """Return a help text with one line for each search method."""
    return " Methods:" + "".join(f"\n{name}: {describe_method(name)}" for name in METHODS)


_WAITING_FOR_NODE = "Waiting for a cluster node to load the driver ..."
# Types, defaults and help of these flags are those of the fields of `CampaignConfig`.
_DRIVER = settings(
    CampaignConfig,
    "env ads activation env_config traffic stochastic trust unconfined",
    box="driver",
    env=Shown(f"the policy's own, or {CampaignConfig.env}"),
)
_SEARCH = settings(
    CampaignConfig,
    "method budget seed batch specs confirm",
    box="search",
    method=Shown(default="behavexplor; in highway-env's environments uniform", more=_methods()),
)


def fuzz(
    *,
    flags: Annotated[RunFlags, tyro.conf.arg(name="")],
    driver: Annotated[dict[str, Any], _DRIVER],
    search: Annotated[dict[str, Any], _SEARCH],
    checks: Annotated[Checks, tyro.conf.arg(name="check"), tyro.conf.OmitArgPrefixes],
    output: Annotated[Output, tyro.conf.arg(name="output"), tyro.conf.OmitArgPrefixes],
) -> int:
    """Search for scenarios in which a driving system fails, and store every execution in a run folder.

    Args:
        flags: How the campaign runs.
        driver: What is tested, and where.
        search: How scenarios are found.
        checks: What makes the campaign fail as a check.
        output: What is printed and written.
    """
    given = {**driver, **search}
    resumed = flags.resume  # the run folder
    workers = _checked_workers(flags.workers, flags.cluster)
    text = output.text  # checks the files to be written, before the work begins
    _ = checks.known  # checks its file as well
    _check_flags(flags, given)
    chosen = _resumed_config(resumed, given) if resumed else _new_config(given, flags.config)
    display = Display(sys.stderr, Budget.parse(chosen.budget), quiet=output.quiet)
    display.say(f"Fuzzing {chosen.ads} in {chosen.env} with {chosen.method}, seed {chosen.seed}")
    folder = resumed or flags.out or run_folder(chosen)
    making = opened(
        chosen,
        folder,
        workers,
        resume=resumed is not None,
        cluster=flags.cluster or "",
        stop_after=flags.stop_after,
        patience=patience(display.say, _WAITING_FOR_NODE, 0.5) if flags.cluster else patience(display.say),
    )
    with making as ready, _stoppable(ready.campaign, display):
        if ready.store.repaired:
            display.say(ready.store.repaired)
        for warning in ready.warnings:
            display.say(f"Warning: {warning}")
        code = _run(ready.campaign, ready.store, display, chosen.method, text)
        if code == OK and not ready.campaign.progress.executions:
            say(f"{program()}: Nothing was driven within a budget of {chosen.budget}", file=sys.stderr)
            return EXECUTION_FAILED
        if ready.campaign.progress.executions and ready.store.lost is None:
            code = _checked(code, ready.campaign.progress, folder, checks, output)
        return code


def _check_flags(flags: RunFlags, given: Mapping[str, Any]) -> None:
    """Check the range of --stop-after, and that no flag beside --resume gives another configuration or folder."""
    if flags.stop_after is not None and flags.stop_after < 1:
        raise InputError(f"--stop-after {flags.stop_after} must be at least 1")
    if flags.resume and (flags.config or flags.out or "specs" in given):
        raise InputError(
            "--config, --spec and --out cannot be given with --resume: the run folder already has a configuration"
        )


def _checked(code: int, progress: Progress, folder: Path, checks: Checks, output: Output) -> int:
    """Write the findings of a campaign to files, check them, and return the exit code."""
    writes_files = output.json_file or output.junit
    if not writes_files and checks == Checks() and not progress.violations.get(ERROR):
        return code  # without reading the whole run once more
    found = summarize(folder)
    new = [one.id for one in checks.new_classes(found)]
    write_json(output.json_file, {"run": str(folder), **found.to_dict(), "new_classes": new})
    properties = {"env": found.env, "ads": found.ads, "method": found.method, **found.digests}
    tested = tested_classes(found, folder, checks)
    write_junit(output.junit, f"fuzz {found.env}", tested, properties, found.elapsed)
    if code == OK and found.violations.get(ERROR, 0) == found.executions:
        say(f"{program()}: The driver itself failed in every execution, so nothing was tested", file=sys.stderr)
        return EXECUTION_FAILED
    if code != OK:
        return code
    passed, words = checks.outcome(found)
    if not passed:
        say(f"{program()}: {sentence(words)}", file=sys.stderr)
        return CHECK_FAILED
    if words:
        say(wrapped(sentence(words)), file=output.text)
    return OK


def _run(campaign: Campaign, store: Store, display: Display, method: str, text: TextIO) -> int:
    """Run a campaign, let failures be confirmed, print the summary to `text`, and return the exit code."""
    gc.freeze()  # modules live as long as the process: garbage collections need not look at them
    code, failure = OK, None
    with display:
        try:
            ended = campaign.run(display.show)
            campaign.drive_uniformly()
        except ExecutionError as error:
            code, failure = EXECUTION_FAILED, str(error)
        else:
            failure = ended
    if code == OK and not campaign.stopping and (reason := _confirm(campaign, display)):
        code, failure = EXECUTION_FAILED, reason
    if store.lost is not None:
        say(f"{program()}: {store.lost} was deleted or moved, and with it the results", file=sys.stderr)
        return EXECUTION_FAILED
    progress = campaign.progress
    if 0 < progress.executions >= len(store):  # an interruption may come before all stored executions are counted
        say(campaign_summary(progress, store, program(), method, display.budget), file=text)
    if failure:
        say(f"{program()}: {sentence(failure)}", file=sys.stderr)
    if campaign.stopping:
        say(f"Interrupted; resume with: {program()} fuzz --resume {shlex.quote(str(store.folder))}", file=sys.stderr)
        return INTERRUPTED
    if code == OK and not failure and 0 < progress.executions == progress.resumed:
        display.say("The run was already complete: a larger --budget extends it.")
    return code


def _confirm(campaign: Campaign, display: Display) -> str | None:
    """Let highway-env confirm failures, and return why that could not be done; None if nothing went wrong."""
    if not (count := len(campaign.unconfirmed)):
        return None
    display.say(f"Confirming {counted(count, 'failure')} in highway-env")
    try:
        with display.meter(count, "failures") as meter:
            campaign.confirm(meter.show)
    except ExecutionError as error:
        return str(error)
    if campaign.stopping and (left := len(campaign.unconfirmed)):
        display.say(f"Not confirmed yet: {left} of {counted(count, 'failure')}")
    return None


def _checked_workers(workers: int | None, cluster: str | None) -> int:
    """Return the number of workers for `behavexplor.campaign.opening.opened`."""
    if cluster is None:
        return chosen_workers(workers)
    parse_cluster(cluster)
    if workers is not None and not 1 <= workers <= MAX_NODES:
        raise InputError(f"--workers {workers} must lie between 1 and {MAX_NODES} on a cluster")
    return workers or 0


def _new_config(given: dict[str, Any], file: str | None) -> CampaignConfig:
    in_file = read_config(file) if file else {}
    # checks those in the file, to which those given are appended
    specs = campaign_config({"specs": in_file.get("specs", ())}).specs
    values = {**in_file, **given, "specs": (*specs, *given.get("specs", ()))}
    check_said_twice(values, given, file or "")
    trained = None
    if isinstance(values.get("ads"), str):
        values["ads"] = os.path.expanduser(values["ads"])  # noqa: PTH111 - a name, not always a path
        check_name(values["ads"])  # before anything is loaded
        trained = named_env(values.get("env"), values["ads"])
    env = values.get("env") or trained or CampaignConfig.env
    return campaign_config({"method": default_method(env), **values, "env": env})


def _resumed_config(run: Path, given: dict[str, Any]) -> CampaignConfig:
    """Return the configuration in a run folder, with the given budget, if any; nothing else may be changed."""
    fixed = {name: value for name, value in given.items() if name not in ("trust", "budget")}
    if "ads" in fixed:
        fixed["ads"] = os.path.expanduser(fixed["ads"])  # noqa: PTH111 - as in `_new_config`
    check_unchanged(fixed, stored_config(run).unverified, "run")
    names = tuple(value for value in fixed.values() if isinstance(value, str))  # what the user typed may be imported
    consent = Consent(given.get("trust", ()), given.get("unconfined", False), names)
    config = accepted_run(run, consent, ALL, goes_on=True)
    return replace(config, budget=given.get("budget", config.budget))


def _stoppable(campaign: Campaign, display: Display) -> AbstractContextManager[None]:
    def stop() -> None:
        campaign.stop()
        display.say("Stopping after the current execution; press Ctrl-C again to stop at once.")

    return stopped_by_signals(stop, signal.SIG_DFL)
