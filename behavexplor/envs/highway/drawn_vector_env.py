"""The compiled form of highway-env's environments whose episodes are given by their random draws."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from gymnasium import RewardWrapper
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker, RecordEpisodeStatistics, TimeLimit
from highway_env.envs import ExitEnv, IntersectionEnv
from highway_env.road.road import RoadNetwork

from behavexplor.data.array_types import Array, Bools, Floats
from behavexplor.data.drawn_logical import NORMAL, UNIFORM, DrawnLogicalScenario
from behavexplor.data.drawn_scenario import DrawnScenario
from behavexplor.data.trace import ARRIVED, CRASHED, OFF_ROAD, Trace
from behavexplor.envs.engine.lane_network import lane_indexes, road_numbers
from behavexplor.envs.engine.state import NO_ROAD
from behavexplor.envs.highway.config_check import STARTS
from behavexplor.envs.highway.conversion import are_alike
from behavexplor.envs.highway.drawn_env import DrawnEnv
from behavexplor.envs.highway.episode_record import EpisodeRecord, Frame, leaving_matters, must_move_on
from behavexplor.envs.highway.generator import DrawnGenerator
from behavexplor.envs.highway.highway_vector_env import HighwayVectorEnv
from behavexplor.envs.source_gate import REWARDS, replaced_in
from behavexplor.errors import InputError

_HARMLESS: Final = (OrderEnforcing, PassiveEnvChecker, RecordEpisodeStatistics, TimeLimit)  # wrappers
_COMPARED: Final = 3  # starts of the engine that are compared with highway-env's
_SIZE: Final = (5.0, 2.0)  # length and width of highway-env's vehicles that appear in an episode [m]
SPAWN = "_spawn_vehicle"  # the method of `IntersectionEnv` that may place a vehicle
_SPAWN_KINDS = (UNIFORM, UNIFORM, UNIFORM, NORMAL, NORMAL)  # of its draws, before that of `DELTA`


class DrawPlace(NamedTuple):
    """Where a draw is found: its call, its position among the call's draws, and its kind."""

    name: str
    position: int
    kind: str


