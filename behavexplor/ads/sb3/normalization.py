"""Statistics by which `VecNormalize` of Stable-Baselines3 scaled the observations of a policy."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from behavexplor.ads.sb3.archive import suspicions_about
from behavexplor.ads.sb3.arrays import as_array, as_mapping
from behavexplor.ads.sb3.inert import Inert, check_extent, read_pickle
from behavexplor.data.array_types import Array, Floats, Singles
from behavexplor.data.observations import Observation
from behavexplor.data.untrusted import read_file
from behavexplor.errors import InputError

MAX_BYTES: Final = 50_000_000  # greatest size of a file of statistics


@dataclass(frozen=True)
class Moments:
    """Mean and variance of an array of observations."""

    mean: Floats  # mean, shape of one observation
    variance: Floats  # variance, shape of one observation


@dataclass(frozen=True)
class Statistics:
    """Statistics that scale observations as `VecNormalize` of Stable-Baselines3 does."""

    # moments of the observations; if those are dictionaries, the moments of each array that is scaled, by its key
    moments: Moments | Mapping[str, Moments]
    clip: float  # greatest absolute value after scaling
    epsilon: float  # constant added to the variance
    # unusual calls that loading the file with Stable-Baselines3 would make, each as a phrase
    suspicions: tuple[str, ...] = ()

    @classmethod
    def read(cls, path: Path) -> Self | None:
        """Read a file written by `VecNormalize.save`, without executing it.

        Returns:
            The statistics; None if the file says that observations were not scaled.

        Raises:
            InputError: if the file cannot be read.
        """
        try:
            saved, names = read_pickle(read_file(path, MAX_BYTES))
            state = _state(saved, "VecNormalize")
            if not state.get("norm_obs", True):
                return None
            moments = _read_moments(path, state)
            clip, epsilon = float(as_array(state["clip_obs"])), float(as_array(state["epsilon"]))
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{path} contains no statistics of VecNormalize: {error}") from None
        if not (clip > 0 and math.isfinite(clip) and 0 <= epsilon < math.inf):
            raise InputError(f"{path} contains no usable statistics: clip_obs is {clip}, and epsilon is {epsilon}")
        return cls(moments, clip, epsilon, tuple(suspicions_about(path.name, names)))

    def scale(self, observations: Observation) -> Observation:
        """Return observations as the policy saw them in training, arrays of shape (B, ...)."""
        if isinstance(self.moments, Moments):
            return self._scaled(np.asarray(observations), self.moments)
        arrays = dict(observations) if isinstance(observations, Mapping) else {}
        return arrays | {key: self._scaled(arrays[key], moments) for key, moments in self.moments.items()}

    def of_part(self, part: Callable[[str, Moments], Moments]) -> Self:
        """Return the statistics of a part of each array. `part` gets the array's key ("" without keys) and moments."""
        if isinstance(self.moments, Moments):
            return replace(self, moments=part("", self.moments))
        return replace(self, moments={key: part(key, moments) for key, moments in self.moments.items()})

    def _scaled(self, array: Array, moments: Moments) -> Singles:
        scaled = (array - moments.mean) / np.sqrt(moments.variance + self.epsilon)
        return np.clip(scaled, -self.clip, self.clip).astype(np.float32)


def _read_moments(path: Path, state: Mapping[str, Any]) -> Moments | dict[str, Moments]:
    """Return the moments in the attributes of a `VecNormalize`."""
    saved = as_mapping(state["obs_rms"])
    if saved is None:
        return _moments(path, state["obs_rms"])
    keys = state.get("norm_obs_keys") or list(saved)
    check_extent(keys)
    return {str(key): _moments(path, saved[key]) for key in keys}


def _moments(path: Path, saved: Any) -> Moments:
    """Return the moments in a `RunningMeanStd`."""
    state = _state(saved, "RunningMeanStd")
    mean, variance = as_array(state["mean"]), as_array(state["var"])
    if mean.shape != variance.shape or not np.isfinite([mean, variance]).all() or (variance < 0).any():
        raise InputError(
            f"{path} contains no usable statistics: mean and variance must be finite and have the same shape, and "
            "the variance must not be negative"
        )
    return Moments(mean.astype(np.float64), variance.astype(np.float64))


def _state(value: Any, kind: str) -> dict[str, Any]:
    """Return the attributes that an object of a class would have been given."""
    if not isinstance(value, Inert) or not value.name.endswith(f".{kind}") or not isinstance(value.state, dict):
        raise ValueError(f"it is not a {kind}")
    return value.state
