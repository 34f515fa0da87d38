"""Specs written by users: functions that return the signed robustness of a trace, loaded by name.

A user's spec is any callable that takes a `behavexplor.data.trace.Trace` and returns its signed robustness, as in
signal temporal logic. The robustness is negative if the trace violates the requirement. Otherwise, it is the distance
from a violation, in any unit. `behavexplor.judge.stl` helps to write such a function.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Final

import numpy as np

from behavexplor.data.trace import Trace
from behavexplor.errors import InputError, brief, place_of
from behavexplor.judge.specs import NOTHING_NEAR, SPECS, Spec

_NAME: Final = re.compile(r"[A-Za-z_][\w.-]{0,63}")
RESERVED: Final = frozenset({"error", "arrived", "other", "R1", "R2", "R3", *(spec.name for spec in SPECS)})


@dataclass(frozen=True)
class RobustnessSpec:
    """A requirement given by a function from a trace to its signed robustness.

    Raises:
        InputError: if the name cannot be used.
    """

    name: str  # name in records, classes and reports
    robustness: Callable[[Trace], Any]  # the function. A negative value means that the trace violates the requirement.
    source: str = field(default="", compare=False)  # origin of the function, for error messages

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name) or self.name in RESERVED:
            raise InputError(
                f"The spec {self.source or self.name} cannot be named {self.name!r}: give it an attribute `name` of "
                f"at most 64 letters, digits, '_', '-' and '.' that begins with a letter or '_' and is none of "
                f"{', '.join(sorted(RESERVED))}"
            )

    def degree(self, trace: Trace) -> float:
        """Return the robustness, limited to the range from 0 (a violation) to `NOTHING_NEAR`."""
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
            raise InputError(f"{self._called()} raised {type(error).__name__}: {error}{place_of(error)}") from error
        if isinstance(value, (bool, np.bool_, str, bytes)) or value is None:
            raise InputError(f"{self._called()} returned {brief(value)}: {_WANTED}")
        try:
            number = float(value)
        except (TypeError, ValueError, OverflowError):
            raise InputError(f"{self._called()} returned {brief(value)}: {_WANTED}") from None
        if np.isnan(number):
            raise InputError(f"{self._called()} returned {brief(value)}: {_WANTED}")
        return number

    def _called(self) -> str:
        return f"The spec {self.name!r}" + (f" ({self.source})" if self.source not in ("", self.name) else "")


_WANTED: Final = "it must return a number, negative if the trace violates the requirement"


def as_spec(found: Any, source: str = "") -> Spec:
    """Make a spec from a callable that takes a trace, or from a class whose instances are such callables.

    The spec is named by the callable's attribute `name`, or else its `__name__`. `source` is for error messages.

    Raises:
        InputError: if `found` is not callable, or its name cannot be used.
    """
    made = _instance(found, source) if isinstance(found, type) else found
    if not callable(made):
        raise InputError(f"The spec {source or brief(made)} is not callable: give a function that takes a Trace")
    name = getattr(made, "name", None) or getattr(made, "__name__", None) or type(made).__name__
    return RobustnessSpec(str(name), made, source)


def load_specs(names: Sequence[str]) -> tuple[Spec, ...]:
    """Return the specs of a campaign: R1, R2, R3, and the user's own specs, each named "package.module:attribute".

    Raises:
        InputError: if a spec cannot be imported or used, or two specs have the same name.
    """
    specs = (*SPECS, *map(load_spec, names))
    known: set[str] = set()
    for spec in specs:
        if spec.name in known:
            raise InputError(f"Two specs are named {spec.name!r}: give each a name of its own")
        known.add(spec.name)
    return specs


def load_spec(name: str) -> Spec:
    """Import a user's spec, named "package.module:attribute".

    Raises:
        InputError: if the spec cannot be imported or used.
    """
    module, _, attribute = name.partition(":")
    if not module or not attribute:
        raise InputError(f"The spec {name!r} must be written as package.module:attribute, such as my_specs:brakes")
    try:
        found = getattr(import_module(module), attribute)
    except Exception as error:  # a module can raise anything when it is imported
        hint = " (searched in this folder and on PYTHONPATH)" if isinstance(error, ImportError) else ""
        raise InputError(f"The spec {name!r} cannot be imported: {type(error).__name__}: {error}{hint}") from error
    return as_spec(found, name)


def _instance(kind: type[Any], source: str) -> Any:
    try:
        return kind()
    except Exception as error:
        raise InputError(f"The spec {source} cannot be constructed: {type(error).__name__}: {error}") from error
