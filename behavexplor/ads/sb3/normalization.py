"""Statistics by which `VecNormalize` scaled the observations of a policy in training."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from behavexplor.ads.sb3.archive import suspicions_about
from behavexplor.ads.sb3.arrays import as_array
from behavexplor.ads.sb3.inert import Inert, read_pickle
from behavexplor.errors import InputError

MAX_BYTES: Final = 50_000_000


@dataclass(frozen=True)
class Statistics:
    """Statistics that scale observations as `VecNormalize` of Stable-Baselines3 does.

    Attributes:
        mean: mean of the observations, shape of one observation.
        variance: variance of the observations, shape of one observation.
        clip: greatest absolute value after scaling.
        epsilon: constant added to the variance.
        suspicions: unusual calls that loading the file with Stable-Baselines3 would make, each as a phrase.
    """

    mean: NDArray[np.float64]
    variance: NDArray[np.float64]
    clip: float
    epsilon: float
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
            data = path.read_bytes()
            if len(data) > MAX_BYTES:
                raise InputError(f"{path} has {len(data)} bytes, too many for statistics of VecNormalize")
            saved, names = read_pickle(data)
            state = _state(saved, "VecNormalize")
            if not state.get("norm_obs", True):
                return None
            moments = _state(state["obs_rms"], "RunningMeanStd")
            mean, variance = as_array(moments["mean"]), as_array(moments["var"])
            clip, epsilon = float(as_array(state["clip_obs"])), float(as_array(state["epsilon"]))
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{path} contains no statistics of VecNormalize for an array: {error}") from None
        if mean.shape != variance.shape or not np.isfinite([mean, variance]).all() or (variance < 0).any():
            raise InputError(
                f"{path} contains no usable statistics: mean and variance must be finite and have the same shape, and "
                "the variance must not be negative"
            )
        calls = suspicions_about(path.name, names)
        return cls(mean.astype(np.float64), variance.astype(np.float64), clip, epsilon, tuple(calls))

    def scale(self, observations: NDArray[Any]) -> NDArray[np.float32]:
        """Return observations as the policy saw them in training, shape (B, ...)."""
        scaled = (observations - self.mean) / np.sqrt(self.variance + self.epsilon)
        return np.clip(scaled, -self.clip, self.clip).astype(np.float32)


def _state(value: Any, kind: str) -> dict[str, Any]:
    """Return the attributes that an object of a class would have been given."""
    if not isinstance(value, Inert) or not value.name.endswith(f".{kind}") or not isinstance(value.state, dict):
        raise ValueError(f"it is not a {kind}")
    return value.state
