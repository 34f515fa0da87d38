"""The commands in one line each, and the help texts that tyro makes of docstrings, wrapped for the terminal."""

import re
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from inspect import cleandoc
from io import BytesIO, TextIOWrapper
from types import MappingProxyType
from typing import Any, Final

from behavexplor.commands.wording import WIDEST, hanging, say

GROUPS: Final[Mapping[str, Mapping[str, str]]] = MappingProxyType(
    {
        "Find failures": {
            "fuzz": "search for scenarios in which a driver fails",
            "evaluate": "measure how often a driver arrives, collides and leaves its lane",
            "compare": "drive the same scenarios with two drivers",
            "demo": "train a small policy, fuzz it and open the report",
        },
        "Look at them": {
            "status": "figures of a run, also while it is being written",
            "report": "one page about one or several runs",
            "replay": "draw an execution and drive it again",
            "records": "every execution as a line of JSON",
            "export": "executions as files for other simulators",
            "import": "a scenario from an exported scene",
        },
        "Understand and mend them": {
            "triage": "whose fault failures were, and how they could be avoided",
            "minimize": "the simplest scenario of each class of failures",
            "suite": "these scenarios as regression tests",
            "check": "drive the scenarios of a suite",
            "retrain": "train a policy further on scenarios in which it fails",
        },
        "Research": {
            "bench": "compare search methods in an experiment",
            "envs": "list the environments",
            "inspect": "what a policy's file holds, and where it drives",
            "train": "train a policy with PPO on S1 to S4",
            "zip": "a network of `train` as a model of Stable-Baselines3",
        },
    }
)
COMMANDS: Final = tuple(name for group in GROUPS.values() for name in group)


def overview(program: str) -> str:
    """Return all commands, in groups, with a line for each."""
    lines = [f"usage: {program} COMMAND ...", "", "Find out how a driving policy fails."]
    for title, commands in GROUPS.items():
        lines += ["", title, *(hanging(f"  {name:9} ", text) for name, text in commands.items())]
    return "\n".join([*lines, "", f"The flags of a command: {program} COMMAND --help"])


@contextmanager
def changed_output(change: Callable[[str], str]) -> Iterator[None]:
    """Hold back what is printed, and print it changed at the end."""
    held = TextIOWrapper(BytesIO(), getattr(sys.stdout, "encoding", None) or "utf-8", newline="\n")
    try:
        with redirect_stdout(held):
            yield
    finally:
        held.seek(0)
        say(change(held.read()), end="")


def with_wrapped_usage(text: str) -> str:
    """Return a help text of tyro with its first line broken where the terminal ends, which tyro does not do."""
    first, _, rest = text.partition("\n")
    usage, _, flags = first.partition(" [-h]")
    return f"{hanging(f'{usage} ', f'[-h]{flags}')}\n{rest}" if flags else text


def with_names(script: str, names: Mapping[str, Sequence[str]]) -> str:
    """Return a completion script of tyro that also completes the values of flags, and files where nothing else fits.

    Args:
        script: the script.
        names: the values by flag.
    """
    for flag, known in names.items():
        script = re.sub(rf"(\['{flag}'\], .*?'type': )'path'", rf"\1'choice', 'choices': {list(known)}", script)
    script = script.replace("    return completions\n\n", "    return completions or ['__TYRO_COMPLETE_FILES__']\n\n")
    return script.replace("complete -F ", "complete -o default -F ")  # otherwise bash offers no files


def with_joined_lines(command: Callable[..., Any]) -> Callable[..., Any]:
    """Return a command whose docstring has one line for each argument.

    tyro keeps the ends of lines in a docstring, which would cut sentences in the boxes of its help.
    """
    head, title, arguments = cleandoc(command.__doc__ or "").partition("\n\nArgs:\n")
    command.__doc__ = head + title + re.sub(r"\n {5,}", " ", arguments)
    return command


def wrapped_head(command: Callable[..., Any]) -> str:
    """Return what a command's docstring says before its arguments, wrapped for the terminal.

    The lines of a paragraph are indented, because tyro would join those that begin with a letter.
    """
    head = (command.__doc__ or "").partition("\n\nArgs:\n")[0]
    wrapper = textwrap.TextWrapper(min(shutil.get_terminal_size().columns, WIDEST), subsequent_indent="  ")
    return "\n\n".join(wrapper.fill(" ".join(part.split())) for part in head.split("\n\n"))
