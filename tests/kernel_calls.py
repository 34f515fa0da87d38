"""Calls of functions that the package compiles only as parts of kernels, so that tests can call them one by one."""

from collections.abc import Callable
from typing import Any

from behavexplor.jit import kernel_in_place


def called_alone(part: Any) -> Callable[..., Any]:
    """Compile a part as a kernel of its own, see `behavexplor.jit.kernel_inner`. The machine code is cached."""
    return kernel_in_place(part.py_func)
