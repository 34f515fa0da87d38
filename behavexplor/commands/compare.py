"""`behavexplor compare`: two drivers in the same scenarios."""

import json
import shlex
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Final, TextIO

import tyro

from behavexplor.ads.loading import check_name
from behavexplor.ads.sb3.description import named_env
from behavexplor.bench.statistics import holm
from behavexplor.campaign.campaign import ExecutionError
from behavexplor.campaign.config import CampaignConfig, campaign_config, stamped_folder
from behavexplor.commands import CHECK_FAILED, OK, UNDECIDED, execution_failed, program
from behavexplor.commands.config_flags import Shown, settings
from behavexplor.commands.display import Meter
from behavexplor.commands.outputs import CaseResult, JsonFile, JUnitFile, check_outputs, write_json, write_junit
from behavexplor.commands.plain_tables import grid, plain_text
from behavexplor.commands.shared_flags import Switch, chosen_workers, flag, patience
from behavexplor.commands.wording import say, wrapped
from behavexplor.data.durable import write_durably, writing
from behavexplor.errors import InputError
from behavexplor.fuzz.methods import GIVEN
from behavexplor.judge.rates import INFERIOR, NON_INFERIOR
from behavexplor.repair import pair_campaigns
from behavexplor.repair.pairs import AT_FAULT, CHANGE, COLUMNS, LEGEND, MarginDecision, Pairs, rows
from behavexplor.report.reading import read_run
from behavexplor.report.run_page import page

TABLE, SEARCH = "comparison.json", "search"
_REPLAYS = 100
_CODES: Final = {NON_INFERIOR: OK, INFERIOR: CHECK_FAILED, "": UNDECIDED}

_METHOD: Final = "nsga2"  # of the search, by default
# Flags for fields of `CampaignConfig`. `given` has those that the user gave; `_configs` applies the defaults.
_SETTINGS = settings(
    CampaignConfig,
    "env activation env_config seed method budget specs confirm traffic stochastic trust unconfined",
    box="campaign",
    env=Shown(f"that of A, or {CampaignConfig.env}"),
    method=Shown(_METHOD, " Used with --search."),
    budget=Shown(CampaignConfig.budget, " Used with --search, as a number of executions."),
)


def compare(  # noqa: PLR0913 - one argument for each flag
    first: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="A")],
    second: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="B")],
    *,
    given: Annotated[dict[str, Any], _SETTINGS],
    scenarios: Annotated[int, tyro.conf.arg(metavar="N")] = 1000,
    margin: Annotated[float | None, flag("P", None)] = None,
    search: Switch = False,
    workers: Annotated[int | None, flag("N", "the cores")] = None,
    out: Annotated[Path | None, flag("FOLDER", "in runs/")] = None,
    json_file: JsonFile = None,
    junit: JUnitFile = None,
    quiet: Switch = False,
) -> int:
    """Drive the same scenarios with two drivers, and report what the second one fixes and what it breaks.

    The folder has a page, comparison.html, and a run folder for each driver, for replay, triage, minimize and suite.

    Args:
        first: The first driving system, as for --ads of fuzz: for example, a policy before it was trained further.
        second: The second driving system.
        given: Settings of both campaigns, of which method and budget are those of the search.
        scenarios: Number of uniformly sampled scenarios; with --margin, the greatest number.
        margin: Greatest difference of the shares of failures at fault that counts as no worse, such as 0.01. The exit
            code is 0 if B is no worse than A by more than that, 1 if it is worse, and 4 if that is not decided. The
            comparison ends as soon as it is decided; the p-values and intervals of its table are not valid then.
        search: Also search for scenarios in which one driver fails and the other does not.
        workers: Number of worker processes (no effect on the results). 0: this process, with no limits for the drivers;
            a driver that is not shipped with behavexplor then needs --unconfined.
        out: Folder for the results, new or empty.
        json_file: Also write the table and the verdict to this JSON file; - is standard output, here and below.
        junit: With --margin, also write the verdict to this file as JUnit XML.
        quiet: Print only the results.
    """
    count = chosen_workers(workers)
    output = check_outputs(json_file, junit)
    _check_arguments(scenarios, margin, junit, out, (first, second))
    config, searching = _configs(first, given, scenarios)
    if search:
        pair_campaigns.check_search(searching)  # before the drivers drive, which may take hours
    folder = out or stamped_folder("compare")
    begun = time.monotonic()
    try:
        other, pairs, verdict = _drive_both(config, second, folder, count, margin, quiet=quiet)
        say(table(pairs, config.env, first, second), file=output)
        write_json(json_file, {"outcomes": values(pairs), "verdict": None if verdict is None else verdict._asdict()})
        _write(folder, pairs, [folder])  # before the search, which may fail or be interrupted
        if search and searched(searching, other, folder / SEARCH, count, output, quiet=quiet):
            _write(folder, pairs, [folder, folder / SEARCH])
    except (ExecutionError, RuntimeError) as error:
        return execution_failed(str(error))
    say(f"Page: {folder / pair_campaigns.PAGE}", file=output)
    run = shlex.quote(str(folder / pair_campaigns.FIRST))
    say(f"Replay a scenario that only one of them fails:\n{program()} replay {run} ID", file=output)
    if verdict is not None:
        say(wrapped(verdict.words), file=output)
        failure = "" if verdict.found == NON_INFERIOR else verdict.words
        tested = [CaseResult(f"non-inferior by {margin:g}", failure)]
        properties = {"A": first, "B": second}
        write_junit(junit, f"compare {config.env}", tested, properties, time.monotonic() - begun)
    return OK if verdict is None else _CODES[verdict.found]


