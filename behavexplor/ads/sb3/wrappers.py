"""Wrappers of the user's own, through which a policy sees and acts as in its training."""

import hashlib
import sys
from collections.abc import Collection, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector.utils import create_empty_array

from behavexplor.ads.sb3.description import OWN
from behavexplor.data.array_types import Array, Bools, Floats
from behavexplor.data.drawn_scenario import DECLARATIONS
from behavexplor.data.observations import Observation, mapped
from behavexplor.data.untrusted import read_file
from behavexplor.errors import InputError, brief, described

Named = str | Mapping[str, Mapping[str, Any]]  # "module:Class", or a mapping from it to its arguments
_KINDS = (gymnasium.ObservationWrapper, gymnasium.ActionWrapper, gymnasium.RewardWrapper)


class _Spaces(gymnasium.Env[Any, Any]):
    """Stands for the environment inside of the wrappers: it has its spaces, and the present observation."""

    def __init__(self, observation_space: gymnasium.Space[Any], action_space: gymnasium.Space[Any]) -> None:
        self.observation_space, self.action_space = observation_space, action_space
        self.present: Any = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed, options=options)
        return self.present, {}


class PolicyInWrappers:
    """A policy trained in wrappers of the user's own, the innermost first; `seeing` returns what drives.

    What the policy declares of observations, actions and frequencies is declared here, too.
    """

    def __init__(self, policy: Any, wrappers: Sequence[tuple[str, Any, Mapping[str, Any]]]) -> None:
        self._policy, self._wrappers = policy, wrappers
        _declare_as(policy, self)

    def seeing(self, space: gymnasium.Space[Any], action_space: gymnasium.Space[Any]) -> "WrappedPolicy":
        """Return the policy for the observations and actions of an environment.

        Raises:
            InputError: if a wrapper cannot be made for them, or the policy does not fit what it makes of them.
        """
        chain: list[Any] = [_Spaces(space, action_space)]
        names = " in ".join(name for name, _, _ in reversed(self._wrappers))
        try:
            for _, kind, arguments in self._wrappers:
                chain.append(kind(chain[-1], **arguments))
            chain[0].present = mapped(lambda array: array[0], create_empty_array(space, 1))
            made, _ = chain[-1].reset()
        except Exception as error:  # code of the user can raise anything
            raise InputError(f"{names} does not suit the environment: {described(error)}") from error
        outer = chain[-1].observation_space, chain[-1].action_space
        policy = self._policy.seeing(*outer)
        own, acts = policy.observation_space, policy.action_space
        fits = own.shape == outer[0].shape == np.shape(made) and type(acts) is type(outer[1])
        if not fits or (acts.shape, getattr(acts, "n", 0)) != (outer[1].shape, getattr(outer[1], "n", 0)):
            raise InputError(
                f"The policy observes {brief(own)} and commands {brief(acts)}, but the environment has "
                f"{brief(outer[0])} and {brief(outer[1])} in {names}"
            )
        return WrappedPolicy(policy, chain, [name for name, _, _ in self._wrappers])


