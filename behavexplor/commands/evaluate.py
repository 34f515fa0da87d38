"""`behavexplor evaluate`: measure how well a driving system drives."""

import json
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Table

from behavexplor.commands import EXECUTION_FAILED, OK, program
from behavexplor.commands.meter import Meter
from behavexplor.commands.workers import chosen_workers, patience
from behavexplor.data.target import Target
from behavexplor.errors import InputError, sentence
from behavexplor.evaluation import Evaluation, estimate_rates, start_judge
from behavexplor.execution.rollout import ADSError
from behavexplor.execution.simulation import logical_scenario
from behavexplor.execution.start import check_ads

MOST_SCENARIOS = 1_000_000


def evaluate(  # noqa: PLR0913 - one argument for each flag
    *,
    env: Annotated[str, tyro.conf.arg(metavar="NAME")] = "intersection-straight",
    ads: Annotated[str, tyro.conf.arg(metavar="NAME")] = "rule",
    scenarios: Annotated[int, tyro.conf.arg(metavar="N")] = 1000,
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    workers: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="(default: the cores)")] = None,
    trust: Annotated[str | None, tyro.conf.arg(metavar="DIGEST", help_behavior_hint="")] = None,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json", metavar="FILE", help_behavior_hint="")] = None,
    unconfined: bool = False,
    quiet: bool = False,
) -> int:
    """Drive uniformly sampled scenarios, and report how often the driver arrives, collides and touches illegal lines.

    Args:
        env: Functional scenario, or gymnasium id of an environment that runs concrete scenarios.
        ads: Driving system under test, as for fuzz.
        scenarios: Number of scenarios.
        seed: Seed of the sampled scenarios.
        workers: Number of worker processes (no effect on the rates). 0: this process, with no limits for the driver;
            a driver that is not shipped with behavexplor then needs --unconfined.
        trust: Allow the policy file with this digest ("sha256:...") to execute code on load.
        json_file: Also write the counts to this JSON file.
        unconfined: Allow a driver that is not shipped with behavexplor to write files and use the network.
        quiet: Print only the table.
    """
    if not 1 <= scenarios <= MOST_SCENARIOS:
        raise InputError(f"--scenarios {scenarios} must lie between 1 and {MOST_SCENARIOS}")
    if seed < 0:
        raise InputError(f"--seed {seed} must not be negative")
    count = chosen_workers(workers)
    say = partial(_say, quiet=quiet)
    target = Target(env, ads, (trust,) if trust else (), unconfined)
    with ExitStack() as stack:
        logical = logical_scenario(env)
        with patience(say):
            executor = start_judge(target, count)
            stack.callback(executor.shutdown, wait=False)
            warnings = check_ads(executor)
        for warning in warnings:
            say(f"Warning: {warning}")
        try:
            with Meter(sys.stderr, scenarios, "scenarios", quiet=quiet) as meter:
                found = estimate_rates(executor, logical, scenarios, seed, meter.show)
        except ADSError as error:
            failure = f"In one of the scenarios {error}; fuzz records such failures and goes on"
            print(f"{program()}: {sentence(failure)}", file=sys.stderr)
            return EXECUTION_FAILED
        except RuntimeError as error:
            print(f"{program()}: {sentence(f'A scenario could not be executed: {error}')}", file=sys.stderr)
            return EXECUTION_FAILED
    if json_file is not None:
        _write(json_file, {"env": env, "ads": ads, "seed": seed, "n": found.n, **found.counts})
    print(table({f"{ads} in {env}": found}))
    return OK


def _say(line: str, *, quiet: bool) -> None:
    if not quiet:
        print(line, file=sys.stderr)


def _write(path: Path, values: Mapping[str, object]) -> None:
    try:
        path.write_text(json.dumps(values, indent=1))
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from None


def table(evaluations: Mapping[str, Evaluation]) -> str:
    """Return a table of rates in percent with their 95 % intervals, with a column for each evaluation."""
    grid = Table(box=None, pad_edge=False)
    grid.add_column("")
    for name, found in evaluations.items():
        grid.add_column(f"{name}, {found.n} scenarios", justify="right")
    outcomes = dict.fromkeys(outcome for found in evaluations.values() for outcome in found.counts)
    for outcome in outcomes:
        cells = []
        for found in evaluations.values():
            low, high = found.interval(outcome)
            cells.append(f"{found.rate(outcome):.1%} ({low:.1%} to {high:.1%})")
        kind, _, fault = outcome.partition(": ")
        grid.add_row(f"  {fault.replace('_', ' ')}" if fault else kind, *cells)
    console = Console(width=40 + 60 * len(evaluations), highlight=False, no_color=True)
    with console.capture() as captured:
        console.print(grid)
    return "\n".join(line.rstrip() for line in captured.get().splitlines())
