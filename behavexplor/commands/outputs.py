"""Files that a command writes beside what it prints: JSON and JUnit XML, checked before the work begins."""

import io
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple, TextIO

import tyro
from junitparser import Attr, Failure, JUnitXml, TestCase, TestSuite

from behavexplor.data.durable import check_given, write_given, writing
from behavexplor.errors import InputError, printable

STDOUT: Final = Path("-")  # in place of a file: standard output
JsonFile = Annotated[Path | None, tyro.conf.arg(name="json", metavar="FILE", help_behavior_hint="")]
JUnitFile = Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")]


def check_outputs(*paths: Path | None) -> TextIO:
    """Check that files can be written, and return the stream for everything else that is printed.

    That is standard output; or standard error, if a file is `STDOUT`, so that standard output has that file alone.

    Raises:
        InputError: if a file cannot be written, or two of them are standard output.
    """
    for path in paths:
        if path not in (None, STDOUT):
            _check(path)
    if paths.count(STDOUT) > 1:
        raise InputError("Two outputs cannot both be '-', which is standard output: name a file for one")
    return sys.stderr if STDOUT in paths else sys.stdout


def _check(path: Path) -> None:
    if path.is_dir():
        raise InputError(f"{path} is a folder: name a file")
    if not path.parent.is_dir():
        raise InputError(f"{path} cannot be written: there is no folder {path.parent}")
    with writing(path):
        check_given(path)


def write_json(path: Path | None, values: Any) -> None:
    """Write values as JSON, if there is a file for them.

    Raises:
        InputError: if it cannot be written.
    """
    _write(path, json.dumps(values, indent=1) + "\n")


class CaseResult(NamedTuple):
    """A test case of JUnit."""

    name: str  # its name
    failure: str = ""  # why it failed; empty if it passed
    kind: str = ""  # kind of the failure
    file: Path | None = None  # file of its scenario; None if there is none


class _Case(TestCase):
    file = Attr()


def write_junit(
    path: Path | None, suite: str, results: Sequence[CaseResult], properties: Mapping[str, str], seconds: float
) -> None:
    """Write test cases as JUnit XML, which CI systems show, if there is a file for them.

    `suite` is also the `classname` of each case. All cases together took `seconds`. Scenarios are driven at the same
    time, so the time of one of several is not known.

    Raises:
        InputError: if it cannot be written.
    """
    if path is None:
        return
    tests = TestSuite(f"behavexplor {suite}")
    time = round(seconds, 3)
    # `printable`: XML cannot hold control characters or surrogates
    for name, value in properties.items():
        tests.add_property(name, printable(value))
    for result in results:
        case = _Case(printable(result.name), classname=suite, time=time if len(results) == 1 else None)
        if result.file is not None:
            case.file = printable(str(result.file))
        if result.failure:
            case.result = [Failure(printable(result.failure), result.kind)]
        tests.add_testcase(case)
    tests.time = time  # after the cases, whose times junitparser would add up
    document = JUnitXml()
    document.add_testsuite(tests)
    written = io.BytesIO()
    document.write(written, pretty=True)
    _write(path, written.getvalue().decode())


def _write(path: Path | None, text: str) -> None:
    if path == STDOUT:
        sys.stdout.write(text)
        return
    if path is not None:
        with writing(path):
            write_given(path, text)