class WrappedPolicy:
    """A policy that drives one episode at a time through wrappers of observations and actions.

    Attributes:
        noise: see `behavexplor.ads.interface.StochasticADS`.
        observation_space: space of one observation of the environment.
        action_space: space of one of its actions.
        said: what is done to observations and actions, in sentences.
    """

    vectorized = False

    def __init__(self, policy: Any, chain: Sequence[Any], names: Sequence[str]) -> None:
        self._policy, self._inner, self._wrappers = policy, chain[0], chain[1:]
        self.observation_space, self.action_space = chain[0].observation_space, chain[0].action_space
        self.noise = policy.noise
        _declare_as(policy, self)
        own = f"The policy sees and acts through {' and '.join(names)}, as its settings file says"
        self.said = f"{own}. {policy.said}" if policy.said else own

    def predict(
        self,
        observation: Observation,
        state: Any = None,
        episode_start: Bools | None = None,
        deterministic: bool = True,  # noqa: ARG002 - `draw` draws
    ) -> tuple[Array, Any]:
        """Decide deterministically for the only ego; see `behavexplor.ads.interface.ADS`."""
        seen = self._seen(observation, begins=state is None or bool(episode_start is not None and episode_start[0]))
        actions, state = self._policy.predict(seen, state, episode_start)
        return self._acted(actions), state

    def draw(
        self, observation: Observation, state: Any, episode_start: Bools | None, noise: Floats
    ) -> tuple[Array, Any]:
        """Draw the action of the only ego; see `behavexplor.ads.interface.StochasticADS`."""
        seen = self._seen(observation, begins=state is None or bool(episode_start is not None and episode_start[0]))
        actions, state = self._policy.draw(seen, state, episode_start, noise)
        return self._acted(actions), state

    def _seen(self, observation: Observation, *, begins: bool) -> Observation:
        """Return the observation through the wrappers, which begin an episode by their `reset`."""
        row = self._inner.present = mapped(lambda array: np.asarray(array)[0], observation)
        if begins:
            row, _ = self._wrappers[-1].reset()
        else:
            for one in self._wrappers:
                row = one.observation(row) if isinstance(one, gymnasium.ObservationWrapper) else row
        return mapped(lambda array: np.asarray(array)[None], row)  # type: ignore[no-any-return]

    def _acted(self, actions: Array) -> Array:
        action = actions[0]
        for one in reversed(self._wrappers):
            action = one.action(action) if isinstance(one, gymnasium.ActionWrapper) else action
        return np.asarray(action)[None]


def _declare_as(policy: Any, other: Any) -> None:
    """Declare the same observations, actions, frequencies and configuration as a policy."""
    for name in DECLARATIONS:
        if hasattr(policy, name):
            setattr(other, name, getattr(policy, name))


def in_wrappers(policy: Any, model: Path, named: Sequence[Named], trust: Collection[str]) -> Any:
    """Return a policy in the wrappers that the file beside its model names; the policy itself if it names none.

    They are code, so they are imported only if the digest of that file and of their modules is trusted.

    Raises:
        InputError: if it is not, or a wrapper cannot be imported or applied.
    """
    pairs = [pair for one in named for pair in ({one: {}} if isinstance(one, str) else one).items()]
    if not pairs:
        return policy
    settings = next(file for file in map(model.with_suffix, OWN) if file.is_file())
    parts = [read_file(settings), *(_source(name.partition(":")[0]) for name, _ in pairs)]
    digest = f"sha256:{hashlib.sha256(b''.join(parts)).hexdigest()}"
    if digest not in trust:
        listed = " and ".join(name for name, _ in pairs)
        raise InputError(
            f"{settings} names {listed}, which is code and was not loaded: if you trust it, add --trust {digest}"
        )
    return PolicyInWrappers(policy, [(name, _wrapper(name), arguments) for name, arguments in pairs])


def _wrapper(name: str) -> Any:
    """Return the class of a wrapper."""
    module, _, attribute = name.partition(":")
    try:
        found = getattr(import_module(module), attribute)
    except Exception as error:  # a module can raise anything when it is imported
        raise InputError(f"The wrapper {name!r} cannot be imported: {described(error)}") from error
    if not (isinstance(found, type) and issubclass(found, _KINDS)):
        raise InputError(
            f"{name} is no gymnasium.ObservationWrapper or ActionWrapper: write a driver that does what it did, and "
            "name it as module:attribute"
        )
    return found


def _source(module: str) -> bytes:
    """Return the source of a module, which is not imported; nothing if it is not found as a file."""
    name, folders, spec = "", None, None
    for part in module.split("."):
        name = f"{name}.{part}".lstrip(".")
        spec = next(filter(None, (finder.find_spec(name, folders) for finder in sys.meta_path)), None)
        folders = None if spec is None else spec.submodule_search_locations
    origin = None if spec is None or spec.origin is None else Path(spec.origin)
    return read_file(origin) if origin is not None and origin.is_file() else b""