class DrawnVectorEnv(VectorEnv[Array, Array, Array]):
    """`num_envs` environments of highway-env in lock-step, whose episodes are given by their random draws.

    The compiled engine begins each episode with the draws of its scenario, and drives it. If the first episodes that
    highway-env itself begins are others, or draw in a varying order, highway-env begins all of them.
    `reset(options={"scenarios": [...], "reset_mask": ...})` begins episodes, and at the end of an episode
    `infos["trace"]` has its trace. Autoreset is disabled.

    The present episode of `env` is lost. `rewards` says whether rewards are needed; see `HighwayVectorEnv`.
    The attribute `engine` has the environments without their records; its episodes can go on from snapshots.

    Raises:
        InputError: if the compiled engine does not support the environment or its configuration.
    """

    def __init__(self, env: DrawnEnv, num_envs: int, *, rewards: bool = False) -> None:
        check_compiled(env, rewards=rewards)
        self._env = env
        self.engine = _make_engine(env, num_envs, rewards=rewards)
        self.num_envs = num_envs
        self.metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.DISABLED}
        self.single_observation_space = self.engine.single_observation_space
        self.single_action_space = self.engine.single_action_space
        self.observation_space = self.engine.observation_space
        self.action_space = self.engine.action_space
        self.logical: DrawnLogicalScenario = env.logical
        self._records: list[Any] = [None] * num_envs
        self._networks: list[RoadNetwork] = [env.inner.road.network] * num_envs
        self._ended = np.ones(num_envs, dtype=bool)
        self._watch = FailureWatch(env, num_envs)
        self._later = decision_order(env)
        self._order = self._start_order()
        self._networks = [env.inner.road.network] * num_envs  # that of the engine, now that it has copied an episode
        self._has_short_traces = False

    def _start_order(self) -> tuple[DrawPlace, ...] | None:
        """Return the order of the draws by which the engine begins episodes; None if only highway-env can."""
        rng = np.random.default_rng(0)
        scenarios = [self.logical.sample(rng) for _ in range(_COMPARED)]
        order = None if self.engine.places_own else start_order(self._env, scenarios)
        mask = np.arange(self.num_envs) == 0
        for scenario in scenarios:
            self._begin_by_highway_env(0, scenario)  # refuses what the engine cannot copy, such as another road
            if order is None:
                continue
            expected = self.engine.state(0)
            self.engine.reset(options={"reset_mask": mask, "draws": {0: forms_of(scenario, order)}})
            if not are_alike(expected, self.engine.state(0)):
                return None
        return order

    @property
    def short_traces(self) -> bool:
        """Whether episodes are counted without being recorded, which is many times faster. False by default.

        While it is True, `infos["trace"]` has a trace of a single frame for an episode without failure, and None for
        any other. Scenarios must be drawn from `logical`, since they are not checked.
        """
        return self._has_short_traces

    @short_traces.setter
    def short_traces(self, short: bool) -> None:
        self._has_short_traces = short
        self.engine.log_egos(alone=short)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begin episodes with the option `scenarios`, which has one for each sub-environment.

        The option `reset_mask`, shape (num_envs,), selects those to reset. `seed` has no effect: the scenarios decide.

        Raises:
            InputError: if a scenario is not one of this environment.
        """
        del seed
        options = options or {}
        mask = np.asarray(options.get("reset_mask", np.ones(self.num_envs, dtype=bool)))
        chosen = np.flatnonzero(mask).tolist()
        if not chosen:
            raise InputError("reset_mask: no sub-environment is selected")
        self._ended = self._ended & ~mask
        scenarios: dict[int, DrawnScenario] = {b: options["scenarios"][b] for b in chosen}
        if self._order is None:
            begun = [self._begin_by_highway_env(b, scenario) for b, scenario in scenarios.items()][-1]
        else:
            begun = self._begin_by_engine(mask, scenarios, (*self._order, *self._later))
        if self.short_traces:
            self._watch.begin(chosen, self.engine)
        return begun

    def _begin_by_engine(
        self, mask: Bools, scenarios: Mapping[int, DrawnScenario], order: Sequence[DrawPlace]
    ) -> tuple[Array, dict[str, Any]]:
        """Begin episodes in the engine with the draws of scenarios, in their order."""
        recorded = [] if self.short_traces else list(scenarios)
        for b in recorded:  # scenarios of episodes that are only counted are not checked
            self.logical.check(scenarios[b])
        draws = {b: forms_of(scenario, order) for b, scenario in scenarios.items()}
        begun = self.engine.reset(options={"reset_mask": mask, "draws": draws})
        for b in recorded:
            state = self.engine.state(b)
            self._records[b] = EpisodeRecord(self._env.inner, state.ego_route(self._networks[b]))
            self._records[b].sizes.update(state.sizes())
            self._log(b, 1)
        return begun

    def _begin_by_highway_env(self, b: int, scenario: DrawnScenario) -> tuple[Array, dict[str, Any]]:
        """Begin an episode of sub-environment b in highway-env, and copy it to the engine."""
        self._env.begin_blindly(scenario)
        self._records[b], self._networks[b] = self._env.record, self._env.inner.road.network
        chosen, later = np.arange(self.num_envs) == b, forms_of(scenario, self._later)
        with self._env.vehicle_classes.applied():
            return self.engine.reset(
                options={"reset_mask": chosen, "starts": {b: self._env.inner}, "draws": {b: later}}
            )

    def step(self, actions: Array) -> tuple[Array, Floats, Bools, Bools, dict[str, Any]]:
        """Take an action in every sub-environment. A sub-environment whose episode has ended rests."""
        rest = self._ended  # since an earlier decision
        recorded = [] if self.short_traces else np.flatnonzero(~rest).tolist()
        for b in recorded:
            self._records[b].decide(actions[b])
        observations, rewards, terminated, truncated, infos = self.engine.step(actions)
        self._ended = terminated | truncated
        ended = self._ended & ~rest
        traces = np.full(self.num_envs, None, dtype=object)
        if self.short_traces:
            traces[ended & self._watch.passing(self.engine, infos)] = self._watch.passed
        arrived = _arrivals(infos)
        for b in recorded:
            self._log(b, len(self.engine.frame_log.frames[b]))
            self._records[b].judge(None if arrived is None else bool(arrived[b]))
            if ended[b]:
                traces[b] = self._records[b].trace(self._networks[b], terminated=bool(terminated[b]))
        return observations, rewards, terminated, truncated, {**infos, "trace": traces, "_trace": ended}

    def _log(self, b: int, count: int) -> None:
        """Record the first `count` frames of the latest decision of sub-environment b."""
        log, record = self.engine.frame_log, self._records[b]
        rows = zip(log.frames[b, :count].tolist(), log.things[b, :count].copy(), strict=True)
        for (n_things, ego, is_on_road), things in rows:
            record.frames.append(Frame(things[:n_things], ego, is_on_road))
        for number in log.things[b, count - 1]["number"][:n_things].tolist():
            record.sizes.setdefault(number, _SIZE)


class FailureWatch:
    """Finds out which episodes in lock-step fail, without recording them; `episode_record` says what a failure is.

    The engine's log must have the egos alone.

    Attributes:
        passed: a trace of one frame that stands for every episode without failure.
    """

    def __init__(self, env: DrawnEnv, num_envs: int) -> None:
        network = env.inner.road.network
        numbers = road_numbers(network)
        self._roads = np.array([numbers[lane[:2]] for lane in lane_indexes(network)])  # the road of each lane
        self._has_borders, self._must_move_on = leaving_matters(env.inner), must_move_on(env.inner)
        self._strayed = np.zeros(num_envs, dtype=bool)  # whether the ego has left the road
        self._entry = np.zeros((num_envs, 3), dtype=np.int64)  # roads beyond which the ego has to get
        self._is_beyond = np.zeros(num_envs, dtype=bool)  # whether it has
        signals = {CRASHED: np.zeros(1)}
        if self._has_borders:
            signals[OFF_ROAD] = np.zeros(1)
        if self._must_move_on or isinstance(env.inner, ExitEnv | IntersectionEnv):
            signals[ARRIVED] = np.ones(1)
        first = env.logical.first_frame(env.played(), "timeout")
        self.passed: Trace = replace(first, signals=signals)

    def begin(self, chosen: Sequence[int], engine: HighwayVectorEnv) -> None:
        """Begin episodes, which the engine has begun and logged."""
        frames, things = engine.frame_log.frames[chosen, 0], engine.frame_log.things[chosen, 0]
        self._strayed[chosen] = ~frames["is_on_road"]
        self._is_beyond[chosen] = not self._must_move_on
        if self._must_move_on:
            ahead = engine.roads_ahead(chosen, 2)
            self._entry[chosen] = self._roads[things["lane"]]
            self._entry[chosen, :2] = np.where(ahead == NO_ROAD, self._entry[chosen, :2], ahead)

    def passing(self, engine: HighwayVectorEnv, infos: dict[str, Any]) -> Bools:
        """Return which episodes have not failed if they end after this decision, shape (num_envs,)."""
        frames, things = engine.frame_log
        self._strayed |= (~frames["is_on_road"]).any(axis=1)
        if self._must_move_on:
            roads = self._roads[things["lane"][:, :, 0]]
            first, second, third = (roads != road[:, None] for road in self._entry.T)
            self._is_beyond |= (first & second & third).any(axis=1)
        arrived = _arrivals(infos)
        failed: Bools = infos["crashed"] | ~(self._is_beyond if arrived is None else arrived)
        return ~(failed | self._strayed) if self._has_borders else ~failed


def _make_engine(env: DrawnEnv, num_envs: int, *, rewards: bool) -> HighwayVectorEnv:
    """Return the engine for an environment."""
    kind = type(env.inner)
    try:
        return HighwayVectorEnv(
            kind,
            num_envs,
            env.config,
            AutoresetMode.DISABLED,
            max_episode_steps=env.max_decisions,
            log_frames=True,
            rewards=rewards,
        )
    except InputError:
        raise
    except Exception as error:  # a user's class may have other arguments, or others than it is registered with
        reason = f"{type(error).__name__}: {error}"
        raise InputError(f"The compiled engine cannot make {kind.__name__} by its configuration: {reason}") from error


def check_compiled(env: DrawnEnv, *, rewards: bool) -> None:
    """Check that the compiled engine draws, observes and, if that is needed, rewards as the environment does.

    Raises:
        InputError: if it does not.
    """
    method = replaced_in(env.inner, STARTS if rewards else STARTS | REWARDS)
    if method is not None:
        raise InputError(f"The compiled engine does not know the method {method} of this environment object")
    harmless = _HARMLESS if rewards else (*_HARMLESS, RewardWrapper)
    for wrapper in env.wrappers:
        if not isinstance(wrapper, harmless):
            raise InputError(f"The compiled engine does not know the wrapper {type(wrapper).__name__}")
    for draw in env.logical.draws:
        call, _, function = draw.name.partition("/")
        is_spawn = isinstance(env.inner, IntersectionEnv) and function.startswith(SPAWN)
        if "observe" in draw.name:
            raise InputError("The compiled engine does not draw anything for observations, such as a shuffled order")
        if call.partition("#")[0] == "step" and not is_spawn:
            raise InputError(f"The compiled engine does not know the draws of {draw.name}")


def _arrivals(infos: dict[str, Any]) -> Bools | None:
    """Return whether each ego has arrived, see `has_arrived` of `episode_record`; None without a destination."""
    if "is_success" in infos:
        return np.asarray(infos["is_success"], dtype=bool)
    arrived = infos.get("rewards", {}).get("arrived_reward")  # in the engine, of an intersection alone
    return None if arrived is None else np.asarray(arrived, dtype=bool)


def start_order(env: DrawnEnv, scenarios: Iterable[DrawnScenario]) -> tuple[DrawPlace, ...] | None:
    """Return the order of the draws with which the episodes of scenarios begin; None if it is not the same in all.

    The present episode of `env` is lost.
    """
    orders = set()
    for scenario in scenarios:
        env.begin_blindly(scenario)
        orders.add(_with_whole_spawns(DrawPlace(*place) for place in env.generator.sequence))
    return orders.pop() if len(orders) == 1 else None


def decision_order(env: DrawnEnv) -> tuple[DrawPlace, ...]:
    """Return the order of the draws after each decision, by which vehicles appear at an intersection."""
    if not isinstance(env.inner, IntersectionEnv):
        return ()
    decisions = math.ceil(env.config["duration"] * env.config["policy_frequency"]) + 1
    calls = [f"step#{decision}/{SPAWN}" if decision else f"step/{SPAWN}" for decision in range(decisions)]
    return tuple(place for call in calls for place in _spawn(call))


def forms_of(scenario: DrawnScenario, order: Sequence[DrawPlace]) -> Floats:
    """Return the standard forms of a scenario's draws in their order, shape (n,)."""
    draws: dict[str, Any] = dict(scenario.draws)
    try:  # the usual case, which is much faster
        return np.array([draws[name][position] for name, position, _ in order])
    except (KeyError, IndexError):  # some draws are missing: a generator makes them from the scenario's seed
        pass
    made = DrawnGenerator(draws, scenario.seed, __file__)
    given = ((draws.get(place.name, ()), place) for place in order)
    return np.array(
        [known[place.position] if place.position < len(known) else made.form(*place) for known, place in given]
    )


def _with_whole_spawns(places: Iterable[DrawPlace]) -> tuple[DrawPlace, ...]:
    """Return an order in which each call that may place a vehicle at an intersection has all draws it might make."""
    order: list[DrawPlace] = []
    seen = set()
    for place in places:
        caller, found, rest = place.name.partition(f"/{SPAWN}")
        if not found:
            order.append(place)
            continue
        call = f"{caller}{found}{rest.partition('/')[0]}"
        order += [] if call in seen else _spawn(call)
        seen.add(call)
    return tuple(order)


def _spawn(call: str) -> list[DrawPlace]:
    own = [DrawPlace(call, position, kind) for position, kind in enumerate(_SPAWN_KINDS)]
    return [*own, DrawPlace(f"{call}/randomize_behavior", 0, UNIFORM)]
