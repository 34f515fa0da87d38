"""Captions of replays."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from behavexplor.campaign.record import Record

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


def outcome(record: Record) -> str:
    """Describe the outcome of an execution, to follow its number."""
    violated = " and ".join(record.violated) or "nothing"
    return f"violates {violated}, ended by {_ENDED_BY[record.end]}"
