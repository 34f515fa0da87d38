"""The commands. Only here are arguments parsed and is anything printed.

Exit codes: 0 the budget was used (violations are the product), 1 a check failed, 2 the input is wrong, 3 the ADS or
its environment failed, 70 a bug of ours, 130 interrupted.
"""

import os
import sys
import traceback
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from behavexplor.errors import InputError

OK, CHECK_FAILED, BAD_INPUT, EXECUTION_FAILED, INTERNAL_ERROR, INTERRUPTED = 0, 1, 2, 3, 70, 130

_LONGEST = 900  # characters of a sentence that is shown


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command, such as `behavexplor fuzz`.

    Args:
        arguments: without the program's name; those of this process by default.

    Returns:
        The exit code.
    """
    if list(sys.argv[1:] if arguments is None else arguments) == ["--version"]:
        print(f"behavexplor {version('behavexplor')}")
        return OK
    import tyro  # noqa: PLC0415 - a library user of this package never needs it

    from behavexplor.commands.bench import bench  # noqa: PLC0415
    from behavexplor.commands.evaluate import evaluate  # noqa: PLC0415
    from behavexplor.commands.fuzz import fuzz  # noqa: PLC0415
    from behavexplor.commands.records import records  # noqa: PLC0415
    from behavexplor.commands.replay import replay  # noqa: PLC0415
    from behavexplor.commands.report import report  # noqa: PLC0415
    from behavexplor.commands.train import train  # noqa: PLC0415
    from behavexplor.commands.triage import triage  # noqa: PLC0415

    commands: dict[str, Callable[..., Any]] = {
        "fuzz": fuzz,
        "replay": replay,
        "records": records,
        "triage": triage,
        "report": report,
        "evaluate": evaluate,
        "bench": bench,
        "train": train,
    }
    try:
        code: int = tyro.extras.subcommand_cli_from_dict(
            commands, prog=program(), args=arguments, description="Find out how a driving policy fails."
        )
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:  # the reader of our output, such as `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OK
    except Exception as error:
        return _failed(error)
    return code


def _failed(error: Exception) -> int:
    """Say what went wrong: a sentence for the user's input, which a file's name or rights are, too; the exit code."""
    if isinstance(error, InputError) or (isinstance(error, OSError) and error.filename is not None):
        print(f"{program()}: {_sentence(error)}", file=sys.stderr)
        return BAD_INPUT
    traceback.print_exception(error)
    print(f"{program()}: This is a bug in behavexplor or in an extension of it; please report it.", file=sys.stderr)
    return INTERNAL_ERROR


def _sentence(error: Exception) -> str:
    """What is wrong in one line, however much of it was given."""
    text = " ".join(str(error).split())
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."


def program() -> str:
    """How the user calls this program."""
    called = os.environ.get("BEHAVEXPLOR_PROGRAM") or Path(sys.argv[0]).name
    return called if not called.endswith(".py") else "python -m behavexplor"
