"""highway-env's own environments as compiled vector environments."""

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from highway_env.envs.common.abstract import AbstractEnv
from numpy.typing import NDArray

from behavexplor.envs.actions import check_actions
from behavexplor.envs.stock.config_check import check_config
from behavexplor.envs.stock.engine_making import kept_class, make_engine, make_outcome, most_at_start, most_new
from behavexplor.envs.stock.episodes import DECISION, FIRST_LOOK, LOGGED_LOOK, WARM_UP, advance
from behavexplor.envs.stock.frame_log import make_log
from behavexplor.envs.stock.given_starts import chosen_draws, chosen_starts, copy_start, with_draws
from behavexplor.envs.stock.infos import final_infos, infos_of
from behavexplor.envs.stock.known_classes import has_own_starts, known_class
from behavexplor.envs.stock.pcg64 import N_WORDS, generator_words, put_words
from behavexplor.envs.stock.resets import ENTER, SPAWN, START, populate
from behavexplor.envs.stock.slot_state import SlotState, slot_state
from behavexplor.envs.stock.state import make_scratch, make_slots
from behavexplor.envs.stock.task import (
    INTERSECTION,
    KINDS,
    MERGE,
    ROUNDABOUT,
)
from behavexplor.envs.values import COUNT, FLAG, optional
from behavexplor.envs.vector.action_decoding import make_commands
from behavexplor.envs.vector.arguments import chosen_mode, chosen_options, chosen_seeds, chosen_slots
from behavexplor.errors import InputError
from behavexplor.jit import compiled_for

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]


