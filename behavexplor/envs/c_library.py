"""highway-env's code, run with the trigonometry of the C library and plain dot products instead of numpy's.

On some processors numpy's trigonometry differs from the C library's in the last bit, and the BLAS library fuses the
multiplication and the addition of a dot product. highway-env's steering toward a lane is unstable below about 1 m/s, so
a difference in the last bit grows to meters. With numpy's arithmetic, an episode would not repeat on another machine,
and it would diverge from the kernels of the vector environment.
"""

import math
from collections.abc import Callable
from functools import cache
from types import FunctionType, SimpleNamespace
from typing import TypeVar, cast

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

Function = TypeVar("Function", bound=Callable[..., object])


def _dot(a: Floats, b: Floats) -> float:
    """Return the dot product of two vectors of length 2, without the fused operations of some BLAS kernels."""
    return float(a[0] * b[0] + a[1] * b[1])


def _norm(a: Floats) -> float:
    """Return the norm of a vector of length 2."""
    return math.sqrt(_dot(a, a))


_NUMPY = SimpleNamespace(
    **vars(np)
    | {"sin": math.sin, "cos": math.cos, "tan": math.tan}
    | {"arcsin": math.asin, "arctan": math.atan, "arctan2": math.atan2}
    | {"dot": _dot, "linalg": SimpleNamespace(norm=_norm)}
)


@cache
def with_c_library(function: Function) -> Function:
    """Return a copy of a function that uses the C library and plain dot products, for use in a method of a subclass.

    Args:
        function: a function of highway-env, looked up at each call, since a program may replace it. Its module imports
            numpy as `np`, and it applies trigonometry to scalars, and `dot` and `linalg.norm` to vectors of length 2.
            A callable of another type is returned as it is.
    """
    if not isinstance(function, FunctionType):
        return function
    original = cast("FunctionType", function)
    names = {**original.__globals__, "np": _NUMPY}
    copy = FunctionType(original.__code__, names, original.__name__, original.__defaults__, original.__closure__)
    return cast("Function", copy)
