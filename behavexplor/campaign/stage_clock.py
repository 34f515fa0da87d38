"""Where the time of a campaign goes: the time that its own process spends in each stage."""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any, Final

STARTING, ASKING, EXECUTING, WAITING, JUDGING, MINING, STORING = (
    "starting",
    "asking",
    "executing",
    "waiting",
    "judging",
    "mining",
    "storing",
)
STAGES: Final[Mapping[str, str]] = MappingProxyType(
    {
        STARTING: "loading the driver, its environment and the workers",
        ASKING: "choosing scenarios",
        EXECUTING: "driving in this process",
        WAITING: "waiting for worker processes, which drive",
        JUDGING: "reading and judging traces",
        MINING: "comparing behaviors and learning from results",
        STORING: "writing to disk",
    }
)

_MOST_SECONDS: Final = 1e12


class StageClock:
    """A clock that adds up the time in each stage. Stages do not overlap.

    Args:
        earlier: time in each stage before the campaign was resumed [s].

    Attributes:
        seconds: time in each stage since this clock was made [s].
    """

    def __init__(self, earlier: Mapping[str, float] = MappingProxyType({})) -> None:
        self._earlier = earlier
        self.seconds = dict.fromkeys(STAGES, 0.0)

    @contextmanager
    def during(self, stage: str) -> Iterator[None]:
        """Return a context whose time counts for a stage."""
        begun = time.monotonic()
        try:
            yield
        finally:
            self.seconds[stage] += time.monotonic() - begun

    @property
    def total(self) -> dict[str, float]:
        """Time in each stage, including the time before the campaign was resumed [s]."""
        return {stage: self._earlier.get(stage, 0.0) + seconds for stage, seconds in self.seconds.items()}


def known_stages(values: Any) -> dict[str, float]:
    """Return the stages and times in JSON values from a file, in order, without anything else that they hold."""
    given = values if isinstance(values, dict) else {}
    return {stage: float(given[stage]) for stage in STAGES if _is_time(given.get(stage))}


def _is_time(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value < _MOST_SECONDS