class StockVectorEnv(VectorEnv[NDArray[Any], NDArray[Any], NDArray[Any]]):
    """`num_envs` environments of highway-env in lock-step, equal to highway-env's own but hundreds of times as fast.

    The observations, rewards, ends and infos are those of gymnasium's `SyncVectorEnv` of the original environment with
    the same seeds and configuration. If numpy computes as the C library does, they are equal bit by bit; see
    docs/highway-env.md. There is one difference: `infos["action"]` after a reset, which highway-env draws from an
    unseeded generator, is another draw.

    The starts of a subclass that makes its own road or vehicles are made by highway-env itself, and copied.

    Args:
        env_class: highway-env's environment, or a subclass with another road or other starts.
        num_envs: number of sub-environments.
        config: highway-env's configuration of the environment.
        autoreset_mode: gymnasium's autoreset mode, applied after the end of an episode. With `AutoresetMode.DISABLED`,
            a sub-environment whose episode has ended rests until it is reset: it still counts as ended, and its reward
            is 0.
        render_mode: must be None, since the vector environment does not render.
        max_episode_steps: number of decisions after which an episode is truncated.
        rewards: whether rewards are needed. Without them, the environment may be a subclass with rewards of its own,
            and the rewards that `step` returns are not its own.
        log_frames: whether the attribute `frame_log` has the frames of the latest step. Without this, it is empty.

    Attributes:
        frame_log: where every vehicle and obstacle was after each frame of the latest step; see
            `behavexplor.envs.stock.frame_log.FrameLog`. After a call of `reset`, the first frame shows the start. The
            next step overwrites it.
        places_own: whether highway-env itself begins the episodes, since a subclass makes its own road or vehicles.

    Raises:
        InputError: if the config is wrong, or asks for something that only highway-env itself can do.
    """

    def __init__(
        self,
        env_class: type[AbstractEnv],
        num_envs: int = 1,
        config: Mapping[str, Any] | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        *,
        log_frames: bool = False,
        rewards: bool = True,
    ) -> None:
        COUNT.check("num_envs", num_envs)
        optional(COUNT).check("max_episode_steps", max_episode_steps)
        FLAG.check("log_frames", log_frames)
        if render_mode is not None:
            raise InputError("The vector environment cannot render; use gymnasium.make for highway-env's own")
        self._mode = chosen_mode(autoreset_mode)
        known = known_class(env_class, rewards=rewards)
        self._kind = KINDS[known]
        check_config(env_class, known, config)
        self.num_envs = num_envs
        self.metadata = {"render_modes": [], "autoreset_mode": self._mode}
        self._max_steps = math.inf if max_episode_steps is None else max_episode_steps
        self.places_own = has_own_starts(env_class)
        with kept_class(env_class, config):
            self._single = env_class(dict(config or {}))
            self._engine = make_engine(self._single, self._kind, num_envs, places_own=self.places_own)
        n_steps = self._engine.task.starts.plans.shape[-1]
        if self.places_own:
            n_steps = len(self._engine.world.network.roads) + 1
        self._most_at_start = most_at_start(self._single, self._kind, places_own=self.places_own)
        n_places = self._most_at_start + most_new(self._single, self._kind)
        self._slots = make_slots(num_envs, n_places, n_steps)
        self._scratch = make_scratch(len(self._engine.world.network.lanes), n_places)
        n_logged = int(self._engine.world.rules[0].n_frames) if log_frames else 0
        self.frame_log = make_log(num_envs, n_logged, n_places)
        self._outcome = make_outcome(self._single, self._engine, num_envs, self.frame_log)
        self.config: dict[str, Any] = self._single.config
        self.single_observation_space = self._single.observation_space
        self.single_action_space = self._single.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._sampled_space = batch_space(self.single_action_space, num_envs)  # leaves the user's own seed alone
        self._compile()
        self._commands = make_commands(self._single.action_type)
        self._no_lane_changes = np.zeros(num_envs, dtype=bool)
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._is_seeded = np.zeros(num_envs, dtype=bool)
        self._ended = np.zeros(num_envs, dtype=bool)
        self._has_begun = np.zeros(num_envs, dtype=bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        """Begin episodes.

        Args:
            seed: one seed for each sub-environment, or a single seed s that gives sub-environment i the seed s + i.
            options: `reset_mask` selects the sub-environments to reset, shape (num_envs,). `starts` and `draws` give
                starts and draws from outside; see `behavexplor.envs.stock.given_starts`.

        Raises:
            InputError: if an option or a seed cannot be used.
        """
        options = chosen_options(options, ("reset_mask", "starts", "draws"))
        mask = chosen_slots(options.get("reset_mask"), self.num_envs)
        starts = chosen_starts(options.get("starts"), type(self._single), self.config, mask)
        draws = chosen_draws(options.get("draws"), mask)
        for b, own_seed in enumerate(chosen_seeds(seed, self.num_envs)):
            if mask[b] and (own_seed is not None or not self._is_seeded[b]):
                self._engine.words[b, :N_WORDS] = generator_words(seeding.np_random(own_seed)[0])
        self._is_seeded |= mask
        look = LOGGED_LOOK if self.frame_log.frames.size else FIRST_LOOK
        actions = self._begin(mask, starts, draws, look)
        self._has_begun |= mask
        return self._observations(), infos_of(self._kind, self._outcome, actions, mask, ~mask)

    def step(self, actions: NDArray[Any]) -> tuple[NDArray[Any], Floats, Bools, Bools, dict[str, Any]]:
        """Take an action in every sub-environment.

        Args:
            actions: one action for each sub-environment, shape (num_envs, ...).

        Raises:
            gymnasium.error.ResetNeeded: if a sub-environment has not begun an episode.
            InputError: if the actions are not in the action space. Numbers beyond the bounds of a Box are clipped.

        Returns:
            Observations, shape (num_envs, ...); rewards, terminations and truncations, each of shape (num_envs,); and
            the infos of highway-env.
        """
        if not self._has_begun.all():
            raise ResetNeeded("A sub-environment has not begun an episode: call reset before step")
        check_actions(self.action_space, actions)
        actions, outcome = np.asarray(actions), self._outcome
        rest, active = self._ended, ~self._ended
        if self.frame_log.frames.size:
            self.frame_log.frames[rest] = 0
        self._advance(active, actions, DECISION)
        if self._kind == INTERSECTION:
            self._populate(active, SPAWN)
        self._steps += active
        outcome.truncated[self._steps >= self._max_steps] = True
        rewards = np.where(rest, 0.0, outcome.rewards)
        terminated, truncated = outcome.terminated.copy(), outcome.truncated.copy()
        if self._mode is AutoresetMode.NEXT_STEP and rest.any():
            actions = _merged(rest, self._begin(rest), actions)
            terminated[rest] = truncated[rest] = False
        self._ended = terminated | truncated
        if self._mode is AutoresetMode.SAME_STEP and self._ended.any():
            return self._reset_ended(actions, rewards, terminated, truncated)
        chosen = active if self._mode is AutoresetMode.DISABLED else np.ones(self.num_envs, dtype=bool)
        infos = infos_of(self._kind, outcome, actions, chosen, active)
        return self._observations(), rewards, terminated, truncated, infos

    def state(self, b: int) -> SlotState:
        """Return a copy of the state of sub-environment b."""
        return slot_state(self._slots, b)

    def _reset_ended(
        self, actions: NDArray[Any], rewards: Floats, terminated: Bools, truncated: Bools
    ) -> tuple[NDArray[Any], Floats, Bools, Bools, dict[str, Any]]:
        """Begin the next episodes in the same step, and return the results of the step."""
        ended, self._ended = self._ended, np.zeros(self.num_envs, dtype=bool)
        last = infos_of(self._kind, self._outcome, actions, ended, ended)
        final = final_infos(self._observations(), last, ended)
        actions = _merged(ended, self._begin(ended), actions)
        everywhere = np.ones(self.num_envs, dtype=bool)
        infos = infos_of(self._kind, self._outcome, actions, everywhere, ~ended) | final
        return self._observations(), rewards, terminated, truncated, infos

    def _begin(
        self,
        mask: Bools,
        starts: Mapping[int, AbstractEnv] = MappingProxyType({}),
        draws: Mapping[int, Floats] = MappingProxyType({}),
        look: int = FIRST_LOOK,
    ) -> NDArray[Any]:
        """Begin episodes in the chosen slots, and return the actions that their infos show, shape (num_envs, ...).

        Args:
            mask: the chosen slots, shape (num_envs,).
            starts: the starts of some of them.
            draws: the draws of some of them.
            look: FIRST_LOOK or LOGGED_LOOK.
        """
        actions: NDArray[Any] = self._sampled_space.sample()
        own, seen = mask.copy(), dict[int, NDArray[Any]]()
        for b, env in starts.items():
            own[b] = False
            copy_start(env, self._engine, self._slots, b, self._most_at_start)
        self._engine = with_draws(self._engine, mask, draws)
        if self.places_own:
            seen = self._copy_starts(own)
        elif own.any():
            self._populate(own, START)
            if self._kind == INTERSECTION:
                self._advance(own, actions, WARM_UP)
                self._populate(own, ENTER)
        words = self._engine.words.copy()
        self._advance(mask, actions, look)
        for b in (*starts, *seen):  # highway-env has drawn the order of this observation already
            self._engine.words[b] = words[b]
        for b, observation in seen.items():
            self._outcome.observations[b] = observation.reshape(self._outcome.observations[b].shape)
        self._steps[mask] = 0
        self._ended = self._ended & ~mask
        return actions

    def _compile(self) -> None:
        """Compile the kernels for the types of this environment's arrays, or read them from the cache."""
        world, task, _, words = self._engine
        mask, commands = np.zeros(self.num_envs, dtype=bool), np.zeros((self.num_envs, 2))
        self._advance_slots = compiled_for(
            advance, self._engine, self._slots, self._scratch, mask, commands, mask, self._outcome, DECISION
        )
        self._populate_slots = compiled_for(populate, world, task, self._slots, self._scratch, words, mask, START)

    def _advance(self, mask: Bools, actions: NDArray[Any], stage: int) -> None:
        commands, lane_changes = self._commands(actions), self._lane_changes(actions)
        self._advance_slots(
            self._engine,
            self._slots,
            self._scratch,
            np.ascontiguousarray(mask, dtype=np.bool_),
            np.ascontiguousarray(commands, dtype=np.float64),
            np.ascontiguousarray(lane_changes, dtype=np.bool_),
            self._outcome,
            stage,
        )

    def _populate(self, mask: Bools, stage: int) -> None:
        world, task, _, words = self._engine
        mask = np.ascontiguousarray(mask, dtype=np.bool_)
        self._populate_slots(world, task, self._slots, self._scratch, words, mask, stage)

    def _copy_starts(self, mask: Bools) -> dict[int, NDArray[Any]]:
        """Let highway-env begin episodes, copy them to the chosen slots, and return its observations by their slot."""
        env, seen = self._single, {}
        with kept_class(type(env), self.config):
            for b in np.flatnonzero(mask).tolist():
                put_words(self._engine.words[b], env.np_random)
                seen[b], _ = env.reset()
                copy_start(env, self._engine, self._slots, b, self._most_at_start)
        return seen

    def _lane_changes(self, actions: NDArray[Any]) -> Bools:
        """Return which actions highway-env counts as changes of lane, by their number alone, shape (num_envs,)."""
        if self._kind in (MERGE, ROUNDABOUT):  # the others do not ask
            return np.asarray((actions == 0) | (actions == 2))
        return self._no_lane_changes

    def _observations(self) -> NDArray[Any]:
        return self._outcome.observations.reshape(self.observation_space.shape).copy()


def _merged(mask: Bools, chosen: NDArray[Any], others: NDArray[Any]) -> NDArray[Any]:
    """Return actions, shape (B, ...): `chosen` where the mask is True, else `others`."""
    return np.where(mask.reshape(-1, *[1] * (others.ndim - 1)), chosen, others).astype(others.dtype, copy=False)
