"""The pool of a retraining: scenarios in which the policy fails, from which some of the training episodes are drawn."""

import hashlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from behavexplor.data.durable import write_durably
from behavexplor.data.logical import LogicalScenario
from behavexplor.data.scenario import Scenario, parse_scenario
from behavexplor.data.untrusted import read_file
from behavexplor.errors import InputError
from behavexplor.evaluation import outcomes_of
from behavexplor.training import Learned, TrainingReporter

FULL: Final = 100  # scenarios that a pool needs to be drawn from with its full share
MOST: Final = 2000  # scenarios in a pool; the newest are kept


class Pool:
    """Scenarios in which a policy fails at present. It follows the policy.

    A scenario enters when the policy fails in it by its own fault. It leaves when an episode in it ends otherwise.

    Args:
        logical: logical scenario from which all other episodes are drawn.
        share: probability that an episode is drawn from the pool. It is lower, in proportion, for a pool of fewer than
            `FULL` scenarios, so that a few scenarios that cannot be mended do not fill the training.
        scenarios: the first scenarios.
    """

    def __init__(self, logical: LogicalScenario, share: float, scenarios: Iterable[Scenario] = ()) -> None:
        self._logical = logical
        self._share = share
        self._scenarios: list[Scenario] = []
        self._known: set[Scenario] = set()
        for scenario in scenarios:
            self.add(scenario)

    def __len__(self) -> int:
        """Return the number of scenarios."""
        return len(self._scenarios)

    def sample(self, rng: np.random.Generator) -> Scenario:
        """Draw the scenario of an episode."""
        if self._scenarios and rng.random() < self._share * min(len(self._scenarios) / FULL, 1.0):
            return self._scenarios[int(rng.integers(len(self._scenarios)))]
        return self._logical.sample(rng)

    def add(self, scenario: Scenario) -> None:
        """Add a scenario in which the policy failed. If the pool is full, the oldest one leaves."""
        if scenario in self._known:
            return
        self._known.add(scenario)
        self._scenarios.append(scenario)
        if len(self._scenarios) > MOST:
            self._known.discard(self._scenarios.pop(0))

    def discard(self, scenario: Scenario) -> None:
        """Remove a scenario in which the policy did not fail by its own fault, if the pool has it."""
        if scenario in self._known:
            self._known.discard(scenario)
            self._scenarios.remove(scenario)

    @property
    def digest(self) -> str:
        """SHA-256 of the scenarios in their order."""
        return hashlib.sha256(self._text().encode()).hexdigest()

    def write(self, path: Path) -> None:
        """Write the scenarios to a file, one as JSON in each line."""
        write_durably(path, self._text())

    def _text(self) -> str:
        return "".join(f"{scenario.to_json()}\n" for scenario in self._scenarios)


def read_pool(path: Path) -> list[Scenario]:
    """Return the scenarios of a file that `Pool.write` wrote.

    Raises:
        InputError: if the file cannot be read, or a scenario is not valid.
    """
    try:
        lines = read_file(path).decode().splitlines()
    except (OSError, ValueError) as error:
        raise InputError(f"The pool {path} cannot be read: {error}") from None
    return [parse_scenario(line) for line in lines]


class PoolReporter(TrainingReporter):
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
