"""Calls from Python of functions that the package compiles only as parts of other kernels."""

from collections.abc import Callable
from typing import Any

from behavexplor.jit import kernel_in_place


def called_alone(part: Any) -> Callable[..., Any]:
    """Return a kernel that is such a part alone, see `behavexplor.jit.kernel_inner`. Its machine code is cached."""
    return kernel_in_place(part.py_func)
