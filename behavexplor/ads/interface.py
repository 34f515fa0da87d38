"""What an automated driving system (ADS) is to this package: anything with these attributes and `predict`.

The signature is that of Stable-Baselines3's `predict`, asked for a batch of B observations at once, so that
a trained policy is an ADS as it stands once it says what it observes and what it commands.
"""

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray


@runtime_checkable
class ADS(Protocol):
    """An automated driving system.

    Attributes:
        observation: what it observes, as highway-env's observation configuration; `{"type": "Scene"}` is
            the one of `behavexplor.data.scene`.
        action: what it commands, as highway-env's action configuration.
        policy_frequency: how often it is asked [Hz].

    An ADS whose attribute `vectorized` is true drives many episodes in lock-step, which is much faster: it is asked for
    B of them at once, keeps nothing but `state` from one call to the next, and no row's answer depends on another row.
    Rows of zeros stand for no ego; what is answered to them does not count. Any other is asked for one episode at a
    time, B = 1.
    """

    @property
    def observation(self) -> Mapping[str, Any]:
        """highway-env's observation configuration, or `{"type": "Scene"}`."""
        ...

    @property
    def action(self) -> Mapping[str, Any]:
        """highway-env's action configuration."""
        ...

    @property
    def policy_frequency(self) -> int:
        """[Hz]."""
        ...

    def predict(
        self,
        observation: NDArray[Any],
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[Any], Any]:
        """Decide for a batch of egos.

        Args:
            observation: shape (B, ...).
            state: what the last call returned, None at first.
            episode_start: whether a row begins an episode, so that its part of `state` is forgotten, shape (B,).
            deterministic: whether the same input always gets the same answer.

        Returns:
            The actions, shape (B, ...), and the state to hand in next time.
        """
        ...


@runtime_checkable
class DecisionLog(Protocol):
    """An ADS that also says what it has just decided; what it says becomes part of the trace."""

    def log(self, state: Any) -> Mapping[str, NDArray[Any]]:
        """The record of the last decisions by name, each of shape (B, ...), from the state `predict` returned."""
        ...
