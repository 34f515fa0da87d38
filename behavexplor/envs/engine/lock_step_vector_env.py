"""What compiled vector environments have in common: gymnasium's arguments, autoreset modes and infos of last steps."""

from abc import abstractmethod
from collections.abc import Collection, Sequence
from typing import Any, ClassVar

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from behavexplor.data.array_types import Array, Bools, Floats
from behavexplor.envs.source_gate import ChangeGuard
from behavexplor.envs.values import COUNT, shown
from behavexplor.errors import InputError, unknown_name


class LockStepVectorEnv(VectorEnv[Array, Array, Array]):
    """Episodes in lock-step, one in each slot. A subclass begins, simulates and observes them.

    Args:
        single: a single environment with the same spaces and configuration.
        num_envs: number of sub-environments.
        autoreset_mode: gymnasium's autoreset mode, applied after the end of an episode.
        guard: notices that classes have changed since the environment was made.

    Raises:
        InputError: if there is no such mode, or `num_envs` is not a whole number from 1.
    """

    _options: ClassVar[tuple[str, ...]]  # of `reset`
    _observations: Array  # the latest ones, shape (num_envs, ...)

    def __init__(self, single: Any, num_envs: int, autoreset_mode: AutoresetMode | str, guard: ChangeGuard) -> None:
        COUNT.check("num_envs", num_envs)
        mode = chosen_mode(autoreset_mode)
        self._guard = guard
        self._resets_same_step = mode is AutoresetMode.SAME_STEP
        self._resets_next_step = mode is AutoresetMode.NEXT_STEP
        self.num_envs = num_envs
        self.config: dict[str, Any] = single.config
        self.metadata = {"render_modes": [], "autoreset_mode": mode}
        self.single_observation_space, self.single_action_space = single.observation_space, single.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._idle = set(range(num_envs))  # those that have not begun an episode

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begin episodes in all slots, or in those that the option `reset_mask` selects, shape (num_envs,).

        A single seed s gives sub-environment i the seed s + i.

        Raises:
            InputError: if an option or a seed cannot be used, or classes have changed since the environment was made.
        """
        options = chosen_options(options, self._options)
        mask = chosen_slots(options.get("reset_mask"), self.num_envs)
        given, seeds = self._given(options, mask), chosen_seeds(seed, self.num_envs)
        if isinstance(seed, int | np.integer):
            super().reset(seed=seeds[0])
        chosen = np.flatnonzero(mask).tolist()
        for b in chosen:
            self._seed(b, seeds[b])
        self._guard.check(always=bool(mask.all()))
        self._begin(mask, *given)
        self._idle.difference_update(chosen)
        return self._observations.copy(), self._infos(np.zeros(self.num_envs, dtype=bool), mask.copy())

    def step(self, actions: Array) -> tuple[Array, Floats, Bools, Bools, dict[str, Any]]:
        """Take an action in every sub-environment.

        Args:
            actions: one action for each sub-environment, shape (num_envs, ...).

        Raises:
            gymnasium.error.ResetNeeded: if a sub-environment has not begun an episode.
            InputError: if the actions are not in the action space. Numbers beyond the bounds of a Box are clipped.

        Returns:
            Observations, shape (num_envs, ...); rewards, terminations and truncations, each of shape (num_envs,); and
            infos.
        """
        if self._idle:
            raise ResetNeeded("A sub-environment has not begun an episode: call reset before step")
        rewards, terminated, truncated, stepped, n_ended = self._decide(np.asarray(actions))
        if n_ended and self._resets_same_step:
            ended = terminated | truncated
            infos = self._last_infos(ended) | self._begin_again(stepped & ~ended, ended)
        elif self._resets_next_step and np.count_nonzero(stepped) < self.num_envs:
            rested = ~stepped
            terminated[rested] = truncated[rested] = False
            infos = self._begin_again(stepped, rested)
        else:
            infos = self._infos(stepped)
        return self._observations.copy(), rewards, terminated, truncated, infos

    def _begin_again(self, stepped: Bools, begun: Bools) -> dict[str, Any]:
        """Begin the next episodes in the slots `begun`, and return the infos; see `_infos`."""
        self._guard.check(always=False)
        self._begin(begun)
        return self._infos(stepped, begun)

    def _last_infos(self, ended: Bools) -> dict[str, Any]:
        """Return the last observations and infos of episodes that have ended, for autoreset in the same step."""
        observations = np.empty(self.num_envs, dtype=object)  # of None
        for b in ended.nonzero()[0].tolist():
            observations[b] = self._observations[b].copy()
        mask = ended.copy()
        return {"final_obs": observations, "_final_obs": mask, "final_info": self._infos(ended), "_final_info": mask}

    @abstractmethod
    def _given(self, options: dict[str, Any], mask: Bools) -> tuple[Any, ...]:
        """Return more arguments for `_begin` from the options of a reset."""

    @abstractmethod
    def _seed(self, b: int, seed: int | None) -> None:
        """Seed the generator of slot b, which is reset; None leaves it as it is, if there is one."""

    @abstractmethod
    def _begin(self, mask: Bools, *given: Any) -> None:
        """Begin episodes in the chosen slots, shape (num_envs,), and observe them."""

    @abstractmethod
    def _decide(self, actions: Array) -> tuple[Floats, Bools, Bools, Bools, int]:
        """Simulate a decision in each slot whose episode has not ended, and observe it.

        Return arrays that the caller may change, each of shape (num_envs,): the rewards, whether the episodes have been
        terminated and truncated, now or earlier, and whether they have taken this decision. Return also how many have
        ended; those that ended earlier need not count.
        """

    @abstractmethod
    def _infos(self, stepped: Bools, begun: Bools | None = None) -> dict[str, Any]:
        """Return infos of slots that took the step or have begun an episode: gymnasium's arrays, with their masks."""


