"""The yardstick of behavior: how new each execution of a campaign is, whatever method asked for it."""

from dataclasses import dataclass, field

from behavexplor.behavior.miner import BehaviorMiner, MinerOptions
from behavexplor.data.trace import Trace
from behavexplor.fuzz.options import check_range

NOVELTY_THRESHOLD = 0.4  # the paper's theta_c


@dataclass(frozen=True)
class NoveltyOptions:
    """What counts as a distinct behavior.

    Attributes:
        threshold: least distance between distinct behaviors, exclusive.
        miner: how behaviors are abstracted.

    Raises:
        InputError: if the threshold is not in [0, 1].
    """

    threshold: float = NOVELTY_THRESHOLD
    miner: MinerOptions = field(default_factory=MinerOptions)

    def __post_init__(self) -> None:
        check_range("threshold", self.threshold, 0, 1)


class NoveltyArchive:
    """The distinct behaviors of a campaign; failing runs behave, too.

    It is no part of any search method, so all of them are scored by the same code. Its length is the number of
    distinct behaviors.
    """

    def __init__(self, options: NoveltyOptions | None = None) -> None:
        self.options = options = options or NoveltyOptions()
        self._miner = BehaviorMiner(options.miner)

    def __len__(self) -> int:
        return len(self._miner)

    def observe(self, trace: Trace) -> float:
        """The novelty of a trace: the least distance to the distinct behaviors so far, 1 if there are none.

        If it is novel it becomes one of them.
        """
        behavior = self._miner.describe(trace)
        distances = self._miner.distances(self._miner.abstract(behavior.merged))
        novelty = float(distances.min(initial=1.0))
        if novelty > self.options.threshold or not len(self):
            self._miner.add(behavior)
            if self._miner.due:
                self._miner.fit()
        return novelty
