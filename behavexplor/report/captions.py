"""Captions of replays."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final

_ENDED_BY: Final[Mapping[str, str]] = MappingProxyType(
    {
        "collision": "a collision",
        "arrived": "its arrival",
        "passed": "passing its destination",
        "standstill": "standing still",
        "timeout": "the time limit",
        "off-road": "leaving the road",
        "ended": "the environment",
        "error": "a failure of the ADS",
    }
)


def outcome(violated: Sequence[str], end: str) -> str:
    """Describe the outcome of an execution, to follow its number.

    Args:
        violated: names of the violated specs.
        end: kind of end, one of `behavexplor.data.trace.ENDS`.
    """
    return f"violates {' and '.join(violated) or 'nothing'}, ended by {_ENDED_BY[end]}"
