"""`behavexplor evaluate`: measure how well a driving system drives."""

import gc
import shlex
import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Final, NamedTuple, TextIO

import scipy
import tyro

from behavexplor.ads.loading import check_name
from behavexplor.ads.sb3.description import named_env
from behavexplor.api.evaluating import board, listed
from behavexplor.api.rate_folder import CARD, CLAUSE, MOST_STORED, RateFolder
from behavexplor.campaign.campaign import ExecutionError
from behavexplor.campaign.config import CampaignConfig, campaign_config
from behavexplor.campaign.folder_format import CONFIG
from behavexplor.commands import CHECK_FAILED, EXECUTION_FAILED, OK, UNDECIDED, execution_failed, program
from behavexplor.commands.config_flags import Shown, settings
from behavexplor.commands.display import Meter
from behavexplor.commands.outputs import CaseResult, JsonFile, JUnitFile, check_outputs, write_json, write_junit
from behavexplor.commands.rate_table import rates_table, shown_outcomes
from behavexplor.commands.shared_flags import Switch, chosen_workers, flag, patience
from behavexplor.commands.wording import counted, say, wrapped
from behavexplor.data.drawn_scenario import DEFAULT
from behavexplor.data.scenario import LogicalScenario
from behavexplor.data.target import Target
from behavexplor.errors import InputError
from behavexplor.evaluation import Evaluation, estimate_rates, start_judge
from behavexplor.execution.evaluator import DRAWS
from behavexplor.execution.start import check_ads, logical_of_target
from behavexplor.judge.rates import ABOVE, BELOW, FAILED, KNOWN, Goal, check_outcome
from behavexplor.judge.specs import ERROR

SCENARIOS: Final = 1000  # default number of scenarios
SCENARIOS_OF_GOAL: Final = 1_000_000  # the same with --below or --until
MOST_SCENARIOS: Final = 10_000_000
_CODES: Final = MappingProxyType({BELOW: OK, KNOWN: OK, ABOVE: CHECK_FAILED, "": UNDECIDED})
DRAWN: Final = "drawn actions"  # heading of a column
DIFFERENT: Final = 0.01  # level of significance
_CONSTANT: Final = "constant:"
_CONTROLS: Final = MappingProxyType(
    {
        "careful": "careful",
        "always SLOWER": "constant:SLOWER",
        "always IDLE": "constant:IDLE",
        "always FASTER": "constant:FASTER",
    }
)

_SETTINGS = settings(
    CampaignConfig,
    "env ads activation env_config seed traffic stochastic trust unconfined",
    box="driver",
    env=Shown(f"the policy's own, or {CampaignConfig.env}"),
    stochastic=Shown(False, " By default, the rates with drawn actions are shown, too."),
)


class _Run(NamedTuple):
    """What all evaluations of one command have in common."""

    scenarios: int  # number of scenarios; the greatest number if there is a goal
    seed: int
    workers: int
    quiet: bool
    goal: Goal | None  # what is to be decided; None for the rates alone
    folder: RateFolder | None  # where outcomes and failures are stored; None if they are not


