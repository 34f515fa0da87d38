"""Files that a command writes beside what it prints: JSON and JUnit XML, checked before the work begins."""

import io
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple, TextIO

import tyro
from junitparser import Attr, Failure, JUnitXml, TestCase, TestSuite

from behavexplor.data.durable import check_given, write_given
from behavexplor.errors import InputError

STANDARD: Final = Path("-")  # standard output
JsonFile = Annotated[Path | None, tyro.conf.arg(name="json", metavar="FILE", help_behavior_hint="")]
JUnitFile = Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")]


def check_outputs(*paths: Path | None) -> TextIO:
    """Check that files can be written, and return where everything else is to be printed.

    That is standard error if a file is `STANDARD`, standard output, which then has nothing else; or else standard
    output.

    Raises:
        InputError: if a file cannot be written, or two of them are standard output.
    """
    for path in paths:
        if path not in (None, STANDARD):
            _check(path)
    if paths.count(STANDARD) > 1:
        raise InputError("Two outputs cannot both be '-', which is standard output: name a file for one")
    return sys.stderr if STANDARD in paths else sys.stdout


def _check(path: Path) -> None:
    if path.is_dir():
        raise InputError(f"{path} is a folder: name a file")
    if not path.parent.is_dir():
        raise InputError(f"{path} cannot be written: there is no folder {path.parent}")
    try:
        check_given(path)
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from None


def write_json(path: Path | None, values: Any) -> None:
    """Write values as JSON, if there is a file for them.

    Raises:
        InputError: if it cannot be written.
    """
    _write(path, json.dumps(values, indent=1) + "\n")


class Tested(NamedTuple):
    """A test case of JUnit."""

    name: str  # its name
    failure: str = ""  # why it failed; empty if it passed
    kind: str = ""  # kind of the failure
    file: Path | None = None  # file of its scenario; None if there is none


class _Case(TestCase):
    file = Attr()


def write_junit(
    path: Path | None, suite: str, tested: Sequence[Tested], properties: Mapping[str, str], seconds: float
) -> None:
    """Write test cases as JUnit XML, which CI systems show, if there is a file for them.

    They took `seconds` together. Scenarios are driven at the same time, so the time of one of several is not known.

    Raises:
        InputError: if it cannot be written.
    """
    if path is None:
        return
    made = TestSuite(f"behavexplor {suite}")
    time = round(seconds, 3)
    for name, value in properties.items():
        made.add_property(name, value)
    for one in tested:
        case = _Case(one.name, classname=suite, time=time if len(tested) == 1 else None)
        if one.file is not None:
            case.file = str(one.file)
        if one.failure:
            case.result = [Failure(one.failure, one.kind)]
        made.add_testcase(case)
    made.time = time  # after the cases, whose times junitparser would add up
    document, written = JUnitXml(), io.BytesIO()
    document.add_testsuite(made)
    document.write(written, pretty=True)
    _write(path, written.getvalue().decode())


def _write(path: Path | None, text: str) -> None:
    if path == STANDARD:
        sys.stdout.write(text)
        return
    try:
        if path is not None:
            write_given(path, text)
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from None
