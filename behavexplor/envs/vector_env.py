"""The compiled vector environment, which runs many scenarios in lock-step."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from behavexplor.data.scripted import ScriptedScenario
from behavexplor.data.trace import ENDS
from behavexplor.envs.driving import DrivingEnv
from behavexplor.envs.engine.actions import check_actions
from behavexplor.envs.engine.lock_step import chosen_mode, chosen_options, chosen_seeds, chosen_slots
from behavexplor.envs.source_gate import classes_of, guard_of
from behavexplor.envs.tasks.scripted_episodes import ScriptedEpisodes, odd_action, odd_method, odd_observation
from behavexplor.envs.tasks.scripted_reward import TERMS
from behavexplor.envs.tasks.scripted_slots import IDLE, RUNNING
from behavexplor.envs.values import COUNT, shown
from behavexplor.errors import InputError

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]

_OPTIONS = ("scenario", "scenarios", "reset_mask")
_MASKS_OF_TERMS = tuple(f"_{name}" for name in TERMS)


class DrivingVectorEnv(VectorEnv[NDArray[Any], NDArray[Any], NDArray[Any]]):
    """`num_envs` environments in lock-step, equivalent to `env_class` but many times as fast.

    A subclass names its `env_class`. Sub-environment i behaves like the single environment, to 1e-9 in every state, and
    its NPCs move identically, bit by bit. With a seed s, it draws the scenarios that the single environment draws with
    the seed s + i. The observations `Scene` and `Kinematics` and the actions `ContinuousAction`, `DiscreteAction` and
    `DiscreteMetaAction` are supported. The attribute `scenarios` holds the scenarios of the latest episodes.

    All of gymnasium's autoreset modes are supported. With `AutoresetMode.DISABLED`, a sub-environment whose episode has
    ended rests until it is reset: its action has no effect, its reward is 0, and it still counts as ended.

    Args:
        num_envs: number of sub-environments.
        config: configuration of the environment; see `behavexplor.envs.driving.DrivingEnv`.
        autoreset_mode: gymnasium's autoreset mode, applied after the end of an episode.
        render_mode: must be None, since the vector environment does not render.

    Attributes:
        gives_rewards: whether rewards are computed, True at first. If it is set to False, they are 0, and infos hold
            only the ends of episodes. Executions do not need them.
        checks_actions: whether `step` checks the actions, True at first. If it is set to False, the caller has to.

    Raises:
        InputError: if the config is wrong, or asks for something that only the single environment supports.
    """

    env_class: ClassVar[type[DrivingEnv]]

    def __init__(
        self,
        num_envs: int = 1,
        config: Mapping[str, Any] | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
    ) -> None:
        COUNT.check("num_envs", num_envs)
        if render_mode is not None:
            raise InputError("The vector environment cannot render: replay a trace, or use gymnasium.make")
        self._mode = chosen_mode(autoreset_mode)
        single = self.env_class(config)
        _check_supported(single)
        classes = classes_of(single, map(type, single.road.vehicles))
        self._guard = guard_of(classes)
        self.num_envs = num_envs
        self.config = single.config
        self.logical = single.logical
        self.single_observation_space, self.single_action_space = single.observation_space, single.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.metadata = {"render_modes": [], "autoreset_mode": self._mode}
        self._episodes = ScriptedEpisodes(single, num_envs)
        self._has_idle = True
        self.scenarios: list[ScriptedScenario] = [ScriptedScenario(self.logical.name, ())] * num_envs
        self._generators: list[np.random.Generator | None] = [None] * num_envs
        self.gives_rewards = self.checks_actions = True

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        """Begin episodes.

        Args:
            seed: one seed for each sub-environment, or a single seed s that gives sub-environment i the seed s + i.
            options: a `scenario` for all sub-environments, or a list of `scenarios` with one for each, where None asks
                for a sampled scenario. A `reset_mask` selects the sub-environments to reset, shape (num_envs,).

        Raises:
            InputError: if a scenario cannot be run in this environment, or an option is unknown or has a wrong shape.
        """
        options = chosen_options(options, _OPTIONS)
        mask = chosen_slots(options.get("reset_mask"), self.num_envs)
        scenarios = self._given_scenarios(options)
        seeds = chosen_seeds(seed, self.num_envs)
        if isinstance(seed, int | np.integer):
            super().reset(seed=seeds[0])
        for b, own_seed in enumerate(seeds):
            if mask[b] and own_seed is not None:
                self._generators[b], _ = seeding.np_random(own_seed)
        infos = self._begin(mask, scenarios, is_whole=bool(mask.all()))
        self._episodes.observe(mask)
        return self._episodes.observations.copy(), infos

    def step(self, actions: NDArray[Any]) -> tuple[NDArray[Any], Floats, Bools, Bools, dict[str, Any]]:
        """Take an action in every sub-environment.

        Args:
            actions: one action for each sub-environment, shape (num_envs, ...).

        Raises:
            gymnasium.error.ResetNeeded: if a sub-environment has not begun an episode.
            InputError: if the actions are not in the action space. Numbers beyond the bounds of a Box are clipped.

        Returns:
            Observations, shape (num_envs, ...); rewards, terminations and truncations, each of shape (num_envs,); and
            infos, which contain the `trace` and `end` of episodes that have just ended.
        """
        if self._has_idle:
            raise ResetNeeded("A sub-environment has not begun an episode: call reset before step")
        if self.checks_actions:
            check_actions(self.action_space, actions)
        end = self._episodes.ends
        active = end == RUNNING
        n_ended, ends = self._episodes.decide(np.asarray(actions), active)
        terminated, truncated = ends
        self._episodes.observe(active)
        terms, rewards = None, np.zeros(self.num_envs)
        if self.gives_rewards:
            terms = self._episodes.terms(active)
            rewards = sum(terms, rewards)
        infos: dict[str, Any] = {}
        done = active & (end != RUNNING) if n_ended else None
        if self._mode is AutoresetMode.SAME_STEP and done is not None:
            infos = self._step_infos(active & ~done, terms) | self._final_infos(done, terms)
            infos |= self._begin(done)
            self._episodes.observe(done)
            return self._episodes.observations.copy(), rewards, terminated, truncated, infos
        infos = self._step_infos(active, terms)
        if done is not None:
            infos |= self._end_infos(done)
        if self._mode is AutoresetMode.NEXT_STEP and not active.all():
            infos |= self._begin(~active)
            self._episodes.observe(~active)
            ends[:, ~active] = False
        return self._episodes.observations.copy(), rewards, terminated, truncated, infos

    def _begin(
        self, mask: Bools, scenarios: Sequence[ScriptedScenario | None] | None = None, *, is_whole: bool = False
    ) -> dict[str, Any]:
        """Begin an episode in the chosen slots, with the given scenario or a sampled one.

        Args:
            mask: the chosen slots, shape (num_envs,).
            scenarios: a scenario or None for each slot; None if all are sampled.
            is_whole: whether the user has reset all slots.

        Raises:
            InputError: if a scenario has no room in a slot, or classes have changed since the environment was made.
        """
        self._guard.check(always=is_whole)
        begun: dict[int, ScriptedScenario] = {}
        for b in np.flatnonzero(mask).tolist():
            scenario = scenarios[b] if scenarios else None
            if scenario is None:
                generator = self._generators[b] = self._generators[b] or seeding.np_random()[0]
                scenario = self.logical.sample(generator)
            begun[b] = scenario
        self._episodes.begin(np.flatnonzero(mask), begun.values())
        infos = np.full(self.num_envs, None, dtype=object)
        for b, scenario in begun.items():
            self.scenarios[b] = infos[b] = scenario
        self._has_idle = bool((self._episodes.ends == IDLE).any())
        return {"scenario": infos, "_scenario": mask.copy()}

    def _step_infos(self, mask: Bools, terms: Floats | None) -> dict[str, Any]:
        """Return the single environment's `info` for the chosen slots, in gymnasium's vector format."""
        if terms is None or not mask.any():
            return {}
        speeds, terms = np.where(mask, self._episodes.speeds, 0.0), np.where(mask, terms, 0.0)
        rewards = dict(zip(TERMS, terms, strict=True)) | dict.fromkeys(_MASKS_OF_TERMS, mask)
        return {"speed": speeds, "_speed": mask, "rewards": rewards, "_rewards": mask}

    def _end_infos(self, done: Bools) -> dict[str, Any]:
        """Return what that `info` has besides at the end of an episode, for the chosen slots."""
        ends, traces = np.full((2, self.num_envs), None, dtype=object)
        for b in done.nonzero()[0].tolist():
            ends[b], traces[b] = ENDS[self._episodes.ends[b]], self._episodes.trace(b)
        return {"end": ends, "_end": done, "trace": traces, "_trace": done}

    def _final_infos(self, done: Bools, terms: Floats | None) -> dict[str, Any]:
        observations = np.full(self.num_envs, None, dtype=object)
        for b in np.flatnonzero(done).tolist():
            observations[b] = self._episodes.observations[b].copy()
        infos = {"final_obs": observations, "_final_obs": done}
        return infos | {"final_info": self._step_infos(done, terms) | self._end_infos(done), "_final_info": done}

    def _given_scenarios(self, options: Mapping[str, Any]) -> Sequence[ScriptedScenario | None]:
        given = options.get("scenarios")
        scenarios = [options.get("scenario")] * self.num_envs if given is None else given
        if not isinstance(scenarios, Sequence) or len(scenarios) != self.num_envs:
            raise InputError(f"scenarios: expected a list of {self.num_envs}, got {shown(scenarios)}")
        for scenario in scenarios if given is not None else scenarios[:1]:
            if scenario is None:
                continue
            if not isinstance(scenario, ScriptedScenario):
                raise InputError(
                    f"A scenario must be a behavexplor.data.scripted.ScriptedScenario, got {shown(scenario)}"
                )
            self.logical.check(scenario)
        return scenarios


def vector_env(env_class: type[DrivingEnv]) -> type[DrivingVectorEnv]:
    """Make the vector environment class of an environment class, for gymnasium's `vector_entry_point`.

    It can be pickled if it is stored in the module of `env_class` under its own name, such as `LaneFollowVectorEnv`
    for `LaneFollowEnv`.
    """
    name = env_class.__name__.removesuffix("Env") + "VectorEnv"
    members = {"env_class": env_class, "__doc__": DrivingVectorEnv.__doc__, "__module__": env_class.__module__}
    return type(name, (DrivingVectorEnv,), members)


def _check_supported(env: DrivingEnv) -> None:
    """Check that the vector environment can replace an environment.

    Raises:
        InputError: if it cannot. The message names what is not supported.
    """
    obstacle = odd_method(env, DrivingEnv) or odd_observation(env.observation_type) or odd_action(env.action_type)
    if obstacle:
        raise InputError(
            f"The vector environment does not support {obstacle}; use gymnasium.make, or gymnasium.make_vec with "
            f"vectorization_mode='sync'"
        )