def evaluate(  # noqa: PLR0913 - one argument for each flag
    policies: Annotated[Path | None, tyro.conf.Positional, flag("POLICIES", None)] = None,
    *,
    given: Annotated[dict[str, Any], _SETTINGS],
    scenarios: Annotated[int | None, flag("N", f"{SCENARIOS}, or {SCENARIOS_OF_GOAL} with --below or --until")] = None,
    below: Annotated[float | None, flag("P", None)] = None,
    until: Annotated[float | None, flag("SHARE", None)] = None,
    outcome: Annotated[str | None, flag("NAME", f"{Goal.outcome}, or {FAILED} for a ranking")] = None,
    out: Annotated[Path | None, flag("FOLDER", None)] = None,
    workers: Annotated[int | None, flag("N", "the cores")] = None,
    json_file: JsonFile = None,
    junit: JUnitFile = None,
    controls: bool = True,
    quiet: Switch = False,
) -> int:
    """Drive uniformly sampled scenarios, and report how often the driver arrives, collides and touches illegal lines.

    Args:
        policies: Rank several drivers on a page in --out: a folder of policy files, or a YAML file of drivers by name,
            each with its settings, such as careful: {ads: careful, env: roundabout-v0}.
        given: The driver, its environment, and the seed of the scenarios.
        scenarios: Number of scenarios; with --below or --until, the greatest number.
        below: End when the rate of the outcome is known to be below, or above, this one, such as 0.001. The exit code
            is 0 if it is below, 1 if it is above, and 4 if that is not decided.
        until: End when the rate is known this precisely: half the width of its interval, as a share of the rate.
        outcome: What --below, --until and a ranking are about: a row of the table, "at-fault", or "failed".
        out: Folder for the outcomes, a card, and the failures as a run for triage, minimize, report and suite. The same
            command goes on after an interruption.
        workers: Number of worker processes (no effect on the rates). 0: this process, with no limits for the driver;
            a driver that is not shipped with behavexplor then needs --unconfined.
        json_file: Also write the counts to this JSON file; - is standard output, here and below.
        junit: With --below, also write the verdict to this file as JUnit XML.
        controls: In highway-env's own environments, also evaluate a careful driver, and three that always do the same.
        quiet: Print only the table.
    """
    output, goal = check_outputs(json_file, junit), _goal(outcome or Goal.outcome, below, until, junit)
    default = SCENARIOS_OF_GOAL if goal else SCENARIOS
    count = default if scenarios is None else scenarios
    if not 1 <= count <= MOST_SCENARIOS:
        raise InputError(f"--scenarios {count} must lie between 1 and {MOST_SCENARIOS}")
    ads = given.get("ads", CampaignConfig.ads)
    check_name(ads)
    config = campaign_config({**given, "env": named_env(given.get("env"), ads) or CampaignConfig.env})
    folder = None if out is None or policies else RateFolder(out, config)
    run = _Run(count, config.seed, chosen_workers(workers), quiet, goal, folder)
    begun = time.monotonic()
    try:
        if policies is not None:
            return _ranked(policies, out, {**given, "outcome": outcome or FAILED}, run, output)
        found = _evaluations(config, run, controls=controls)
    except (RuntimeError, ExecutionError) as error:
        said = str(error) if isinstance(error, ExecutionError) else f"A scenario could not be executed: {error}"
        return execution_failed(said)
    _say_rates(config, found, folder, output)
    write_json(json_file, _values(config, found))
    own = next(iter(found.values()))
    decision = own.decision
    if decision is not None:
        case = CaseResult(f"{decision.goal.outcome} below {below}", "" if decision.verdict == BELOW else decision.words)
        write_junit(junit, f"evaluate {config.env}", [case], {"ads": ads}, time.monotonic() - begun)
    if own.counts.get(ERROR) == own.n:
        say(f"{program()}: The driver itself failed in every execution, so nothing was tested", file=sys.stderr)
        return EXECUTION_FAILED
    return OK if decision is None else _CODES[decision.verdict]


def _say_rates(
    config: CampaignConfig, found: Mapping[str, Evaluation], folder: RateFolder | None, output: TextIO
) -> None:
    """Print what was found, and write the card."""
    own = next(iter(found.values()))
    say(rates_table(config.env, found), file=output)
    if DRAWN in found:
        say(wrapped(_gap(own, found[DRAWN])), file=output)
    if own.counts.get(ERROR):
        kept = "the run of the failures has its messages" if folder else "--out FOLDER keeps them with its messages"
        scenarios = counted(own.counts[ERROR], "scenario")
        say(wrapped(f"In {scenarios} the driver itself failed (error): {kept}."), file=output)
    if own.decision is not None:
        say(wrapped(f"{own.decision.words}, {CLAUSE.format(config.env)}"), file=output)
    if folder is not None:
        folder.write_card(found)
        say(f"Card: {folder.path / CARD}.md", file=output)
        if (folder.run / CONFIG).is_file():
            say(f"Failures: {program()} report {shlex.quote(str(folder.run))}", file=output)


def _ranked(policies: Path, out: Path | None, given: dict[str, Any], run: _Run, output: TextIO) -> int:
    """Evaluate several drivers, and write the page that ranks them."""
    if out is None or "ads" in given or run.goal is not None:
        raise InputError(f"{policies} names the drivers: give --out FOLDER, and no --ads, --below or --until")
    shared = {**given, "scenarios": run.scenarios, "workers": run.workers}
    with Meter(sys.stderr, len(listed(policies)), "drivers", quiet=run.quiet) as meter:
        page = board(policies, out, observe=meter.show, **shared)
    say(f"Page: {page}", file=output)
    return OK


def _goal(outcome: str, below: float | None, until: float | None, junit: Path | None) -> Goal | None:
    """Return what is to be decided; None without a flag that asks for it."""
    if junit is not None and below is None:
        raise InputError("--junit writes whether a threshold was met: give one with --below")
    check_outcome(outcome)
    if below is None and until is None:
        return None
    return Goal(outcome, below, until)


