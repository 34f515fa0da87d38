"""The command line interface. Only this package parses arguments and prints.

Exit codes: 0 success (finding violations is a success), 1 a check failed, 2 wrong input or an error in the user's code,
3 an execution could not be carried out, the run folder could not be written, or the driver failed in every execution,
4 a rate could not be decided, 70 a bug in this package, 130 interrupted.
"""

import errno
import logging
import os
import shutil
import sys
import sysconfig
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from importlib import import_module
from importlib.metadata import version
from io import TextIOWrapper
from pathlib import Path
from typing import Any, Final, TextIO

import tyro

from behavexplor import FUNCTIONAL_SCENARIOS, HIGHWAY_ENV
from behavexplor.commands.arguments import (
    COMMANDS,
    bound,
    changed_output,
    overview,
    with_joined_lines,
    with_names,
    with_wrapped_usage,
    wrapped_head,
)
from behavexplor.commands.wording import say
from behavexplor.errors import InputError, sentence, unknown_name

OK, CHECK_FAILED, BAD_INPUT, EXECUTION_FAILED, UNDECIDED, INTERNAL_ERROR, INTERRUPTED = 0, 1, 2, 3, 4, 70, 130

_MODULES = {"import": "importing"}  # commands whose modules and functions are named otherwise

NO_TEMPORARY_FOLDER: Final = (
    "There is no folder for temporary files: set the environment variable TMPDIR to a folder that can be written"
)
_MATPLOTLIB: Final = "MPLCONFIGDIR"  # names the folder in which matplotlib keeps its cache
_NARROWEST: Final = 20  # columns of a terminal for which help is made
_OUTPUT_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EIO)  # if the error names no file, standard output has failed


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command, such as `behavexplor fuzz`, by default that of this process, and return the exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given == ["--version"]:
        say(f"behavexplor {version('behavexplor')}")
        return OK
    if sys.stdout is None:  # it is closed
        sys.stdout = Path(os.devnull).open("w")  # noqa: SIM115 - for the whole process
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # file names may not be valid text
    if shutil.get_terminal_size().columns < _NARROWEST:  # tyro never ends if no word fits
        os.environ["COLUMNS"] = str(_NARROWEST)
    with _notices(quiet="--quiet" in given), folder_for_matplotlib():
        return _run(given)


@contextmanager
def _notices(*, quiet: bool) -> Iterator[None]:
    """Silence notices that are of no use to the user, and if `quiet` also the one that kernels are being compiled.

    Warnings are shown as sentences, without the line of the program that issued them.
    """
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # it complains about a HOME that cannot be written
    compiling = logging.getLogger("behavexplor.jit")
    before = compiling.level
    if quiet:
        compiling.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            yield
    finally:
        compiling.setLevel(before)


def _show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,  # noqa: ARG001 - the signature that `warnings` calls
    line: str | None = None,  # noqa: ARG001
) -> None:
    is_told_to_user = issubclass(category, UserWarning)
    text = f"Warning: {message}" if is_told_to_user else warnings.formatwarning(message, category, filename, lineno)
    say(sentence(text), file=sys.stderr)


