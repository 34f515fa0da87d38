"""A policy trained with Stable-Baselines3 as a driving system under test, and how it sees an environment."""

import logging
from collections import OrderedDict
from collections.abc import Collection, Iterable, Mapping
from copy import copy
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, Self

import gymnasium
import numpy as np
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.preprocessing import is_image_space

from behavexplor.ads.learned.network_file import DIVERGED
from behavexplor.ads.sb3.archive import Archive, read_archive
from behavexplor.ads.sb3.arrays import as_arrays
from behavexplor.ads.sb3.blocks import BlockwiseNetwork
from behavexplor.ads.sb3.building import UntrustedError, build_policy, build_trusted
from behavexplor.ads.sb3.description import Description, describe, find_model
from behavexplor.ads.sb3.drawn_actions import noise_of
from behavexplor.ads.sb3.normalization import Moments, Statistics
from behavexplor.data.array_types import Array, Bools, Floats
from behavexplor.data.observations import Observation, mapped
from behavexplor.errors import InputError, brief, sentence

FLAT: Final = "flat"
STACKED: Final = "stacked"  # along a new first axis, as by FrameStackObservation
JOINED: Final = "joined"  # along the last axis, as by VecFrameStack
_LOG = logging.getLogger(__name__)
_MASKED: Final = "sb3_contrib.common.maskable."  # the module of policies that take masks of actions


@dataclass(frozen=True)
class PolicyView:
    """How a policy sees the observations of an environment."""

    kind: Literal["flat", "stacked", "joined"]  # `FLAT`, `STACKED` or `JOINED`
    # keys of observations that are dictionaries, in the order in which they are joined; none for arrays
    keys: tuple[str, ...] = ()
    frames: int = 1  # number of observations that are stacked
    said: str = ""  # what is done to the observations, as a sentence for the user

    def flattened(self, observation: Observation) -> Array:
        """Return observations, arrays of shape (B, ...), as arrays of shape (B, n)."""
        whole: Any = observation
        if not self.keys:
            return np.asarray(whole).reshape(len(whole), -1)
        return np.concatenate([np.asarray(whole[key]).reshape(len(whole[key]), -1) for key in self.keys], axis=1)


class Stacking(NamedTuple):
    """How observations are stacked."""

    frames: int  # number of observations
    space: gymnasium.Space[Any]  # space of one of them
    # axis of a batch along which they are stacked, as by `FrameStackObservation`, where the first observation also
    # stands for those before it; None for the axis of `VecFrameStack`, where zeros do
    axis: int | None = None
    scaled: bool = False  # whether `VecNormalize` scales them all, instead of each


