"""The interface of a driving system under test (ADS): three attributes and a `predict` method.

`predict` has the signature of Stable-Baselines3's `predict` and receives a batch of B observations at once. So a
trained policy becomes an ADS as soon as it has the attributes that define its observations and actions.
"""

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

from behavexplor.data.array_types import Array, Bools, Floats


@runtime_checkable
class ADS(Protocol):
    """A driving system under test.

    Attributes:
        observation: highway-env's observation configuration; `{"type": "Scene"}` selects the observation of
            `behavexplor.data.scene`.
        action: highway-env's action configuration.
        policy_frequency: decisions per second [Hz].

    An ADS whose attribute `vectorized` is true drives many episodes in lock-step, which is much faster. It receives B
    observations at once, keeps no information except `state` between two calls, and chooses the action for each row
    independently of the other rows. A row of zeros stands for an absent ego, and the action for it is ignored. Any
    other ADS drives one episode at a time, with B = 1.
    """

    @property
    def observation(self) -> Mapping[str, Any]:
        """The observation configuration of highway-env, or `{"type": "Scene"}`."""

    @property
    def action(self) -> Mapping[str, Any]:
        """The action configuration of highway-env."""

    @property
    def policy_frequency(self) -> int:
        """Decisions per second [Hz]."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Bools | None = None, deterministic: bool = True
    ) -> tuple[Array, Any]:
        """Choose the actions of a batch of egos.

        Args:
            observation: observations, an array of shape (B, ...). If the environment's observation space is
                gymnasium's `Dict`, a dictionary of such arrays.
            state: state returned by the last call; None in the first call.
            episode_start: True for each row in which an episode begins, shape (B,); None if no row does. The part of
                `state` that belongs to such a row must be discarded.
            deterministic: True if the same input must always give the same actions.

        Returns:
            The actions, shape (B, ...), and the state for the next call.
        """


@runtime_checkable
class StochasticADS(Protocol):
    """An ADS that decides deterministically in `predict`, and can also draw its actions.

    Attributes:
        noise: number of random numbers that an action needs; 0 if the ADS cannot draw its actions.
    """

    noise: int

    def draw(self, observation: Any, state: Any, episode_start: Bools | None, noise: Floats) -> tuple[Array, Any]:
        """Draw the actions of a batch of egos by `noise`, independent uniform numbers in [0, 1), shape (B, self.noise).

        The same numbers give the same actions. For the rest, see `ADS.predict`.
        """


@runtime_checkable
class DecisionLog(Protocol):
    """An ADS that also reports its latest decisions, which become part of the trace."""

    def log(self, state: Any) -> Mapping[str, Array]:
        """Return the last decisions by name, from the state that `predict` returned.

        Returns:
            Arrays of numbers, shape (B, ...): a row for each ego. Names and shapes are the same at every decision of an
            episode.
        """
