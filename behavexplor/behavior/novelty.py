"""NoveltyArchive: the distinct behaviors of a campaign, by which all search methods are scored alike."""

from typing import Final

from behavexplor.behavior.miner import BehaviorMiner, MinerOptions
from behavexplor.data.trace import Trace

NOVELTY_THRESHOLD: Final = 0.4  # a behavior is distinct if it is farther than this from all others; the paper's theta_c


class NoveltyArchive:
    """The distinct behaviors of a campaign, including those of failed executions.

    The archive is independent of the search methods, so all of them are scored by the same code. Its length is the
    number of distinct behaviors.
    """

    def __init__(self, options: MinerOptions | None = None) -> None:
        self._miner = BehaviorMiner(options or MinerOptions())

    def __len__(self) -> int:
        return len(self._miner)

    def observe(self, trace: Trace) -> float:
        """Return the novelty of a trace, and add its behavior to the archive if it is distinct.

        The novelty is the least distance from the distinct behaviors so far, or 1 if there are none.
        """
        behavior = self._miner.describe(trace)
        distances = self._miner.distances(self._miner.abstract(behavior))
        novelty = float(distances.min(initial=1.0))
        if novelty > NOVELTY_THRESHOLD or not len(self):
            self._miner.add(behavior)
            if self._miner.due:
                self._miner.fit()
        return novelty