class SB3Policy:
    """A policy network of Stable-Baselines3, with observations prepared as in training.

    Attributes:
        observation_space: space of one observation from the environment, before scaling and stacking.
        action_space: space of one action.
        noise: see `behavexplor.ads.interface.StochasticADS`.
        last_trained_on: observations at the end of training, arrays of shape (n, ...); None if the file has none.
        was_masked: whether actions were masked in training. Here they are not.
        view: how the policy sees the environment's observations, if not as they are.

    The policy drives in lock-step: its answer to an observation does not depend on the rest of the batch. The
    observation and action configuration and the frequencies are attributes only where they are known, and so is
    `env_config`, highway-env's configuration in training.
    """

    def __init__(
        self, network: BasePolicy, description: Description, statistics: Statistics | None, last: Observation | None
    ) -> None:
        self.vectorized = True
        self._network = BlockwiseNetwork(network)
        self.noise = noise_of(network)
        self._statistics = statistics
        self.view: PolicyView | None = None
        self._frames = description.frame_stack
        self._own_space = _unstacked(network.observation_space, self._frames)
        self.observation_space = self._own_space  # or that of the environment, see `seeing`
        self.action_space = network.action_space
        self.last_trained_on = last
        names = ("observation", "action", "policy_frequency", "simulation_frequency")
        for name in names:
            if (value := getattr(description, name)) is not None:
                setattr(self, name, value)
        if description.config is not None:
            self.env_config = dict(description.config)
        self.was_masked = type(network).__module__.startswith(_MASKED)
        self._scales_stack = False  # whether `VecNormalize` was around `VecFrameStack`, instead of inside of it
        if statistics is not None:
            shapes = _shapes(statistics, network.observation_space)
            self._scales_stack = self._frames > 1 and shapes[0] == shapes[1]
        if statistics is not None and not self._scales_stack:
            _check_statistics(str(description.statistics or "VecNormalize"), statistics, self.observation_space)

    def seeing(self, space: gymnasium.Space[Any], _: gymnasium.Space[Any]) -> Self:
        """Return this policy with a view of an environment's observations, if it needs one and there is one."""
        view = view_of(self.observation_space, space, stacks=self._frames == 1)
        if view is None:
            return self
        seen = copy(self)
        seen.view, seen.observation_space = view, space
        return seen

    @property
    def said(self) -> str:
        """What is done to the environment's observations, as a sentence; empty if nothing."""
        return "" if self.view is None else self.view.said

    def prepare(self, observation: Observation) -> Observation:
        """Return observations flattened and scaled as in training, arrays of shape (B, ...), but not stacked.

        If the statistics are of stacked frames, those of the newest frame scale them.
        """
        statistics, stack = self._statistics, self._stacking
        if statistics is not None and stack.scaled:
            statistics = statistics.of_part(lambda key, moments: _newest(moments, key, stack))
        flat = self._flat(observation)
        return flat if statistics is None else statistics.scale(flat)

    def _flat(self, observation: Observation) -> Observation:
        return observation if self.view is None or self.view.kind != FLAT else self.view.flattened(observation)

    @property
    def _stacking(self) -> Stacking:
        """How observations are stacked: as the user says, or as the environment shows."""
        if self.view is None or self.view.frames == 1:
            return Stacking(self._frames, self._own_space, scaled=self._scales_stack)
        axis = 1 if self.view.kind == STACKED else None
        return Stacking(self.view.frames, self.observation_space, axis, self._statistics is not None)

    def _scaled(self, observation: Observation) -> Observation:
        return observation if self._statistics is None else self._statistics.scale(observation)

    def predict(
        self,
        observation: Observation,
        state: Any = None,
        episode_start: Bools | None = None,
        deterministic: bool = True,  # noqa: ARG002 - `draw` draws
    ) -> tuple[Array, Any]:
        """Decide deterministically for a batch of egos; see `behavexplor.ads.interface.ADS`.

        The state is a pair: the observations stacked so far, and the state of a recurrent network.
        """
        return self._decide(observation, state, episode_start, None)

    def draw(
        self, observation: Observation, state: Any, episode_start: Bools | None, noise: Floats
    ) -> tuple[Array, Any]:
        """Draw the actions of a batch of egos; see `behavexplor.ads.interface.StochasticADS`."""
        return self._decide(observation, state, episode_start, noise)

    def _decide(
        self, observation: Observation, state: Any, episode_start: Bools | None, noise: Floats | None
    ) -> tuple[Array, Any]:
        frames, memory = (None, None) if state is None else state
        prepared, stack = self._flat(mapped(np.asarray, observation)), self._stacking
        if not stack.scaled:
            prepared = self._scaled(prepared)
        if stack.frames > 1:
            newest = prepared if stack.axis is None else np.asarray(prepared)[:, None]
            prepared = frames = _stacked(newest, frames, episode_start, stack, stack.space)
        if stack.scaled:
            prepared = self._scaled(prepared)
        actions, memory = self._network.ask(prepared, memory, episode_start, noise)
        return actions, (frames, memory)


def load_policy(path: Path, trust: Collection[str] = ()) -> SB3Policy:
    """Read a policy from a model's zip file, or from a run folder of rl-zoo3.

    No code from the files is executed, but from those whose digests ("sha256:...") are in `trust`.

    Raises:
        InputError: if the policy cannot be read, or only by executing code from a file that is not trusted.
    """
    model = find_model(path)
    archive = read_archive(model)
    description = describe(model)
    statistics = Statistics.read(description.statistics) if description.statistics else None
    _warn(model, statistics.suspicions if statistics else ())
    return SB3Policy(load_network(archive, trust), description, statistics, _last_observations(archive.settings))


def load_network(archive: Archive, trust: Collection[str] = ()) -> BasePolicy:
    """Build the network of a model's file, by executing code from it only if its digest is in `trust`.

    Raises:
        InputError: if it needs code from a file that is not trusted, or has weights that are not finite.
    """
    is_trusted = archive.digest in trust
    if not is_trusted:
        _warn(archive.path, archive.suspicions)
    try:
        network = build_trusted(archive) if is_trusted else build_policy(archive)
    except UntrustedError as error:
        raise InputError(
            f"{archive.path} cannot be loaded without running code from it: {error}. "
            f"If you trust its origin, add --trust {archive.digest}"
        ) from None
    if not all(weights.isfinite().all() for weights in network.parameters()):
        raise InputError(f"{archive.path} {DIVERGED}")
    return network


def _warn(model: Path, suspicions: Iterable[str]) -> None:
    for suspicion in suspicions:
        _LOG.warning("%s", sentence(f"{model}: {suspicion}"))


def _last_observations(settings: Mapping[str, Any]) -> Observation | None:
    try:
        return as_arrays(settings["_last_obs"])
    except (KeyError, ValueError):  # a model without training, or with other observations
        return None


def _check_statistics(name: str, statistics: Statistics, space: gymnasium.Space[Any]) -> None:
    """Check that the statistics of a file belong to a policy's observations."""
    shapes, expected = _shapes(statistics, space)
    if shapes == expected:
        return
    is_alike = isinstance(shapes, tuple) and isinstance(expected, tuple) and shapes[:-1] == expected[:-1]
    hint = ""
    if is_alike and shapes and expected[-1] % shapes[-1] == 0:
        hint = f": if they are stacked, say `frame_stack: {expected[-1] // shapes[-1]}` in a YAML file beside the model"
    raise InputError(f"{name} has statistics for observations of shape {shapes}, the policy's have {expected}{hint}")


