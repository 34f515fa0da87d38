"""highway-env's own environments as compiled vector environments."""

import warnings
from collections.abc import Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
from gymnasium.envs.registration import load_env_creator
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from gymnasium.vector.utils import batch_space
from gymnasium.wrappers import TimeLimit
from highway_env.envs.common.abstract import AbstractEnv

from behavexplor import HIGHWAY_ENV
from behavexplor.data.array_types import Array, Bools, Floats, Ints
from behavexplor.envs.engine.actions import check_actions, command_table, make_commands
from behavexplor.envs.engine.frame_log import make_log
from behavexplor.envs.engine.lock_step_vector_env import LockStepVectorEnv
from behavexplor.envs.engine.pcg64 import N_WORDS, generator_words, put_words
from behavexplor.envs.engine.state import NO_ROAD, make_scratch, make_slots
from behavexplor.envs.engine.vehicle_parameters import TRAFFIC_PARAMETERS, classes_of_vehicles, kept_parameters
from behavexplor.envs.highway import engine_making
from behavexplor.envs.highway.config_check import check_config, has_own_starts, known_class
from behavexplor.envs.highway.conversion import SlotState, slot_state
from behavexplor.envs.highway.episodes import (
    BEGINNING,
    DECISION,
    FULL,
    LOOK,
    REFUSED,
    REWARD,
    STEPPED,
    TERMINATED,
    TRUNCATED,
    Actions,
    advance,
    infos_of,
)
from behavexplor.envs.source_gate import ChangedError, classes_of, guard_of
from behavexplor.envs.tasks.highway_tasks import KINDS, NUMBERS
from behavexplor.envs.values import COUNT, FLAG, optional
from behavexplor.errors import InputError
from behavexplor.jit import compiled_for