def _configs(first: str, given: Mapping[str, Any], scenarios: int) -> tuple[CampaignConfig, CampaignConfig]:
    """Return the configuration of the campaigns of the driver `first`, and that of the search for differences."""
    env = named_env(given.get("env"), first) or CampaignConfig.env  # as given, or that of A's training
    shared = {name: value for name, value in given.items() if name not in ("method", "budget")}
    both = {"env": env, "ads": first, "budget": str(scenarios), **pair_campaigns.SETTINGS}  # uniform draws
    config = campaign_config({**shared, **both})
    return config, replace(
        config,
        method=given.get("method", _METHOD),
        budget=given.get("budget", CampaignConfig.budget),
        batch=CampaignConfig.batch,
    )


def _check_arguments(
    scenarios: int, margin: float | None, junit: Path | None, out: Path | None, drivers: tuple[str, str]
) -> None:
    """Check the arguments that can be checked before a driver is loaded."""
    if junit is not None and margin is None:
        raise InputError("--junit writes whether a threshold was met: give one with --margin")
    pair_campaigns.check_numbers(scenarios, margin)
    if out is not None:
        pair_campaigns.check_new(out)
    for name in drivers:
        check_name(name)


def _drive_both(
    config: CampaignConfig, second: str, folder: Path, workers: int, margin: float | None, *, quiet: bool
) -> tuple[CampaignConfig, list[Pairs], MarginDecision | None]:
    """Drive all scenarios with both drivers, or as many as decide the margin.

    Return the configuration of the second driver, the pairs and the verdict.
    """
    goes_on = False
    for budget in pair_campaigns.looks(int(config.budget), margin):
        config = replace(config, budget=str(budget))
        _drive(config, folder / pair_campaigns.FIRST, workers, quiet=quiet, resume=goes_on)
        other = pair_campaigns.second_config(config, second, folder / pair_campaigns.FIRST)
        _drive(other, folder / pair_campaigns.SECOND, workers, quiet=quiet, resume=goes_on)
        goes_on = True
        pairs = pair_campaigns.compared(folder)
        verdict = None if margin is None else MarginDecision.of(pairs, margin)
        if verdict is not None and verdict.found:
            break
    return other, pairs, verdict


def _drive(config: CampaignConfig, folder: Path, workers: int, *, quiet: bool, resume: bool = False) -> None:
    """Run one campaign, or go on with it, and say what its driver's check has found."""

    def tell(line: str) -> None:
        if not quiet:
            say(line, file=sys.stderr)

    with patience(tell), Meter(sys.stderr, int(config.budget), f"scenarios with {config.ads}", quiet=quiet) as meter:
        warnings = pair_campaigns.driven(config, folder, workers, meter.show, resume=resume)
    for warning in warnings:
        tell(f"Warning: {config.ads}: {warning}")


