"""`behavexplor check`: drive the scenarios of a regression suite."""

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro

from behavexplor.commands import CHECK_FAILED, OK, execution_failed
from behavexplor.commands.outputs import CaseResult, JsonFile, JUnitFile, check_outputs, write_json, write_junit
from behavexplor.commands.shared_flags import GivenActivation, HowToRun, Switch, patience
from behavexplor.commands.wording import hanging, say
from behavexplor.repair.cases import Suite
from behavexplor.repair.checking import CheckedCase, opened_driver


def check(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")],
    *,
    ads: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: the suite's)")] = None,
    running: HowToRun,
    stochastic: Switch = False,
    activation: GivenActivation = None,
    json_file: JsonFile = None,
    junit: JUnitFile = None,
) -> int:
    """Drive every scenario of a regression suite. The exit code is 1 if one of them fails.

    Args:
        folder: Folder of the suite.
        ads: Driving system under test, as for fuzz.
        running: Flags; see `behavexplor.commands.shared_flags.Running`.
        stochastic: Draw the actions of a stochastic policy, as in its training.
        activation: Function between the layers of a policy whose file holds weights alone, as for fuzz.
        json_file: Also write the results to this JSON file; - is standard output, here and below.
        junit: Also write the results to this file as JUnit XML, which CI systems show.
    """
    suite, output = Suite.read(folder), check_outputs(json_file, junit)
    count = min(running.n_workers, len(suite.cases))
    settings = {"unconfined": running.unconfined, "stochastic": stochastic, "activation": activation}
    waiting = patience(lambda note: None if running.quiet else say(note, file=sys.stderr))
    begun = time.monotonic()
    try:
        with waiting, opened_driver(suite, ads, count, running.trust, **settings) as drive:
            outcomes = list(drive.all_of(suite.cases))
    except RuntimeError as error:
        return execution_failed(f"A scenario could not be executed: {error}")
    seconds = time.monotonic() - begun
    failed = sum(not outcome.passed for outcome in outcomes)
    if not running.quiet:
        say(_listed(outcomes), end="\n\n", file=output)
    say(result(failed, len(outcomes)), file=output)
    properties = {"env": suite.env, "ads": ads or suite.driver}
    write_json(json_file, {**properties, "failed": failed, "scenarios": list(map(_values, outcomes))})
    tested = [
        CaseResult(one.case.name, "" if one.passed else one.words, ", ".join(one.violated), one.case.file(folder))
        for one in outcomes
    ]
    write_junit(junit, suite.env, tested, properties, seconds)
    return CHECK_FAILED if failed else OK


def result(failed: int, count: int) -> str:
    """Return in words how many scenarios of a suite fail."""
    if count == 1:
        return "The only scenario fails" if failed else "The only scenario passes"
    fail = "fails" if failed == 1 else "fail"
    return f"{failed} of {count} scenarios {fail}" if failed else f"All {count} scenarios pass"


def _listed(outcomes: Sequence[CheckedCase]) -> str:
    """Return each scenario by its name, and what happened in it."""
    return "\n".join(
        f"{'pass' if one.passed else 'FAIL'}  {one.case.name}\n{hanging(' ' * 6, one.words)}" for one in outcomes
    )


def _values(outcome: CheckedCase) -> dict[str, Any]:
    return {"name": outcome.case.name, "passed": outcome.passed, "violated": outcome.violated, "words": outcome.words}