class HighwayVectorEnv(LockStepVectorEnv):
    """`num_envs` environments of highway-env in lock-step, equal to highway-env's own but hundreds of times as fast.

    The observations, rewards, ends and infos are those of gymnasium's `SyncVectorEnv` of the original environment with
    the same seeds and configuration. If numpy computes as the C library does, they are equal bit by bit; see
    docs/highway-env.md. There is one difference: `infos["action"]` after a reset, which highway-env draws from an
    unseeded generator, is another draw.

    The starts of a subclass that makes its own road or vehicles are made by highway-env itself, and copied. The options
    `starts` and `draws` of `reset` give starts and draws from outside; see `behavexplor.envs.highway.engine_making`.

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
        frame_log: where every vehicle and obstacle was after each frame of the latest step, or the ego alone (see
            `log_egos`); see `behavexplor.envs.engine.frame_log.FrameLog`. After a call of `reset`, the first frame
            shows the start. The next step overwrites it.
        places_own: whether highway-env itself begins the episodes, since a subclass makes its own road or vehicles.

    Raises:
        InputError: if the config is wrong, or asks for something that only highway-env itself can do.
    """

    _options = ("reset_mask", "starts", "draws")

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
        optional(COUNT).check("max_episode_steps", max_episode_steps)
        FLAG.check("log_frames", log_frames)
        if render_mode is not None:
            raise InputError("The vector environment cannot render; use gymnasium.make for highway-env's own")
        COUNT.check("num_envs", num_envs)
        known = known_class(env_class, rewards=rewards)
        number = NUMBERS[known]
        self._kind = KINDS[number]
        check_config(env_class, known, config)
        self.places_own = has_own_starts(env_class)
        with kept_parameters():
            self._single = env_class(dict(config or {}))
            classes = classes_of(self._single, classes_of_vehicles(self._single))
            guard = guard_of(classes, TRAFFIC_PARAMETERS, TRAFFIC_PARAMETERS if self.places_own else frozenset())
            self._engine = engine_making.make_engine(
                self._single, number, num_envs, places_own=self.places_own, most_decisions=max_episode_steps
            )
        super().__init__(self._single, num_envs, autoreset_mode, guard)
        self._make_arrays(num_envs, log_frames=log_frames)
        self._sampled_space = batch_space(self.single_action_space, num_envs)  # leaves the user's own seed alone
        self._observations = self._results.observations.reshape(self.observation_space.shape)
        self._everywhere = np.ones(num_envs, dtype=bool)
        self._commands, table = make_commands(self._single.action_type), command_table(self._single.action_type)
        self._is_discrete = table is not None
        self._actions = Actions(np.zeros((num_envs, 2)) if table is None else table, np.arange(num_envs))
        self._sampled = self._sampled_space.sample()  # actions that infos show after a reset
        self._taken = self._sampled  # latest actions
        self._is_seeded = np.zeros(num_envs, dtype=bool)
        state = (self._engine, self._slots, self._scratch, self._results)  # the kernel is compiled for their types
        self._advance_slots = compiled_for(advance, *state, self._everywhere, self._actions, DECISION, False)

    def _make_arrays(self, num_envs: int, *, log_frames: bool) -> None:
        """Create the arrays that the kernels read and fill."""
        n_steps = self._engine.task.starts.plans.shape[-1]
        if self.places_own:
            n_steps = len(self._engine.world.network.roads) + 1
        self._most_at_start = engine_making.most_at_start(self._single, self._engine.task, places_own=self.places_own)
        n_places = self._most_at_start + engine_making.most_new(self._single, self._engine.task)
        self._slots = make_slots(num_envs, n_places, n_steps)
        self._scratch = make_scratch(len(self._engine.world.network.lanes), n_places)
        n_logged = int(self._engine.world.rules[0].n_frames) if log_frames else 0
        self.frame_log = make_log(num_envs, n_logged, n_places)
        self._results = engine_making.make_results(self._single, self._engine, num_envs, self.frame_log)
        # after the latest decision, if there was one: copies, since a new episode overwrites the results
        self._decided = self._results.numbers, self._results.flags

    def _given(self, options: dict[str, Any], mask: Bools) -> tuple[Any, ...]:
        starts = engine_making.chosen_starts(options.get("starts"), type(self._single), self.config, mask)
        draws = engine_making.chosen_draws(options.get("draws"), mask)
        logs_start = self.frame_log.frames.size > 0
        return starts, draws, logs_start

    def _seed(self, b: int, seed: int | None) -> None:
        if seed is not None or not self._is_seeded[b]:
            self._engine.words[b, :N_WORDS] = generator_words(seeding.np_random(seed)[0])
        self._is_seeded[b] = True

    def _decide(self, actions: Array) -> tuple[Floats, Bools, Bools, Bools, int]:
        n_ended = self._advance(DECISION, self._everywhere, actions)
        self._taken = actions.copy()
        numbers, flags = self._results.numbers.copy(), self._results.flags.copy()
        self._decided = numbers, flags
        return numbers[REWARD], flags[TERMINATED], flags[TRUNCATED], flags[STEPPED], n_ended

    def _infos(self, stepped: Bools, begun: Bools | None = None) -> dict[str, Any]:
        if begun is None:  # no episode has begun since the latest decision
            return infos_of(self._kind, *self._decided, self._taken, stepped)
        shown = self._taken.copy()
        shown[begun] = self._sampled[begun]
        return infos_of(self._kind, self._results.numbers.copy(), self._results.flags.copy(), shown, stepped | begun)

    def state(self, b: int) -> SlotState:
        """Return a copy of the state of sub-environment b."""
        return slot_state(self._slots, b)

    def log_egos(self, *, alone: bool) -> None:
        """Choose whether the log of frames, if there is one, has the egos alone or all vehicles from now on."""
        n_places = 1 if alone else self._slots.vehicles.shape[1]
        n_slots, n_frames = self.frame_log.frames.shape
        self.frame_log = make_log(n_slots, n_frames, n_places)
        self._results = self._results._replace(log=self.frame_log)

    def roads_ahead(self, chosen: Sequence[int], count: int) -> Ints:
        """Return the next roads of the egos' routes in the chosen sub-environments, shape (chosen, count).

        After the end of a route, there is `NO_ROAD`.
        """
        egos = self._slots.episodes["ego"][chosen]
        own, routes = self._slots.vehicles[chosen, egos], self._slots.routes["road"][chosen, egos]
        steps = own["route_position"][:, None] + np.arange(count)
        roads = np.take_along_axis(routes, np.minimum(steps, routes.shape[1] - 1), axis=1)
        return np.where(steps < own["route_length"][:, None], roads, NO_ROAD)

    def snapshot(self, b: int) -> tuple[Array, ...]:
        """Return a copy of all that the episode of sub-environment b goes on from, for `restore`."""
        return tuple(rows[b].copy() for rows in self._rows)

    def restore(self, b: int, snapshot: tuple[Array, ...]) -> None:
        """Let sub-environment b go on from a snapshot of a sub-environment that was begun with the same draws."""
        for rows, row in zip(self._rows, snapshot, strict=True):
            rows[b] = row

    @property
    def _rows(self) -> tuple[Array, ...]:
        """The arrays that hold the episodes, one row for each sub-environment."""
        results = self._results
        return *self._slots, self._engine.words, results.numbers.T, results.flags.T, self._observations

    def _begin(
        self,
        mask: Bools,
        starts: Mapping[int, AbstractEnv] = MappingProxyType({}),
        draws: Mapping[int, Floats] = MappingProxyType({}),
        logs_start: bool = False,
    ) -> None:
        """Begin episodes in the chosen slots, shape (num_envs,), some of them by given starts or with given draws."""
        actions: Array = self._sampled_space.sample()
        own = mask.copy()
        seen: dict[int, Array] = {}
        for b, env in starts.items():
            own[b] = False
            engine_making.copy_start(env, self._engine, self._slots, b, self._most_at_start)
        self._engine = engine_making.with_draws(self._engine, mask, draws)
        if self.places_own:
            seen = self._copy_starts(own)
        else:
            self._advance(BEGINNING, own, actions, logs_start=logs_start)
        if starts or seen:
            copied = np.zeros(self.num_envs, dtype=bool)
            copied[[*starts, *seen]] = True
            words = self._engine.words[copied]
            self._advance(LOOK, copied, actions, logs_start=logs_start)
            self._engine.words[copied] = words  # highway-env has drawn the order of this observation already
        for b, observation in seen.items():
            self._observations[b] = observation
        self._sampled = actions

    def _advance(self, stage: int, mask: Bools, actions: Array, *, logs_start: bool = False) -> int:
        """Run a stage of `advance` in the chosen slots, and return the number of those whose episode has ended."""
        self._put(actions)
        n_ended = self._advance_slots(
            self._engine, self._slots, self._scratch, self._results, mask, self._actions, stage, logs_start
        )
        if n_ended == REFUSED:
            check_actions(self.action_space, actions)
        if n_ended == FULL:
            raise InputError(f"An episode has more vehicles than the {self._slots.vehicles.shape[1]} that have room")
        return n_ended

    def _put(self, actions: Array) -> None:
        """Hand actions to the kernel, which itself refuses discrete actions that are out of range."""
        if not self._is_discrete:
            check_actions(self.action_space, actions)
            self._actions.commands[:] = self._commands(actions)
            return
        if actions.dtype.kind not in "iu" or actions.shape != (self.num_envs,):
            check_actions(self.action_space, actions)
        self._actions.choices[:] = actions

    def _copy_starts(self, mask: Bools) -> dict[int, Array]:
        """Let highway-env begin episodes, copy them to the chosen slots, and return its observations by their slot."""
        env, seen = self._single, {}
        with kept_parameters():
            for b in np.flatnonzero(mask).tolist():
                put_words(self._engine.words[b], env.np_random)
                seen[b], _ = env.reset()
                engine_making.copy_start(env, self._engine, self._slots, b, self._most_at_start)
        return seen


