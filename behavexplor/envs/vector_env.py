"""The compiled vector environment, which runs many scenarios in lock-step."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode

from behavexplor.data.array_types import Array, Bools, Floats
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.data.trace import ENDS
from behavexplor.envs.driving import DrivingEnv
from behavexplor.envs.engine.actions import check_actions
from behavexplor.envs.engine.lock_step_vector_env import LockStepVectorEnv
from behavexplor.envs.source_gate import classes_of, guard_of
from behavexplor.envs.tasks.scripted_episodes import ScriptedEpisodes, odd_action, odd_method, odd_observation
from behavexplor.envs.tasks.scripted_outcome import TERMS
from behavexplor.envs.tasks.scripted_slots import RUNNING
from behavexplor.envs.values import shown
from behavexplor.errors import InputError

_MASKS_OF_TERMS = tuple(f"_{name}" for name in TERMS)


class DrivingVectorEnv(LockStepVectorEnv):
    """`num_envs` environments in lock-step, equivalent to `env_class` but many times as fast.

    A subclass names its `env_class`. Sub-environment i behaves like the single environment, to 1e-9 in every state, and
    its NPCs move identically, bit by bit. With a seed s, it draws the scenarios that the single environment draws with
    the seed s + i. The observations `Scene` and `Kinematics` and the actions `ContinuousAction`, `DiscreteAction` and
    `DiscreteMetaAction` are supported. The attribute `scenarios` holds the scenarios of the latest episodes.

    All of gymnasium's autoreset modes are supported. With `AutoresetMode.DISABLED`, a sub-environment whose episode has
    ended rests until it is reset: its action has no effect, its reward is 0, and it still counts as ended.

    The options of `reset` are a `scenario` for all sub-environments, or a list of `scenarios` with one for each, where
    None asks for a sampled scenario. Infos contain the `trace` and `end` of episodes that have just ended.

    Args:
        num_envs: number of sub-environments.
        config: configuration of the environment; see `behavexplor.envs.driving.DrivingEnv`.
        autoreset_mode: gymnasium's autoreset mode, applied after the end of an episode.
        render_mode: must be None, since the vector environment does not render.
        max_episode_steps: must be None, since episodes end by the config's `duration`.

    Attributes:
        gives_rewards: whether rewards are computed, True at first. If it is set to False, they are 0, and infos hold
            only the ends of episodes. Executions do not need them.
        checks_actions: whether `step` checks the actions, True at first. If it is set to False, the caller has to.
        short_traces: whether only failures matter, False at first. If it is set to True, the `trace` of an episode that
            may be without failure has its last frames only, with the same judgment; that of any other is None.

    Raises:
        InputError: if the config is wrong, or asks for something that only the single environment supports.
    """

    env_class: ClassVar[type[DrivingEnv]]
    _options = ("scenario", "scenarios", "reset_mask")

    def __init__(
        self,
        num_envs: int = 1,
        config: Mapping[str, Any] | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
    ) -> None:
        if render_mode is not None:
            raise InputError("The vector environment cannot render: replay a trace, or use gymnasium.make")
        if max_episode_steps is not None:
            raise InputError(
                "The vector environment takes no max_episode_steps: set `duration` [s] in its config, or use "
                "gymnasium.make_vec with vectorization_mode='sync'"
            )
        single = self.env_class(config)
        _check_supported(single)
        guard = guard_of(classes_of(single, map(type, single.road.vehicles)))
        super().__init__(single, num_envs, autoreset_mode, guard)
        self.logical = single.logical
        self._episodes = ScriptedEpisodes(single, num_envs)
        self._observations = self._episodes.observations
        self.scenarios: list[ScriptedScenario] = [ScriptedScenario(self.logical.name, ())] * num_envs
        self._generators: list[np.random.Generator | None] = [None] * num_envs
        self._terms: Floats | None = None  # of the rewards of the latest decision; None if none are computed
        self._n_ended = 0  # number of episodes that ended with the latest decision
        self.gives_rewards = self.checks_actions = True
        self.short_traces = False

    def _seed(self, b: int, seed: int | None) -> None:
        if seed is not None:
            self._generators[b], _ = seeding.np_random(seed)

    def _decide(self, actions: Array) -> tuple[Floats, Bools, Bools, Bools, int]:
        if self.checks_actions:
            check_actions(self.action_space, actions)
        stepped = self._episodes.ends == RUNNING
        ends, self._n_ended = self._episodes.decide(actions, stepped)
        self._episodes.observe(stepped)
        self._terms, rewards = None, np.zeros(self.num_envs)
        if self.gives_rewards:
            self._terms = self._episodes.terms(stepped)
            rewards = sum(self._terms, rewards)
        terminated, truncated = ends
        return rewards, terminated, truncated, stepped, self._n_ended

    def _begin(self, mask: Bools, scenarios: Sequence[ScriptedScenario | None] | None = None) -> None:
        """Begin an episode in the chosen slots, with the given scenario or a sampled one."""
        begun: dict[int, ScriptedScenario] = {}
        chosen = np.flatnonzero(mask)
        for b in chosen.tolist():
            scenario = scenarios[b] if scenarios else None
            if scenario is None:
                generator = self._generators[b] = self._generators[b] or seeding.np_random()[0]
                scenario = self.logical.sample(generator)
            begun[b] = scenario
        self._episodes.begin(chosen, begun.values())
        for b, scenario in begun.items():
            self.scenarios[b] = scenario
        self._episodes.observe(mask)

    def _infos(self, stepped: Bools, begun: Bools | None = None) -> dict[str, Any]:
        infos: dict[str, Any] = {}
        if self._terms is not None and np.count_nonzero(stepped):
            speeds, terms = np.where(stepped, self._episodes.speeds, 0.0), np.where(stepped, self._terms, 0.0)
            rewards = dict(zip(TERMS, terms, strict=True)) | dict.fromkeys(_MASKS_OF_TERMS, stepped)
            infos = {"speed": speeds, "_speed": stepped, "rewards": rewards, "_rewards": stepped}
        if self._n_ended:
            infos |= self._end_infos(stepped & (self._episodes.ends != RUNNING))
        if begun is not None:
            scenarios = np.full(self.num_envs, None, dtype=object)
            for b in begun.nonzero()[0].tolist():
                scenarios[b] = self.scenarios[b]
            infos |= {"scenario": scenarios, "_scenario": begun}
        return infos

    def _end_infos(self, done: Bools) -> dict[str, Any]:
        """Return the further infos of episodes that have just ended; nothing if there are none."""
        # none are left in the second call of a step that resets at once
        if not done.any():
            return {}
        ends, traces = np.full((2, self.num_envs), None, dtype=object)
        for b in done.nonzero()[0].tolist():
            ends[b] = ENDS[self._episodes.ends[b]]
            traces[b] = self._episodes.ending(b) if self.short_traces else self._episodes.trace(b)
        return {"end": ends, "_end": done, "trace": traces, "_trace": done}

    def _given(self, options: Mapping[str, Any], mask: Bools) -> tuple[Sequence[ScriptedScenario | None]]:
        """Return the given scenarios, as the only further argument of `_begin`."""
        del mask
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
        return (scenarios,)


def vector_env(env_class: type[DrivingEnv]) -> type[DrivingVectorEnv]:
    """Make the vector environment class of an environment class, for gymnasium's `vector_entry_point`.

    It can be pickled if it is stored in the module of `env_class` under its own name, such as `LaneFollowVectorEnv`
    for `LaneFollowEnv`.
    """
    name = env_class.__name__.removesuffix("Env") + "VectorEnv"
    members = {"env_class": env_class, "__doc__": DrivingVectorEnv.__doc__, "__module__": env_class.__module__}
    return type(name, (DrivingVectorEnv,), members)


def _check_supported(env: DrivingEnv) -> None:
    """Refuse an environment from which the vector environment would silently differ."""
    obstacle = odd_method(env, DrivingEnv) or odd_observation(env.observation_type) or odd_action(env.action_type)
    if obstacle:
        raise InputError(
            f"The vector environment does not support {obstacle}; use gymnasium.make, or gymnasium.make_vec with "
            f"vectorization_mode='sync'"
        )
