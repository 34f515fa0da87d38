"""Imports that a command will need in its workers, begun before the command itself is imported and parsed."""

from collections.abc import Sequence
from typing import Final

from behavexplor.execution.shared_imports import share_imports, slow_modules

_OTHER_PLACES: Final = ("--help", "-h", "--config", "--resume", "--cluster")  # no workers, or their target is in a file


def begin_imports(arguments: Sequence[str]) -> None:
    """Begin to import what the workers of a campaign need, if the arguments of `fuzz` say what that is.

    The imports of the command and those of its workers take a second each. If the arguments are misread here, the
    workers import later what they need.
    """
    if not arguments or arguments[0] != "fuzz" or any(name in arguments for name in _OTHER_PLACES):
        return
    if _value(arguments, "--workers", "") != "0":
        env, ads = _value(arguments, "--env", "intersection-straight"), _value(arguments, "--ads", "rule")
        share_imports(("behavexplor.execution.evaluator", *slow_modules(env, ads)))


def _value(arguments: Sequence[str], name: str, default: str) -> str:
    """Return the value of a flag."""
    for argument, following in zip(arguments, [*arguments[1:], ""], strict=True):
        if argument == name:
            return following
        if argument.startswith(f"{name}="):
            return argument.partition("=")[2]
    return default