def _evaluations(config: CampaignConfig, run: _Run, *, controls: bool) -> dict[str, Evaluation]:
    """Return the evaluation of the driver and of what it is compared with, by the headings of their columns."""
    logical, evaluation, draws = _evaluated(config.target, run)
    name = Path(config.ads).name
    found = {config.ads if name in _CONTROLS else name: evaluation}  # a file named like a control is shown by its path
    shorter_run = run._replace(scenarios=min(run.scenarios, SCENARIOS), goal=None, folder=None)
    for heading, beside in _beside(config.target, logical, draws=draws, controls=controls).items():
        # if the driver is itself this control, it is not driven again
        rates = None if heading in found else _rates_beside(heading, beside, shorter_run)
        if rates is not None:
            found[heading] = rates
    return found


def _values(config: CampaignConfig, found: Mapping[str, Evaluation]) -> dict[str, Any]:
    """Return the counts, and the decision on a rate, as JSON values."""
    (_, first), *others = found.items()
    values = {"env": config.env, "ads": config.ads, "seed": config.seed, "n": first.n, **first.counts}
    values |= {"beside": {name: dict(one.counts) for name, one in others}} if others else {}
    decision = first.decision
    return values | ({"decision": {**asdict(decision), "verdict": decision.verdict}} if decision else {})


def _evaluated(target: Target, run: _Run, *, beside: bool = False) -> tuple[LogicalScenario, Evaluation, bool]:
    """Evaluate a target, after a check of its driver, and return whether the driver could draw its actions.

    Its failures are stored if the run has a folder. Warnings about a driver that is shown beside the policy, or about a
    constant one, are left out.
    """
    say_unless_quiet = partial(_say, quiet=run.quiet)
    with ExitStack() as stack:
        with patience(say_unless_quiet):
            executor = start_judge(target, run.workers)
            stack.callback(executor.shutdown, wait=False)
            warnings = check_ads(executor)
            logical = logical_of_target(executor, target.env)
        gc.freeze()  # modules live as long as the process: garbage collections need not look at them
        for warning in warnings if not (beside or target.ads.startswith(_CONSTANT)) else ():
            say_unless_quiet(f"Warning: {warning}")
        with Meter(sys.stderr, run.scenarios, "scenarios", quiet=run.quiet) as meter:
            file = None if run.folder is None else run.folder.file
            found = estimate_rates(executor, logical, run.scenarios, run.seed, meter.show, goal=run.goal, file=file)
        draws = bool(executor.submit(DRAWS, b"").result())
    if run.folder is not None:
        with Meter(sys.stderr, min(found.failed, MOST_STORED), "failures driven again", quiet=run.quiet) as meter:
            run.folder.store_failures(logical, found.n, run.workers, meter.show)
    return logical, found, draws


def _rates_beside(name: str, target: Target, run: _Run) -> Evaluation | None:
    """Evaluate what is shown beside a policy; None for a control that cannot drive in the environment.

    For example, highway-env's racetrack takes no meta-actions.
    """
    try:
        return _evaluated(target, run, beside=True)[1]
    except InputError as error:
        if name not in _CONTROLS:
            raise
        _say(f"Without the control {name!r}, which cannot drive here: {error}", quiet=run.quiet)
        return None


def _gap(chosen: Evaluation, drawn: Evaluation) -> str:
    """Return a sentence on whether a policy drives differently when its actions are drawn."""
    cells = {
        name: [[found.counts.get(name, 0), found.n - found.counts.get(name, 0)] for found in (chosen, drawn)]
        for name in shown_outcomes({"": chosen, DRAWN: drawn})
        if ": " not in name  # faults are part of collisions
    }
    differing = [name for name, table in cells.items() if scipy.stats.fisher_exact(table).pvalue < DIFFERENT]
    if not differing:
        return "With drawn actions, as in training, no rate differs significantly (Fisher's exact test, 1 %)."
    return (
        f"With drawn actions, as in training, these rates differ significantly (Fisher's exact test, 1 %): "
        f"{', '.join(differing)}. "
        "The policy was trained with drawn actions: to test it as it drove then, use --stochastic."
    )


def _beside(target: Target, logical: LogicalScenario, *, draws: bool, controls: bool) -> dict[str, Target]:
    """Return what a rate is compared with, by the heading of its column.

    A stochastic policy is compared with its drawn actions. In a highway-env environment, a rate is also compared with
    simple drivers in the configuration of the policy, and a rate in wide traffic with that in the environment's own
    traffic.
    """
    columns = {DRAWN: replace(target, stochastic=True)} if draws and not target.stochastic else {}
    if not logical.has_original:
        return columns
    if target.traffic != DEFAULT:
        columns["in default traffic"] = replace(target, traffic=DEFAULT)
    for heading, ads in _CONTROLS.items() if controls else ():
        columns[heading] = replace(target, ads=ads, trust=(), env_config=logical.config, stochastic=False)
    return columns


def _say(line: str, *, quiet: bool) -> None:
    if not quiet:
        say(line, file=sys.stderr)