def _shapes(statistics: Statistics, space: gymnasium.Space[Any]) -> tuple[Any, Any]:
    """Return the shapes of the observations of statistics and of a space; by key where these are dictionaries."""
    moments = statistics.moments
    shapes = moments.mean.shape if isinstance(moments, Moments) else {key: of.mean.shape for key, of in moments.items()}
    expected: Any = space.shape
    if isinstance(space, gymnasium.spaces.Dict) and isinstance(shapes, dict):
        expected = {key: part.shape for key, part in space.spaces.items() if key in shapes}
    return shapes, expected


def _unstacked(space: gymnasium.Space[Any], stack: int) -> gymnasium.Space[Any]:
    """Return the space of one of the frames that are stacked."""
    if stack == 1:
        return space
    if isinstance(space, gymnasium.spaces.Dict):
        parts = [(key, _unstacked(part, stack)) for key, part in space.spaces.items()]
        return gymnasium.spaces.Dict(OrderedDict(parts))
    if not isinstance(space, gymnasium.spaces.Box) or not space.shape:
        raise InputError(f"The policy's observations are of {brief(space)}, which cannot be {stack} stacked frames")
    axis = _axis(space)
    width = space.shape[axis]
    if width % stack:
        counted = "channels" if axis == 0 and len(space.shape) == 3 else "columns"
        raise InputError(f"The policy's observations have {width} {counted}, which cannot be {stack} stacked frames")
    newest = range(width - width // stack, width)
    low, high = space.low.take(newest, axis), space.high.take(newest, axis)
    return gymnasium.spaces.Box(low, high, dtype=space.dtype.type)


def _axis(space: gymnasium.Space[Any]) -> int:
    """Return the axis along which `VecFrameStack` stacks: an image's channels if they come first, or the last."""
    shape = space.shape or ()
    return 0 if is_image_space(space) and np.argmin(shape) == 0 else len(shape) - 1


def _newest(moments: Moments, key: str, stack: Stacking) -> Moments:
    """Return the moments of the newest of stacked frames; `key` is that of an array in a dictionary."""
    part = stack.space[key] if isinstance(stack.space, gymnasium.spaces.Dict) else stack.space
    axis = _axis(part) if stack.axis is None else stack.axis - 1
    width = moments.mean.shape[axis]
    newest = range(width - width // stack.frames, width)
    return Moments(moments.mean.take(newest, axis), moments.variance.take(newest, axis))


def _stacked(
    newest: Any, before: Any, episode_start: Bools | None, stack: Stacking, space: gymnasium.Space[Any]
) -> Any:
    """Return the last frames: those stacked `before` (None at first) without the oldest, and the newest at the end.

    `space` is that of a frame. `Stacking.axis` says what stands for the frames before the beginning of an episode.
    """
    if isinstance(space, gymnasium.spaces.Dict):
        past = before or dict.fromkeys(space)
        return {key: _stacked(newest[key], past[key], episode_start, stack, part) for key, part in space.items()}
    axis = 1 + _axis(space) if stack.axis is None else stack.axis
    first = np.concatenate([np.zeros_like(newest) if stack.axis is None else newest] * stack.frames, axis)
    kept = (first if before is None else before).take(range(newest.shape[axis], first.shape[axis]), axis)
    if episode_start is not None:
        begins = np.asarray(episode_start, dtype=bool)
        kept[begins] = first.take(range(kept.shape[axis]), axis)[begins]
    return np.concatenate([kept, newest], axis)


def view_of(wanted: gymnasium.Space[Any], given: gymnasium.Space[Any], *, stacks: bool = True) -> PolicyView | None:
    """Return the view that makes an environment's observations those of a policy; None if it needs none or has none."""
    parts = list(given.items()) if isinstance(given, gymnasium.spaces.Dict) else [("", given)]
    if not all(isinstance(one, gymnasium.spaces.Box) for one in (wanted, *(part for _, part in parts))):
        return None
    shape, shapes = wanted.shape or (), [part.shape or () for _, part in parts]
    if len(shape) == 1 and shape[0] == sum(map(prod, shapes)) and shapes != [shape]:
        shown = " and ".join(map(str, dict.fromkeys(shapes)))
        said = f"The environment's observations of the shape {shown} are flattened for the policy, as in training"
        return PolicyView(FLAT, tuple(key for key, _ in parts if key), said=said)
    stacks = stacks and isinstance(given, gymnasium.spaces.Box)
    return _stacking_view(shape, shapes[0]) if stacks and shape and shapes[0] else None


def _stacking_view(shape: tuple[int, ...], own: tuple[int, ...]) -> PolicyView | None:
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