def chosen_mode(name: AutoresetMode | str) -> AutoresetMode:
    """Return the autoreset mode of a name.

    Raises:
        InputError: if there is no such mode.
    """
    if isinstance(name, AutoresetMode):
        return name
    modes = {mode.value: mode for mode in AutoresetMode}
    if name not in modes:
        raise unknown_name("autoreset mode", str(name), modes)
    return modes[name]


def chosen_options(options: dict[str, Any] | None, known: Collection[str]) -> dict[str, Any]:
    """Return the options of a reset.

    Raises:
        InputError: if one of them is unknown.
    """
    for key in options or {}:
        if key not in known:
            raise unknown_name("reset option", str(key), known)
    return options or {}


def chosen_slots(mask: object, num_envs: int) -> Bools:
    """Return which sub-environments the reset option `reset_mask` chooses, shape (num_envs,). None chooses all.

    Raises:
        InputError: if the mask has another shape or type, or chooses none.
    """
    if mask is None:
        return np.ones(num_envs, dtype=bool)
    if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (num_envs,):
        raise InputError(f"reset_mask: expected an array of {num_envs} booleans, got {shown(mask)}")
    if not mask.any():
        raise InputError("reset_mask: at least one sub-environment must be reset")
    return np.ascontiguousarray(mask)


def chosen_seeds(seed: int | Sequence[int | None] | None, num_envs: int) -> list[int | None]:
    """Return the seed of each sub-environment. A single seed s gives sub-environment i the seed s + i.

    Raises:
        InputError: if there is not one seed for each, or one is not a whole number from 0.
    """
    if seed is None:
        return [None] * num_envs
    seeds = [int(seed) + b for b in range(num_envs)] if isinstance(seed, int | np.integer) else seed
    if not isinstance(seeds, Sequence) or len(seeds) != num_envs:
        raise InputError(f"seed: expected one seed, or a list of {num_envs}, got {shown(seed)}")
    if not all(own is None or (isinstance(own, int | np.integer) and own >= 0) for own in seeds):
        raise InputError(f"seed: expected whole numbers from 0, got {shown(seed)}")
    return [None if own is None else int(own) for own in seeds]
