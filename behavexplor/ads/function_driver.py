"""A plain function of one observation as a driving system under test."""

import inspect
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.observations import Observation, mapped

DECLARED: Final = ("observation", "action", "policy_frequency", "simulation_frequency", "env_config")
_BY_POSITION: Final = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
_VARIADIC: Final = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


class FunctionDriver:
    """A function from one observation to one action, which drives one episode at a time.

    Attributes of the function that declare its observations and actions (`DECLARED`) are those of the driver. Without
    them, it observes and acts as the environment does by default.

    Args:
        function: the function.

    Attributes:
        is_function: True, so that messages speak of a function instead of `predict`.
    """

    vectorized = False
    is_function = True

    def __init__(self, function: Callable[[Any], Any]) -> None:
        self._function = function
        for name in DECLARED:
            if hasattr(function, name):
                setattr(self, name, getattr(function, name))

    def predict(
        self,
        observation: Observation,
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,  # noqa: ARG002 - the function keeps nothing
        deterministic: bool = True,  # noqa: ARG002
    ) -> tuple[NDArray[Any], Any]:
        """Choose the action of the only ego; see `behavexplor.ads.interface.ADS`."""
        action = self._function(mapped(_first, observation))
        return _row(action), state


def _row(action: Any) -> NDArray[Any]:
    """Return an action as a batch of one. An answer that cannot be an array is kept, and refused by its check."""
    try:
        return np.asarray(action)[None]
    except ValueError:
        kept = np.empty(1, dtype=object)
        kept[0] = action
        return kept


def _first(rows: NDArray[Any]) -> NDArray[Any]:
    first: NDArray[Any] = rows[0]
    return first


def takes_one_observation(function: Callable[..., Any]) -> bool:
    """Return whether a callable needs exactly one argument, and so takes an observation.

    A factory needs none, or the road map in its parameter `roadmap`.
    """
    needed = needed_parameters(function)
    return len(needed) == 1 and needed[0].kind in _BY_POSITION and needed[0].name != "roadmap"


def needed_parameters(function: Callable[..., Any]) -> list[inspect.Parameter]:
    """Return the parameters without which a callable cannot be called."""
    return [one for one in parameters_of(function).values() if one.default is one.empty and one.kind not in _VARIADIC]


def parameters_of(function: Callable[..., Any]) -> Mapping[str, inspect.Parameter]:
    """Return the parameters of a callable by name; none if Python cannot tell them."""
    try:
        return inspect.signature(function).parameters
    except (TypeError, ValueError):
        return {}
