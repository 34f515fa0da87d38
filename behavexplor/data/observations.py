"""Observations: an array, or a dictionary of arrays where the observation space is gymnasium's `Dict`."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from behavexplor.data.array_types import Array

Observation: TypeAlias = Array | Mapping[str, Array]


def mapped(function: Callable[[Array], Array], observation: Any) -> Any:
    """Return an observation with a function applied to its array, or to each of its arrays."""
    if isinstance(observation, Mapping):
        return {key: function(array) for key, array in observation.items()}
    return function(observation)


def arrays_of(observation: Any) -> list[Array]:
    """Return the arrays of an observation."""
    return list(observation.values()) if isinstance(observation, Mapping) else [observation]


def joined(observations: Sequence[Any]) -> Any:
    """Return observations of one form, joined along the first axis."""
    if isinstance(observations[0], Mapping):
        return {key: np.concatenate([one[key] for one in observations]) for key in observations[0]}
    return np.concatenate(observations)
