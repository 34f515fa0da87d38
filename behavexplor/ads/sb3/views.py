"""Wrappers of a policy's training that its spaces show: observations are flattened or stacked as in training."""

from dataclasses import dataclass
from math import prod
from typing import Any, Final, Literal

import gymnasium
import numpy as np

from behavexplor.data.array_types import Array
from behavexplor.data.observations import Observation

FLAT: Final = "flat"
STACKED: Final = "stacked"  # along a new first axis, as by FrameStackObservation
JOINED: Final = "joined"  # along the last axis, as by VecFrameStack


@dataclass(frozen=True)
class PolicyView:
    """How a policy sees the observations of an environment."""

    kind: Literal["flat", "stacked", "joined"]  # `FLAT`, `STACKED` or `JOINED`
    # keys of observations that are dictionaries, in the order in which they are joined; none for arrays
    keys: tuple[str, ...] = ()
    frames: int = 1  # number of observations that are stacked
    said: str = ""  # a sentence for the user

    def flattened(self, observation: Observation) -> Array:
        """Return observations, arrays of shape (B, ...), as arrays of shape (B, n)."""
        whole: Any = observation
        if not self.keys:
            return np.asarray(whole).reshape(len(whole), -1)
        return np.concatenate([np.asarray(whole[key]).reshape(len(whole[key]), -1) for key in self.keys], axis=1)


def view_of(wanted: gymnasium.Space[Any], given: gymnasium.Space[Any], *, stacks: bool = True) -> PolicyView | None:
    """Return the view that makes an environment's observations those of a policy; None if none is there or needed."""
    parts = list(given.items()) if isinstance(given, gymnasium.spaces.Dict) else [("", given)]
    if not all(isinstance(one, gymnasium.spaces.Box) for one in (wanted, *(part for _, part in parts))):
        return None
    shape, shapes = wanted.shape or (), [part.shape or () for _, part in parts]
    if len(shape) == 1 and shape[0] == sum(map(prod, shapes)) and shapes != [shape]:
        shown = " and ".join(map(str, dict.fromkeys(shapes)))
        said = f"The environment's observations of the shape {shown} are flattened for the policy, as in training"
        return PolicyView(FLAT, tuple(key for key, _ in parts if key), said=said)
    stacks = stacks and isinstance(given, gymnasium.spaces.Box)
    return _stacking(shape, shapes[0]) if stacks and shape and shapes[0] else None


def _stacking(shape: tuple[int, ...], own: tuple[int, ...]) -> PolicyView | None:
    """Return the view that stacks observations of one shape so that they have another one; None if there is none."""
    if shape[1:] == own and shape[0] > 1:
        return PolicyView(STACKED, (), shape[0], _said(shape[0], own, f"FrameStackObservation({shape[0]})"))
    frames = shape[-1] // max(own[-1], 1)
    if len(own) > 1 and frames > 1 and shape == (*own[:-1], frames * own[-1]):
        return PolicyView(JOINED, (), frames, _said(frames, own, f"VecFrameStack({frames})"))
    return None


def _said(frames: int, shape: tuple[int, ...], wrapper: str) -> str:
    return (
        f"The last {frames} observations of the shape {shape} are stacked for the policy, as by {wrapper} in training"
    )
