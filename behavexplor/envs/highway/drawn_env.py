"""A highway-env environment whose episodes are given by its own random draws."""

import re
from collections.abc import Callable
from typing import Any, Final

import gymnasium
import highway_env
from gymnasium.error import ResetNeeded
from gymnasium.wrappers import TimeLimit
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.common.action import DiscreteMetaAction
from highway_env.vehicle.behavior import IDMVehicle

from behavexplor.data.drawn_logical import UNIFORM, Draw, DrawnLogicalScenario
from behavexplor.data.drawn_scenario import DEFAULT, WIDE, DrawnScenario, Setup, Traffic, config_text, sorted_draws
from behavexplor.data.road_plan import RoadPlan
from behavexplor.data.road_shape import RoadShape
from behavexplor.envs.engine.lock_step_vector_env import chosen_options
from behavexplor.envs.engine.vehicle_parameters import VehicleClasses
from behavexplor.envs.highway.course import road_plan, road_shape
from behavexplor.envs.highway.episode_record import EpisodeRecord, Watch, has_arrived
from behavexplor.envs.highway.generator import DrawnGenerator
from behavexplor.envs.highway.wide_traffic import widen
from behavexplor.errors import InputError

MOST_DECISIONS: Final = 10_000  # of an episode that its environment would never end
_PROBES: Final = 3  # resets from which the environment's draws are read
_COUNT: Final = re.compile(r"#\d+")  # of calls, in the names of draws


