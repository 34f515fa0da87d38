"""highway-env's code, run with the trigonometry of the C library instead of numpy's.

On some processors the two differ in the last bit. highway-env's steering toward a lane is unstable below about 1 m/s,
so a difference in the last bit grows to meters. With numpy's trigonometry, an episode would not repeat on another
machine, and it would diverge from the kernels of the vector environment, which use the C library.
"""

import math
from collections.abc import Callable
from types import FunctionType, SimpleNamespace
from typing import TypeVar, cast

import numpy as np

Function = TypeVar("Function", bound=Callable[..., object])

_NUMPY = SimpleNamespace(
    **vars(np)
    | {"sin": math.sin, "cos": math.cos, "tan": math.tan}
    | {"arcsin": math.asin, "arctan": math.atan, "arctan2": math.atan2}
)


def with_c_library(function: Function) -> Function:
    """Return a copy of a function that uses the C library's trigonometry, for use as a method of a subclass.

    Args:
        function: a function of highway-env. Its module imports numpy as `np`, and it applies trigonometry to
            scalars only.
    """
    original = cast("FunctionType", function)
    names = {**original.__globals__, "np": _NUMPY}
    copy = FunctionType(original.__code__, names, original.__name__, original.__defaults__, original.__closure__)
    return cast("Function", copy)
