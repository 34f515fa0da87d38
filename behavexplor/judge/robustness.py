"""Specs of users: callables that give a trace's signed robustness, loaded by name.

A spec of a user is any callable on a `behavexplor.data.trace.Trace` that returns a signed robustness, as signal
temporal logic defines it: negative if the trace violates the requirement, else how far it is from violating it, in a
unit of its own. `behavexplor.judge.stl` helps to write one.
"""

import re
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Final

import numpy as np

from behavexplor.data.trace import Trace
from behavexplor.errors import InputError, brief
from behavexplor.judge.specs import NOTHING_NEAR, SPECS, Spec

_NAME: Final = re.compile(r"[A-Za-z_][\w.-]{0,63}")
RESERVED: Final = frozenset({"error", "arrived", "other", "R1", "R2", "R3", *(spec.name for spec in SPECS)})


@dataclass(frozen=True)
class RobustnessSpec:
    """A requirement given by a function from a trace to its signed robustness.

    Attributes:
        name: name in records, classes and reports.
        robustness: the function. A negative value means that the trace violates the requirement.
        source: where the function comes from, for error messages.

    Raises:
        InputError: if the name cannot be used.
    """

    name: str
    robustness: Callable[[Trace], Any]
    source: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name) or self.name in RESERVED:
            raise InputError(
                f"The spec {self.source or self.name} is named {self.name!r}. A name has letters, digits, '_', '-' and "
                f"'.', begins with a letter, and is none of {', '.join(sorted(RESERVED))}: give it an attribute `name`"
            )

    def degree(self, trace: Trace) -> float:
        """Return the robustness where it is positive, at most `NOTHING_NEAR`; 0 for a violation."""
        return min(max(self(trace), 0.0), NOTHING_NEAR)

    def violated(self, trace: Trace) -> bool:
        """Return whether the robustness is negative."""
        return self(trace) < 0.0

    def __call__(self, trace: Trace) -> float:
        """Return the robustness of a trace.

        Raises:
            InputError: if the function raises, or does not return a number.
        """
        try:
            value = self.robustness(trace)
        except Exception as error:
            raise InputError(f"{self._called()} raised {type(error).__name__}: {error}{_place(error)}") from error
        if isinstance(value, (bool, np.bool_, str, bytes)) or value is None:
            raise InputError(f"{self._called()} returned {brief(value)}: {_WANTED}")
        try:
            number = float(value)
        except (TypeError, ValueError):
            raise InputError(f"{self._called()} returned {brief(value)}: {_WANTED}") from None
        if np.isnan(number):
            raise InputError(f"{self._called()} returned {brief(value)}: {_WANTED}")
        return number

    def _called(self) -> str:
        return f"The spec {self.name!r}" + (f" ({self.source})" if self.source not in ("", self.name) else "")


_WANTED: Final = "it must return a number, negative if the trace violates the requirement"


def as_spec(found: Any, source: str = "") -> Spec:
    """Return a spec for a callable, or for a class that makes one.

    Args:
        found: a callable on a trace; its name is its attribute `name`, or else its `__name__`.
        source: where it comes from, for error messages.

    Raises:
        InputError: if it is not callable, or has no name that can be used.
    """
    made = _instance(found, source) if isinstance(found, type) else found
    if not callable(made):
        raise InputError(f"The spec {source or brief(made)} is not callable: give a function of a Trace")
    name = getattr(made, "name", None) or getattr(made, "__name__", None) or type(made).__name__
    return RobustnessSpec(str(name), made, source)


def load_specs(names: Sequence[str]) -> tuple[Spec, ...]:
    """Return the specs of a campaign: R1, R2, R3, and those of the user.

    Args:
        names: specs of the user, each as "package.module:attribute".

    Raises:
        InputError: if one cannot be imported or used, or two have the same name.
    """
    specs = (*SPECS, *map(load_spec, names))
    known: set[str] = set()
    for spec in specs:
        if spec.name in known:
            raise InputError(f"Two specs are named {spec.name!r}: give each a name of its own")
        known.add(spec.name)
    return specs


def load_spec(name: str) -> Spec:
    """Return the spec of a user.

    Args:
        name: the spec as "package.module:attribute".

    Raises:
        InputError: if it cannot be imported or used.
    """
    module, _, attribute = name.partition(":")
    if not module or not attribute:
        raise InputError(f"The spec {name!r} must be written as package.module:attribute, such as my_specs:brakes")
    try:
        found = getattr(import_module(module), attribute)
    except Exception as error:  # a module can raise anything when it is imported
        hint = ", which is looked for in this folder and on PYTHONPATH" if isinstance(error, ImportError) else ""
        raise InputError(f"The spec {name!r} cannot be imported: {type(error).__name__}: {error}{hint}") from error
    return as_spec(found, name)


def _instance(kind: type[Any], source: str) -> Any:
    try:
        return kind()
    except Exception as error:
        raise InputError(f"The spec {source} cannot be made: {type(error).__name__}: {error}") from error


def _place(error: Exception) -> str:
    """Return the file and line where an exception was raised."""
    frames = traceback.extract_tb(error.__traceback__)
    return f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if len(frames) > 1 else ""
