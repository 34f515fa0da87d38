"""Drawn actions: a stochastic policy drives as in its training, with a stream of random numbers for each episode.

The stream depends on the scenario alone. So an episode can be repeated exactly, whichever episodes run beside it.
"""

import hashlib
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.observations import Observation
from behavexplor.data.scenario import Scenario

STREAM: Final = 0x64_72_61_77  # separates these random numbers from others


class DrawnActions:
    """Draws actions from the distribution of a stochastic policy, see `behavexplor.ads.interface.StochasticADS`."""

    def __init__(self, policy: Any, count: int) -> None:
        self._policy = policy
        self._streams = [np.random.default_rng(STREAM) for _ in range(count)]

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the policy, such as its decision log."""
        return getattr(self._policy, name)

    def begin(self, row: int, scenario: Scenario) -> None:
        """Begin the stream of an episode, which is in this row of the next observation."""
        digest = hashlib.sha256(scenario.to_json().encode()).digest()
        self._streams[row] = np.random.default_rng([STREAM, int.from_bytes(digest[:16])])

    def predict(
        self,
        observation: Observation,
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,  # noqa: ARG002 - the streams decide
    ) -> tuple[NDArray[Any], Any]:
        """Draw the actions of a batch of egos; see `behavexplor.ads.interface.ADS`."""
        noise = np.stack([stream.random(self._policy.noise) for stream in self._streams])
        answer: tuple[NDArray[Any], Any] = self._policy.draw(observation, state, episode_start, noise)
        return answer
