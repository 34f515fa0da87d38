"""The commands with their help texts, and the reading of their arguments, both by tyro.

A wrong value is reported in a sentence, and most flags may be given only once.
"""

import re
import shutil
import sys
import textwrap
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from functools import partial, wraps
from inspect import cleandoc
from io import BytesIO, StringIO, TextIOWrapper
from types import MappingProxyType
from typing import Any, Final, Literal, Union, get_args, get_origin

from tyro import cli
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from behavexplor.commands.wording import WIDEST, hanging, say
from behavexplor.errors import InputError, printable

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


SEVERAL_TIMES: Final = frozenset({"--spec", "--trust"})  # flags that may be given so
_NUMBERS: Final[Mapping[Any, str]] = {int: "a whole number", float: "a number, such as 0.05"}
_VALUE: Final = re.compile("Error parsing ([^:]+): (.*?) [\N{BOX DRAWINGS LIGHT HORIZONTAL}-]{5,}")  # up to a line
_CHOICE: Final = re.compile(r"invalid choice '(.*)' for argument '(.*)'. Expected one of \((.*?)\)")


def bound(command: Callable[..., int], given: Sequence[str], **settings: Any) -> Callable[[], int]:
    """Return a command with the values of its arguments. `settings` are those of `tyro.cli`.

    Raises:
        InputError: if a value cannot be read, or a flag is given twice.
    """
    _check_once(given)

    @wraps(command)
    def with_values(*values: Any, **named: Any) -> Callable[[], int]:
        return partial(command, *values, **named)

    messages = StringIO()
    try:
        with redirect_stderr(messages):
            run: Callable[[], int] = cli(with_values, args=given, registry=_registry(), **settings)
    except SystemExit:
        if wrong := _wrong_value(messages.getvalue()):
            raise InputError(wrong) from None
        sys.stderr.write(messages.getvalue())
        raise
    return run


def _check_once(given: Sequence[str]) -> None:
    names = [word.partition("=")[0].replace("_", "-") for word in given if word.startswith("--")]
    flags = [f"--{name[2:].removeprefix('no-')}" for name in names]
    for flag in flags:
        if flags.count(flag) > 1 and flag not in SEVERAL_TIMES:
            raise InputError(f"{flag} is given {flags.count(flag)} times: give it once")


def _wrong_value(box: str) -> str:
    """Return what tyro says about a wrong value in its box, as a sentence; empty if the box is about something else."""
    text = " ".join(line.strip("\N{BOX DRAWINGS LIGHT VERTICAL} ") for line in box.splitlines())
    if found := _VALUE.search(text):
        name = found[1].strip("[]. ")
        is_internal = name.islower() and not name.startswith("-")  # of the function that takes a group of flags
        return found[2] if is_internal else f"{name} {found[2]}"
    if found := _CHOICE.search(text):
        known = ", ".join(sorted(re.findall(r"'(.*?)'", found[3])))
        return f"{found[2]} {found[1]} must be one of {known}"
    return ""


def _registry() -> ConstructorRegistry:
    """Return rules for reading numbers and choices; tyro's own would show users the types of Python, and None."""
    made = ConstructorRegistry()
    made.primitive_rule(_number)
    made.primitive_rule(_choice)
    return made


def _number(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    kind = _without_none(info.type)
    several = get_origin(kind) is tuple and get_args(kind)[1:] == (...,)
    one = get_args(kind)[0] if several else kind
    if one not in _NUMBERS:
        return None

    def number(word: str) -> Any:
        try:
            return one(word)
        except ValueError:
            raise ValueError(f"{printable(word)} must be {_NUMBERS[one]}") from None

    name = one.__name__.upper()
    if several:
        return PrimitiveConstructorSpec(
            "*",
            name,
            lambda words: tuple(map(number, words)),
            lambda value: isinstance(value, tuple),
            lambda value: list(map(str, value)),
        )
    return _spec(name, lambda words: number(words[0]), lambda value: value is None or isinstance(value, one))


def _choice(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    kind = _without_none(info.type)
    if get_origin(kind) is not Literal or not all(isinstance(one, str) for one in get_args(kind)):
        return None
    known = get_args(kind)
    metavar = f"{{{','.join(known)}}}"
    return _spec(metavar, lambda words: words[0], lambda value: value is None or value in known, known)


def _spec(
    metavar: str, read: Callable[[list[str]], Any], fits: Callable[[Any], bool], choices: tuple[str, ...] | None = None
) -> PrimitiveConstructorSpec[Any]:
    return PrimitiveConstructorSpec(1, metavar, read, fits, lambda value: [str(value)], choices=choices)


def _without_none(kind: Any) -> Any:
    """Return a type, or the one that is given beside None."""
    kinds = [one for one in get_args(kind) if one is not type(None)]
    return kinds[0] if get_origin(kind) in (Union, types.UnionType) and len(kinds) == 1 else kind