def _run(given: Sequence[str]) -> int:
    """Run the command that the arguments name, report its errors, and return the exit code."""
    if "" not in sys.path and not sys.flags.safe_path:  # the user's modules are in the working directory
        sys.path.append("")  # last, so that no file in a foreign folder takes the place of a library
    try:
        code = _run_command(given)
    except KeyboardInterrupt:
        say(f"{program()}: Interrupted; what was finished is kept", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # the reader of the output, such as `head`, has exited
        _drop_output()
        return OK
    except Exception as error:
        return _failed(error)
    return code


def _run_command(given: Sequence[str]) -> int:
    """Run the command that the arguments name, or show all commands."""
    name = given[0] if given else ""
    if name in ("", "-h", "--help"):
        say(overview(program()))
        return OK if name else BAD_INPUT
    if name.startswith("--tyro-"):  # to print a completion script
        commands = {one: _command(one) for one in COMMANDS}
        methods = import_module("behavexplor.fuzz.methods").METHODS
        names = {"--env": (*FUNCTIONAL_SCENARIOS, *HIGHWAY_ENV), "--method": tuple(methods)}
        with changed_output(lambda script: with_names(script, names)):
            tyro.extras.subcommand_cli_from_dict(commands, prog=program().rpartition(" ")[2], args=given)
    if name not in COMMANDS:
        raise unknown_name("command", name, COMMANDS)
    command: Callable[..., int] = _command(name)
    with changed_output(with_wrapped_usage) if {"-h", "--help"} & set(given) else nullcontext():
        run = bound(command, given[1:], prog=f"{program()} {name}", description=wrapped_head(command))
    return run()


def _drop_output() -> None:
    """Discard buffered output, so that Python does not try to write it on exit."""
    with suppress(OSError):  # standard output may be an object without a file
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _command(name: str) -> Callable[..., Any]:
    module = _MODULES.get(name, name)
    return with_joined_lines(getattr(import_module(f"{__name__}.{module}"), module))


def _failed(error: Exception) -> int:
    """Report an error and return the exit code. Wrong input, including bad file names and rights, gets one sentence."""
    if isinstance(error, InputError) or (isinstance(error, OSError) and error.filename is not None):
        say(f"{program()}: {sentence(str(error))}", file=sys.stderr)
        return EXECUTION_FAILED if getattr(error, "errno", None) in _OUTPUT_ERRORS else BAD_INPUT
    if isinstance(error, OSError) and error.errno in _OUTPUT_ERRORS:
        _drop_output()
        say(f"{program()}: The output cannot be written: {error.strerror}", file=sys.stderr)
        return EXECUTION_FAILED
    if isinstance(error, OSError) and not has_temporary_folder():
        say(f"{program()}: {NO_TEMPORARY_FOLDER}", file=sys.stderr)
        return BAD_INPUT
    if isinstance(error, FileNotFoundError) and not _has_working_directory():
        say(f"{program()}: The working directory was deleted: change to another one", file=sys.stderr)
        return BAD_INPUT
    say("".join(traceback.format_exception(error)), end="", file=sys.stderr)
    place = _own_place(error)
    if place is not None:
        say(f"{program()}: The error is in {place}, which behavexplor has called", file=sys.stderr)
        return BAD_INPUT
    say(
        f"{program()}: This is a bug in behavexplor, or in a search method, requirement or environment of your own, "
        "which behavexplor.testing checks; please report it if it is ours",
        file=sys.stderr,
    )
    return INTERNAL_ERROR


def _has_working_directory() -> bool:
    try:
        Path.cwd()
    except FileNotFoundError:
        return False
    return True


def _own_place(error: Exception) -> str | None:
    """Return the innermost place in code of the user that raised an exception; None if it went through none."""
    ours = [Path(__file__).parents[1], *(Path(sysconfig.get_path(name)) for name in ("stdlib", "purelib", "platlib"))]
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        file = Path(frame.filename)
        if file.is_file() and not any(file.resolve().is_relative_to(folder.resolve()) for folder in ours):
            return sentence(f"{file.name}, line {frame.lineno}")
    return None


def program() -> str:
    """Return the name by which the user called this program."""
    called = os.environ.get("BEHAVEXPLOR_PROGRAM") or Path(sys.argv[0]).name
    return called if not called.endswith(".py") else "python -m behavexplor"


def execution_failed(said: str) -> int:
    """Say why an execution could not be carried out, and return the exit code."""
    say(f"{program()}: {sentence(said)}", file=sys.stderr)
    return EXECUTION_FAILED


@contextmanager
def folder_for_matplotlib() -> Iterator[None]:
    """Give matplotlib, which highway-env imports, a temporary folder if HOME cannot be written; it warns otherwise."""
    if _MATPLOTLIB in os.environ or _has_home() or not has_temporary_folder():
        yield
        return
    with tempfile.TemporaryDirectory(prefix="behavexplor-matplotlib-", ignore_cleanup_errors=True) as folder:
        os.environ[_MATPLOTLIB] = folder
        try:
            yield
        finally:
            del os.environ[_MATPLOTLIB]


def has_temporary_folder() -> bool:
    """Return whether temporary files can be written."""
    try:
        tempfile.gettempdir()
    except FileNotFoundError:
        return False
    return True


def _has_home() -> bool:
    try:
        return Path.home().is_dir() and os.access(Path.home(), os.W_OK)
    except RuntimeError:  # the user has no home
        return False
