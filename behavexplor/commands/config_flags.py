"""Flags that are fields of a configuration, such as those of `fuzz` that are fields of `CampaignConfig`.

Names, types, defaults and help texts are written once, in the dataclass. tyro reads a group of flags from the signature
of a function, so `settings` makes a function whose signature follows from the fields.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields
from inspect import Parameter, Signature
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple, get_args, get_origin, get_type_hints

import docstring_parser
import tyro

from behavexplor.commands.shared_flags import read_env_config

_METAVARS: Final[Mapping[Any, str]] = {  # by field, or else by type
    "budget": "N|TIME",
    "trust": "DIGEST",
    "specs": "MODULE:NAME",
    "env_config": "FILE",
    "activation": "NAME",
    "share": "P",
    "rate": "RATE",
    str: "NAME",
    int: "N",
    int | None: "N",
}
_SINGULAR: Final = {"specs": "spec"}  # names of flags that differ from their fields, which are plural


class Shown(NamedTuple):
    """What the help text shows of a flag."""

    default: object  # in place of the field's default
    more: str = ""  # after the field's description


def settings(kind: type, names: str, box: str = "", **other: Shown) -> Any:
    """Return tyro's settings of a parameter that is a group of flags, one for each of some fields of a dataclass.

    Name, type, default and description of a flag are those of the field. The parameter gets the values of the flags
    that were given, by the names of the fields.

    Args:
        kind: the dataclass.
        names: its fields that are flags, such as "env ads seed", in the order of the help text.
        box: title of the flags in the help text, if they have a box of their own there.
        other: what the help text shows of some of the flags; it changes no value.
    """
    texts, types = field_descriptions(kind), get_type_hints(kind)
    defaults = {one.name: one.default for one in fields(kind)}
    parameters = []
    for name in names.split():
        shown = other.get(name, Shown(defaults[name]))
        argument = tyro.conf.arg(
            name=_SINGULAR.get(name, name),
            prefix_name=False,
            metavar=_METAVARS.get(name) or _METAVARS.get(types[name]),
            help_behavior_hint="" if shown.default in (MISSING, None, ()) else f"(default: {shown.default})",
            help=f"{texts.get(name, '')}{shown.more}",  # python -OO has no descriptions
        )
        parameters.append(_flag_parameter(name, types[name], argument))
    return tyro.conf.arg(name=box, constructor=_given_flags(parameters))


def _flag_parameter(name: str, kind: Any, argument: Any) -> Parameter:
    """Return the parameter of a flag that may be left out.

    The flag of a tuple is given several times, and that of a mapping is the path of a YAML file.
    """
    if get_origin(kind) is tuple:
        repeated = Annotated[kind, tyro.conf.UseAppendAction, argument]
        return Parameter(name, Parameter.KEYWORD_ONLY, default=(), annotation=repeated)
    if any(get_origin(one) in (dict, Mapping) for one in (kind, *get_args(kind))):
        kind = Path
    optional = Annotated[kind | None, tyro.conf.DisallowNone, argument]
    return Parameter(name, Parameter.KEYWORD_ONLY, default=None, annotation=optional)


def _given_flags(parameters: Sequence[Parameter]) -> Callable[..., dict[str, Any]]:
    """Return a function with these parameters that returns those that were given, with the contents of YAML files."""

    def given(**values: Any) -> dict[str, Any]:
        found = {name: value for name, value in values.items() if value not in (None, ())}
        return {name: read_env_config(value) if isinstance(value, Path) else value for name, value in found.items()}

    given.__signature__ = Signature(parameters)  # type: ignore[attr-defined]  # tyro reads it
    given.__annotations__ = {**{one.name: one.annotation for one in parameters}, "return": dict[str, Any]}
    return given


def field_descriptions(kind: type) -> dict[str, str]:
    """Return the descriptions of a dataclass's fields by name, from its docstring and from those of its parents."""
    found: dict[str, str] = {}
    for cls in kind.__mro__[::-1]:
        listed = docstring_parser.parse(cls.__doc__ or "").params
        found |= {one.arg_name: " ".join((one.description or "").split()) for one in listed}
    return found
