"""highway-env's own code, computing with the C library's trigonometry.

numpy's differs from it in the last bit on some processors. highway-env's steering towards a lane is unstable below
about 1 m/s, so that a last bit grows to meters: an episode could not be repeated on another machine, nor would the
kernels of the vector environment, which use the C library, go the same way.
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
    """The same code with other trigonometry, for use as a method of a subclass.

    Args:
        function: of highway-env; its module knows numpy as `np`, and it applies trigonometry to numbers only.
    """
    original = cast("FunctionType", function)
    names = {**original.__globals__, "np": _NUMPY}
    copy = FunctionType(original.__code__, names, original.__name__, original.__defaults__, original.__closure__)
    return cast("Function", copy)