class DrawnEnv(gymnasium.Env[Any, Any]):
    """A highway-env environment, unchanged, whose episodes are given by its own random draws.

    `reset(options={"scenario": scenario})` plays the draws of a scenario, see `behavexplor.data.drawn_scenario`.
    Without the option, the environment draws as always. `info["scenario"]` is the scenario. At the end of an episode,
    it has all draws that were made, and `info["trace"]` is the trace.

    Args:
        name: name of the environment, such as "highway-fast-v0" or "module:id".
        env: the environment, as gymnasium makes it.
        traffic: kind of traffic, see `behavexplor.data.drawn_scenario.Setup`.

    Attributes:
        inner: the environment of highway-env, without wrappers.
        logical: all scenarios of the environment in this configuration.
        record: the record of the present episode; None before the first one.
        generator: the generator of the present episode.
        vehicle_classes: the parameters of highway-env's vehicle classes in this environment.
    """

    def __init__(self, name: str, env: gymnasium.Env[Any, Any], traffic: Traffic = DEFAULT) -> None:
        self._env = env
        inner: Any = env.unwrapped
        self.inner: AbstractEnv = inner
        if traffic == WIDE:
            widen(inner)
        self.observation_space = self._env.observation_space
        self.action_space = self._env.action_space
        self.metadata = self._env.metadata
        self.render_mode = self._env.render_mode
        self.record: EpisodeRecord | None = None
        self.vehicle_classes = VehicleClasses()
        self.generator = DrawnGenerator({}, 0, __file__)
        self._seed = 0
        self._decisions = 0
        layout = self._layout()  # first, because an environment may also draw keys of its configuration
        self._setup = Setup(name, config_text(self.inner.config), traffic, highway_env.__version__)
        self.logical = DrawnLogicalScenario(self._setup, layout)

    def __reduce__(self) -> str:
        """Refuse to be copied or pickled: the copy's episode would go on in this environment's road.

        Raises:
            InputError: always.
        """
        raise InputError(
            "A highway-env environment that records its episodes cannot be copied: make another one, reset it with "
            "the scenario of this one, and take the same actions"
        )

    @property
    def config(self) -> dict[str, Any]:
        """highway-env's whole configuration."""
        config: dict[str, Any] = self.inner.config
        return config

    @property
    def wrappers(self) -> list[gymnasium.Wrapper[Any, Any, Any, Any]]:
        """The wrappers with which the environment is registered, the outermost one first."""
        found = []
        env = self._env
        while isinstance(env, gymnasium.Wrapper):
            found.append(env)
            env = env.env
        return found

    @property
    def meta_actions(self) -> tuple[str, ...]:
        """Names of the actions in their order if the ego drives by meta-actions; otherwise nothing."""
        kind = self.inner.action_type
        return tuple(kind.actions.values()) if isinstance(kind, DiscreteMetaAction) else ()

    @property
    def max_decisions(self) -> int:
        """Number of decisions after which an episode is truncated: by gymnasium, or because it would never end."""
        limits = [one._max_episode_steps for one in self.wrappers if isinstance(one, TimeLimit)]  # noqa: SLF001
        return min([*limits, MOST_DECISIONS])

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode with the `scenario` among the options, or with draws by the seed.

        Raises:
            InputError: if the scenario is not one of this environment in this configuration, or an option is unknown.
        """
        scenario = chosen_options(options, ("scenario",)).get("scenario")
        if scenario is None:
            super().reset(seed=seed)
            generator = DrawnGenerator({}, self.np_random, __file__)
        else:
            self.logical.check(scenario)
            generator = DrawnGenerator(dict(scenario.draws), scenario.seed, __file__)
        self._seed = 0 if scenario is None else scenario.seed
        observation, info = self._begin(generator)
        self.record = Watch(self.inner).record
        return observation, {**info, "scenario": scenario or self.played()}

    def begin_blindly(self, scenario: DrawnScenario) -> None:
        """Begin an episode without its first observation, which takes highway-env longer than the rest of a reset.

        Raises:
            InputError: if the scenario is not one of this environment.
        """
        define: Callable[[], None] = self.inner.define_spaces

        def define_blindly() -> None:
            define()
            self.inner.observation_type.observe = lambda: None

        self.inner.define_spaces = define_blindly
        try:
            self.reset(options={"scenario": scenario})
        finally:
            del self.inner.define_spaces
            define()

    def _begin(self, generator: DrawnGenerator) -> tuple[Any, dict[str, Any]]:
        self.generator = generator
        self._decisions = 0
        with self.vehicle_classes.applied():
            self.inner._np_random = generator  # noqa: SLF001 - gymnasium's own place for a given generator
            result: tuple[Any, dict[str, Any]] = self._env.reset()
        generator.forget_calls()
        return result

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Take an action; see the environment."""
        record = self.record
        if record is None:
            raise ResetNeeded("The environment has not begun an episode: call reset before step")
        record.decide(action)
        observation, reward, terminated, truncated, info = self._decide(action)
        record.judge(has_arrived(self.inner, info))
        if terminated or truncated:
            trace = record.trace(self.inner.road.network, terminated=bool(terminated))
            info = {**info, "trace": trace, "scenario": self.played()}
        return observation, float(reward), bool(terminated), bool(truncated), info

    def _decide(self, action: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        with self.vehicle_classes.applied():
            observation, reward, terminated, truncated, info = self._env.step(action)
        self._decisions += 1
        self.generator.forget_calls()
        return observation, reward, terminated, truncated or self._decisions >= MOST_DECISIONS, info

    def played(self) -> DrawnScenario:
        """Return the scenario of the present episode with all draws that were made so far."""
        return DrawnScenario(self._setup, self._seed, sorted_draws(self.generator.drawn))

    def _layout(self) -> tuple[Draw, ...]:
        """Read the environment's draws from a few episodes."""
        layout = Layout(type(self.inner))
        for seed in range(_PROBES):
            generator = DrawnGenerator({}, seed, __file__, self._n_vehicles)
            self._begin(generator)
            if seed == 0:
                self._drive_on(generator)
            layout.add(generator)
        return layout.draws()

    def _drive_on(self, generator: DrawnGenerator) -> None:
        """Drive an episode of drawn actions to its time limit if the environment draws while it runs."""
        config = self.inner.config
        self.action_space.seed(0)
        limit = min(int(config.get("duration", 1) * config["policy_frequency"]) + 1, MOST_DECISIONS)
        for decision in range(limit):
            before = generator.count
            self._decide(self.action_space.sample())
            if decision == 0 and generator.count == before:
                return

    def _n_vehicles(self) -> int:
        road = self.inner.road
        return 0 if road is None else len(road.vehicles)

    def road_shape(self) -> RoadShape:
        """Return the shape of the road for pictures."""
        return road_shape(self.inner.road.network)

    def road_plan(self) -> RoadPlan:
        """Return the lanes of the road.

        Raises:
            InputError: if one has a shape that other tools cannot be told.
        """
        return road_plan(self.inner.road.network)

    def render(self) -> Any:
        """Render the environment."""
        return self._env.render()

    def close(self) -> None:
        """Release the environment's resources."""
        self._env.close()


class Layout:
    """The draws of an environment by name, with their kinds and the blocks to which they belong.

    Draws belong together if they are made in one of several calls of the same method of the environment, such as one
    that lets a vehicle appear. All other draws belong to the vehicle that is placed next.
    """

    def __init__(self, env: type) -> None:
        self._env = env
        self._kinds: dict[str, list[str]] = {}
        self._next_vehicle: dict[tuple[str, int], int] = {}

    def add(self, generator: DrawnGenerator) -> None:
        """Add the draws of an episode."""
        for name, kinds in generator.kinds.items():
            if len(kinds) > len(self._kinds.get(name, ())):
                self._kinds[name] = list(kinds)
            for position, vehicle in enumerate(generator.labels[name]):
                self._next_vehicle.setdefault((name, position), vehicle)

    def draws(self) -> tuple[Draw, ...]:
        """Return the draws. A call that drew less than another call of the same function gets the other's draws."""
        kinds = self._completed()
        labels = {(name, i): self._label(name, i) for name in sorted(kinds) for i in range(len(kinds[name]))}
        blocks = {label: block for block, label in enumerate(sorted(set(labels.values())))}
        return tuple(
            Draw(name, position, kinds[name][position], blocks[label]) for (name, position), label in labels.items()
        )

    def _completed(self) -> dict[str, list[str]]:
        longest: dict[str, list[str]] = {}
        for name, kinds in self._kinds.items():
            function = _COUNT.sub("", name)
            if len(kinds) > len(longest.get(function, ())):
                longest[function] = kinds
        names = {*self._kinds}
        for name in self._kinds:
            caller, _, function = name.rpartition("/")
            if "#" not in function:
                alike = _COUNT.sub("", caller)
                names |= {f"{other}/{function}" for other in self._kinds if _COUNT.sub("", other) == alike}
        return {name: longest.get(_COUNT.sub("", name), [UNIFORM]) for name in names}

    def _label(self, name: str, position: int) -> tuple[str, int]:
        """Return what the draws of a block have in common: the repeated call, or the number of the next vehicle."""
        parts = name.split("/")
        is_of_vehicle = hasattr(IDMVehicle, _COUNT.sub("", parts[-1]))  # as `randomize_behavior`, which envs have, too
        for end in range(1, len(parts) if is_of_vehicle else len(parts) + 1):
            call = "/".join(parts[:end])
            function = _COUNT.sub("", parts[end - 1])
            if hasattr(self._env, function) and self._is_repeated(call):
                return call, 0
        return "", self._next_vehicle.get((name, position), 0)

    def _is_repeated(self, call: str) -> bool:
        """Return whether a call is one of several of the same function from the same caller."""
        first = re.sub(r"#\d+$", "", call)
        second = f"{first}#1"
        return any(name == second or name.startswith(f"{second}/") for name in self._kinds)