def searched(
    config: CampaignConfig, other: CampaignConfig, folder: Path, workers: int, output: TextIO, *, quiet: bool
) -> bool:
    """Search for differences, drive those that were found again, and return whether there are any."""
    executed = 0
    with Meter(sys.stderr, int(config.budget), "scenarios with both", quiet=quiet) as meter:

        def observe(done: int) -> None:
            nonlocal executed
            executed = done
            meter.show(done)

        found = pair_campaigns.differences(config, other, folder, max(1, workers // 2) if workers else 0, observe)
    early = "" if executed == int(config.budget) else f"; it ended before its budget of {config.budget} was used up"
    said = f"\nSearch with {config.method}: {len(found)} of {executed} scenarios in which only one driver fails{early}"
    say(said, file=output)
    if not found:
        return False
    options: dict[str, Any] = {"file": str((folder / pair_campaigns.DIFFERENCES).resolve())}
    for name, one in ((pair_campaigns.FIRST, config), (pair_campaigns.SECOND, other)):
        again = replace(one, method=GIVEN, options=options, budget=str(len(found)))
        _drive(again, folder / name, workers, quiet=True)
    fault = next(row for row in pair_campaigns.compared(folder) if row.outcome == AT_FAULT)
    for name, numbers in ((config.ads, fault.only_first), (other.ads, fault.only_second)):
        listed = f": executions {_listed(numbers)}" if numbers else ""
        say(f"  only {name} fails in {len(numbers)}{listed}", file=output)
    return True


def table(pairs: Sequence[Pairs], env: str, first: str, second: str) -> str:
    """Return the paired statistics as two tables, counts and changes, with numbers of executions to look at."""
    change_index = COLUMNS.index(CHANGE)
    counts = [name for name in COLUMNS if name != CHANGE]
    count_table = grid(*counts, numbers=counts[1:])
    change_table = grid("", CHANGE, numbers=[CHANGE])
    for cells in rows(pairs):
        count_table.add_row(*(cell for i, cell in enumerate(cells) if i != change_index))
        change_table.add_row(cells[0], cells[change_index])
    fault = next(row for row in pairs if row.outcome == AT_FAULT)
    lines = [
        wrapped(f"{fault.n} scenarios of {env}, the same for both; A is {first}, B is {second}:"),
        plain_text(count_table),
        wrapped(LEGEND),
        "",
        plain_text(change_table),
    ]
    for name, numbers in (("Fixed", fault.only_first), ("Broken", fault.only_second)):
        lines += [wrapped(f"{name} failures at fault: executions {_listed(numbers)}")] if numbers else []
    return "\n".join(lines)


def _listed(numbers: Sequence[int], most: int = 8) -> str:
    return ", ".join(map(str, numbers[:most])) + (", ..." if len(numbers) > most else "")


def values(pairs: Sequence[Pairs]) -> list[dict[str, Any]]:
    """Return the paired statistics as JSON values, with the p-values of the table."""
    return [
        {
            "outcome": row.outcome,
            "n": row.n,
            "fixed": row.only_first,
            "broken": row.only_second,
            "both": row.both,
            "neither": row.neither,
            "difference": row.difference,
            "p": p,
        }
        for row, p in zip(pairs, holm([row.p for row in pairs]), strict=True)
    ]


def _write(folder: Path, pairs: Sequence[Pairs], pages: Sequence[Path]) -> None:
    """Write the paired statistics as JSON, and the page."""
    runs = [read_run(place / name) for place in pages for name in (pair_campaigns.FIRST, pair_campaigns.SECOND)]
    text = page(runs, _REPLAYS, pairs)
    with writing(folder):
        write_durably(folder / TABLE, json.dumps(values(pairs), indent=1) + "\n")
        write_durably(folder / pair_campaigns.PAGE, text)
