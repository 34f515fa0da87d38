"""The arguments of a command, read by tyro. A wrong value is said in a sentence, and a flag is given once."""

import re
import sys
import types
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr
from functools import partial, wraps
from io import StringIO
from typing import Any, Final, Literal, Union, get_args, get_origin

from tyro import cli
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from behavexplor.errors import InputError, printable

SEVERAL_TIMES: Final = frozenset({"--spec", "--trust"})  # flags that may be given so
_NUMBERS: Final[Mapping[Any, str]] = {int: "a whole number", float: "a number, such as 0.05"}
_VALUE: Final = re.compile("Error parsing ([^:]+): (.*?) [\N{BOX DRAWINGS LIGHT HORIZONTAL}-]{5,}")  # to the next rule
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

    said = StringIO()
    try:
        with redirect_stderr(said):
            run: Callable[[], int] = cli(with_values, args=given, registry=_registry(), **settings)
    except SystemExit:
        if wrong := _wrong_value(said.getvalue()):
            raise InputError(wrong) from None
        sys.stderr.write(said.getvalue())
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
        return found[2] if name.islower() and not name.startswith("-") else f"{name} {found[2]}"  # of several flags
    if found := _CHOICE.search(text):
        known = ", ".join(sorted(re.findall(r"'(.*?)'", found[3])))
        return f"{found[2]} {found[1]} must be one of {known}"
    return ""


def _registry() -> ConstructorRegistry:
    """Return how values are read that tyro would describe by Python's types, or together with None."""
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
