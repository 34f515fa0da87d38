"""Flags that several commands share, or that are fields of a configuration; and the note that a driver is loading.

The help text of a flag is in the docstring of its command's function, or of the dataclass that it is a field of: a
group of flags (such as `Running` here), or the configuration (`CampaignConfig`, `Target`).
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, dataclass, fields
from inspect import Parameter, Signature, cleandoc
from pathlib import Path
from threading import Timer
from typing import Annotated, Any, Final, get_args, get_origin, get_type_hints

import tyro

from behavexplor.campaign.config import read_yaml
from behavexplor.campaign.provenance import JUDGED, AcceptedConfig, Consent
from behavexplor.campaign.same_driver import accepted_run
from behavexplor.data.target import Activation
from behavexplor.errors import InputError
from behavexplor.execution.executor import MOST_WORKERS, available_cores

Switch = tyro.conf.FlagCreatePairsOff[bool]  # off without the flag
RunFolder = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
NewFolder = Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
Trust = Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="DIGEST")]
GivenActivation = Annotated[
    Activation | None, tyro.conf.DisallowNone, tyro.conf.arg(metavar="NAME", help_behavior_hint="")
]
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
WAITING: Final = "Loading the driver; first-time compilation can take a minute ..."


def flag(metavar: str, default: object) -> Any:
    """Return tyro's settings of a flag whose parameter is None if it is not given.

    Args:
        metavar: name of the flag's value in the help text.
        default: what holds without the flag, for the help text; None to show nothing.
    """
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=f"(default: {default})" if default is not None else "")


@dataclass(frozen=True)
class Running:
    """How a command runs again the driver that a folder names.

    Attributes:
        workers: Number of worker processes (no effect on the results). 0: this process, with no limits for the driver;
            a driver that is not shipped with behavexplor then needs --unconfined.
        trust: Allow the folder or policy file with this digest ("sha256:...") to execute code. May be repeated.
        unconfined: Allow a driver that is not shipped with behavexplor to write files and use the network.
        quiet: Print only the result.
    """

    workers: Annotated[int | None, flag("N", "the cores")] = None
    trust: Trust = ()
    unconfined: Switch = False
    quiet: Switch = False

    @property
    def n_workers(self) -> int:
        """Number of worker processes; see `chosen_workers`."""
        return chosen_workers(self.workers)

    def accepted_config(self, run: Path) -> AcceptedConfig:
        """Return the configuration of a run, whose driver drives again and whose specs judge."""
        return accepted_run(run, Consent(self.trust, self.unconfined), JUDGED)


HowToRun = Annotated[Running, tyro.conf.arg(name="")]  # a parameter whose fields are flags


def settings(kind: type, names: str, box: str = "", **other: tuple[object, str]) -> Any:
    """Return tyro's settings of a parameter that is a group of flags, one for each of some fields of a dataclass.

    Name, type, default and description of a flag are those of the field. The parameter gets the values of the flags
    that were given, by the names of the fields.

    Args:
        kind: the dataclass.
        names: its fields that are flags, such as "env ads seed", in the order of the help text.
        box: title of the flags in the help text, if they have a box of their own there.
        other: by field, the default that the help text shows instead of the field's, and a text that is added to the
            description. They change no value.
    """
    texts, types = described(kind), get_type_hints(kind)
    defaults = {one.name: one.default for one in fields(kind)}
    parameters = []
    for name in names.split():
        shown, more = other.get(name, (defaults[name], ""))
        argument = tyro.conf.arg(
            name=_SINGULAR.get(name, name),
            prefix_name=False,
            metavar=_METAVARS.get(name) or _METAVARS.get(types[name]),
            help_behavior_hint="" if shown in (MISSING, None, ()) else f"(default: {shown})",
            help=f"{texts.get(name, '')}{more}",  # python -OO has no descriptions
        )
        parameters.append(_flag_parameter(name, types[name], argument))
    return tyro.conf.arg(name=box, constructor=_taker(parameters))


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


def _taker(parameters: Sequence[Parameter]) -> Callable[..., dict[str, Any]]:
    """Return a function with these parameters that returns those that were given, with the contents of YAML files."""

    def given(**values: Any) -> dict[str, Any]:
        found = {name: value for name, value in values.items() if value not in (None, ())}
        return {name: read_env_config(value) if isinstance(value, Path) else value for name, value in found.items()}

    given.__signature__ = Signature(parameters)  # type: ignore[attr-defined]  # tyro reads it
    given.__annotations__ = {**{one.name: one.annotation for one in parameters}, "return": dict[str, Any]}
    return given


def read_env_config(file: Path) -> dict[str, Any]:
    """Read the YAML file that --env-config names; see `behavexplor.campaign.config.read_yaml`."""
    return read_yaml(file, "lanes_count: 3")


def described(kind: type) -> dict[str, str]:
    """Return the descriptions of a dataclass's fields by name, from its docstring and from those of its parents."""
    found: dict[str, str] = {}
    for cls in kind.__mro__[::-1]:
        listed = cleandoc(cls.__doc__ or "").partition("Attributes:\n")[2].partition("\n\n")[0]
        entries = re.findall(r"^    (\w+): (.*(?:\n {8}.*)*)", listed, re.MULTILINE)
        found |= {name: " ".join(text.split()) for name, text in entries}
    return found


def check_unchanged(given: Mapping[str, Any], stored: Any, what: str) -> None:
    """Check that flags beside --resume do not change the configuration of what is resumed.

    `given` has their values by the keys of the stored configuration, and `what` names what is resumed, for the message.

    Raises:
        InputError: if a value differs.
    """
    for name, value in given.items():
        if value != getattr(stored, name):
            option = name.replace("_", "-")
            raise InputError(f"--{option} cannot be changed with --resume: the {what} has {getattr(stored, name)!r}")


def chosen_workers(workers: int | None) -> int:
    """Return the number of worker processes on this machine; by default one for each available core.

    Raises:
        InputError: if the number is out of range.
    """
    if workers is None:
        return min(available_cores(), MOST_WORKERS)
    if not 0 <= workers <= MOST_WORKERS:
        raise InputError(f"--workers {workers} must lie between 0 and {MOST_WORKERS}")
    return workers


@contextmanager
def patience(say: Callable[[str], object], note: str = WAITING, after: float = 5.0) -> Iterator[None]:
    """Say something if the code in this context takes longer than `after` seconds."""
    timer = Timer(after, say, [note])
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
