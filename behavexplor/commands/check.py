"""`behavexplor check`: drive the scenarios of a regression suite."""

import io
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro
from junitparser import Failure, JUnitXml, TestCase, TestSuite

from behavexplor.commands import CHECK_FAILED, EXECUTION_FAILED, OK, program
from behavexplor.commands.flags import HowToRun, patience
from behavexplor.commands.wording import grid, plain_text, say
from behavexplor.data.durable import write_given
from behavexplor.errors import InputError, sentence
from behavexplor.repair.cases import Suite
from behavexplor.repair.checking import CheckedCase, opened_driver


def check(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER")],
    *,
    ads: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: the suite's)")] = None,
    running: HowToRun,
    stochastic: bool = False,
    junit: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None,
) -> int:
    """Drive every scenario of a regression suite. The exit code is 1 if one of them fails.

    Args:
        folder: Folder of the suite.
        ads: Driving system under test, as for fuzz.
        running: How the driver runs.
        stochastic: Draw the actions of a stochastic policy, as in its training.
        junit: Also write the results to this file as JUnit XML, which CI systems show.
    """
    suite = Suite.read(folder)
    count = min(running.count, len(suite.cases))
    settings = {"unconfined": running.unconfined, "stochastic": stochastic}
    waiting = patience(lambda note: None if running.quiet else say(note, file=sys.stderr))
    try:
        with waiting, opened_driver(suite, ads, count, running.trust, **settings) as drive:
            outcomes = list(drive.all_of(suite.cases))
    except RuntimeError as error:
        say(f"{program()}: {sentence(f'A scenario could not be executed: {error}')}", file=sys.stderr)
        return EXECUTION_FAILED
    failed = sum(not outcome.passed for outcome in outcomes)
    if not running.quiet:
        say(_table(outcomes), end="\n\n")
    say(result(failed, len(outcomes)))
    if junit is not None:
        _write(junit, suite, outcomes)
    return CHECK_FAILED if failed else OK


def result(failed: int, count: int) -> str:
    """Return in words how many scenarios of a suite fail."""
    if count == 1:
        return "The only scenario fails" if failed else "The only scenario passes"
    fail = "fails" if failed == 1 else "fail"
    return f"{failed} of {count} scenarios {fail}" if failed else f"All {count} scenarios pass"


def _table(outcomes: Sequence[CheckedCase]) -> str:
    table = grid("scenario", "", "what happened")
    for outcome in outcomes:
        table.add_row(outcome.case.name, "pass" if outcome.passed else "FAIL", outcome.words)
    return plain_text(table)


def _write(path: Path, suite: Suite, outcomes: Sequence[CheckedCase]) -> None:
    """Write results as JUnit XML."""
    tests = TestSuite(f"behavexplor {suite.env}")
    for outcome in outcomes:
        test = TestCase(outcome.case.name, classname=suite.env)
        if not outcome.passed:
            test.result = [Failure(outcome.words, ", ".join(outcome.violated))]
        tests.add_testcase(test)
    document = JUnitXml()
    document.add_testsuite(tests)
    try:
        written = io.BytesIO()
        document.write(written, pretty=True)
        write_given(path, written.getvalue().decode())
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from None
