"""NoveltyArchive: the distinct behaviors of a campaign, by which all search methods are scored alike."""

from dataclasses import field
from typing import Annotated, Final

from behavexplor.behavior.miner import BehaviorMiner, MinerOptions
from behavexplor.data.trace import Trace
from behavexplor.data.validation import between, validated

NOVELTY_THRESHOLD: Final = 0.4  # a behavior is distinct if it is farther than this from all others; the paper's theta_c


@validated
class NoveltyOptions:
    """Options that define distinct behaviors.

    Raises:
        InputError: if the threshold is not in [0, 1].
    """

    threshold: Annotated[float, between(0, 1)] = NOVELTY_THRESHOLD  # distinct behaviors are farther apart than this
    miner: MinerOptions = field(default_factory=MinerOptions)


class NoveltyArchive:
    """The distinct behaviors of a campaign, including those of failed executions.

    The archive is independent of the search methods, so all of them are scored by the same code. Its length is the
    number of distinct behaviors.
    """

    def __init__(self, options: NoveltyOptions | None = None) -> None:
        self.options = options = options or NoveltyOptions()
        self._miner = BehaviorMiner(options.miner)

    def __len__(self) -> int:
        return len(self._miner)

    def observe(self, trace: Trace) -> float:
        """Return the novelty of a trace, and add its behavior to the archive if it is distinct.

        The novelty is the least distance from the distinct behaviors so far, or 1 if there are none.
        """
        behavior = self._miner.describe(trace)
        distances = self._miner.distances(self._miner.abstract(behavior))
        novelty = float(distances.min(initial=1.0))
        if novelty > self.options.threshold or not len(self):
            self._miner.add(behavior)
            if self._miner.due:
                self._miner.fit()
        return novelty
