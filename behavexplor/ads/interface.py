"""The interface of a driving system under test (ADS): three attributes and a `predict` method.

`predict` has the signature of Stable-Baselines3's `predict` and receives a batch of B observations at once. So a
trained policy is an ADS as it stands, once it has the attributes that name its observations and actions.
"""

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray


@runtime_checkable
class ADS(Protocol):
    """A driving system under test.

    Attributes:
        observation: highway-env's observation configuration; `{"type": "Scene"}` selects the observation of
            `behavexplor.data.scene`.
        action: highway-env's action configuration.
        policy_frequency: decisions per second [Hz].

    An ADS whose attribute `vectorized` is true drives many episodes in lock-step, which is much faster. It receives B
    observations at once, keeps nothing but `state` between two calls, and answers each row independently of the other
    rows. Rows of zeros stand for absent egos, and the actions for them are ignored. Any other ADS drives one episode at
    a time, B = 1.
    """

    @property
    def observation(self) -> Mapping[str, Any]:
        """The observation configuration of highway-env, or `{"type": "Scene"}`."""
        ...

    @property
    def action(self) -> Mapping[str, Any]:
        """The action configuration of highway-env."""
        ...

    @property
    def policy_frequency(self) -> int:
        """Decisions per second [Hz]."""
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
            observation: observations, shape (B, ...).
            state: state returned by the last call; None at first.
            episode_start: True for each row that begins an episode, whose part of `state` is forgotten, shape (B,).
            deterministic: True if the same input must always give the same actions.

        Returns:
            The actions, shape (B, ...), and the state for the next call.
        """
        ...


@runtime_checkable
class DecisionLog(Protocol):
    """An ADS that also reports its last decisions, which become part of the trace."""

    def log(self, state: Any) -> Mapping[str, NDArray[Any]]:
        """Return the last decisions by name, arrays of shape (B, ...), from the state that `predict` returned."""
        ...