def vector_env(env_class: type[AbstractEnv], **arguments: Any) -> VectorEnv[Any, Any, Any]:
    """Make the compiled vector environment of a class of highway-env.

    If the classes that run are not those that the compiled engine was ported from, because this program has replaced a
    method or highway-env is another release, highway-env itself runs, and a warning says so.

    Raises:
        InputError: if the compiled engine does not support the environment or its configuration.
    """
    try:
        return HighwayVectorEnv(env_class, **arguments)
    except ChangedError as error:
        warnings.warn(
            f"highway-env itself runs, hundreds of times as slow, because the {error.reason}: this program "
            f"has replaced it, or highway-env is another release",
            stacklevel=2,
        )
    return _original(env_class, **arguments)


def _original(
    env_class: type[AbstractEnv],
    num_envs: int = 1,
    config: Any = None,
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    render_mode: str | None = None,
    max_episode_steps: int | None = None,
) -> VectorEnv[Any, Any, Any]:
    """Make a vector environment of highway-env's own environments, with the arguments of `HighwayVectorEnv`."""

    def single() -> Any:
        env = env_class(config, render_mode)
        return env if max_episode_steps is None else TimeLimit(env, max_episode_steps)

    return SyncVectorEnv([single] * num_envs, autoreset_mode=autoreset_mode)


def __getattr__(name: str) -> partial[VectorEnv[Any, Any, Any]]:
    """Return the function that makes a vector environment, such as `highway_fast_v0`."""
    entry_points = {registered.replace("-", "_"): entry_point for registered, entry_point in HIGHWAY_ENV.items()}
    if name not in entry_points:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    env_class: Any = load_env_creator(entry_points[name])
    return partial(vector_env, env_class)
