"""A pool that follows a training."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from behavexplor.evaluation import outcomes_of
from behavexplor.repair.scenario_pool import Pool
from behavexplor.training import Learned, Watch


class PoolWatch(Watch):
    """Callback that keeps a pool up to date with the ends of the training's episodes.

    A scenario leaves the pool when an episode in it ends without a failure at fault.

    Args:
        observe: callback that gets the progress after each batch of experience.
        pool: the pool.
        own: whether a scenario enters the pool when an episode in it ends with a failure at fault.
    """

    def __init__(self, observe: Callable[[Learned], None], pool: Pool, *, own: bool) -> None:
        super().__init__(observe)
        self._pool = pool
        self._own = own
        self._running: list[Any] = []

    def _on_training_start(self) -> None:
        super()._on_training_start()
        self._running = self.training_env.get_attr("scenario")

    def _on_step(self) -> bool:
        for i in np.flatnonzero(self.locals["dones"]).tolist():
            self._ended(self._running[i], self.locals["infos"][i])
            (self._running[i],) = self.training_env.get_attr("scenario", [i])
        return super()._on_step()

    def _on_rollout_end(self) -> None:
        self.logger.record("pool/scenarios", len(self._pool))
        super()._on_rollout_end()

    def _ended(self, scenario: Any, info: Mapping[str, Any]) -> None:
        if not outcomes_of(info["trace"]).at_fault:
            self._pool.discard(scenario)
        elif self._own:
            self._pool.add(scenario)
