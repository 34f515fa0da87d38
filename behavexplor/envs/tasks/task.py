"""What distinguishes one of highway-env's environments from another: its starts, rewards and ends, as numbers."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from types import MappingProxyType
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.road.road import LaneIndex

from behavexplor.data.array_types import Floats, Ints
from behavexplor.envs.engine.lane_network import lane_indexes, road_numbers
from behavexplor.envs.engine.state import SAME_NUMBER, VEHICLE, Records, record_type
from behavexplor.envs.values import Kind
from behavexplor.errors import InputError

Config: TypeAlias = Mapping[str, Any]

DRAWN: Final = -1  # a lane or destination that is drawn at each reset
NO_TERM: Final = -1
# Kinds of numbers. A sum is of the greatest kind among its items, which decides how highway-env rounds it.
INTEGER: Final = 0  # Python's `int`
FLOAT: Final = 1  # Python's `float`
NUMPY: Final = 2  # a number of numpy

TERM: Final = record_type(
    code=np.int64,  # what it is; see `behavexplor.envs.tasks.reward_terms`
    weight=np.float64,
    number_kind=np.int64,  # what kind of number the weighted term is in highway-env; see `kind_of_number`
)
TASK: Final = record_type(
    kind=np.int64,  # number of the kind of task: its place in `behavexplor.envs.tasks.highway_tasks.KINDS`
    low_speed=np.float64,  # `reward_speed_range` [m/s]
    high_speed=np.float64,
    is_normalized=np.bool_,  # rewards are mapped to [0, 1]
    is_clipped=np.bool_,  # and clipped
    worst=np.float64,  # rewards that are mapped to 0 and 1
    best=np.float64,
    first_gate=np.int64,  # term by which the reward is multiplied before it is mapped, or NO_TERM
    gate=np.int64,  # term by which it is multiplied in the end, or NO_TERM
    arrival=np.int64,  # term at which the reward is `arrived_reward`, or NO_TERM
    arrived_reward=np.float64,
    duration=np.float64,  # [s]; infinite: the environment does not truncate
    most_decisions=np.float64,  # after which an episode is truncated; infinite: no limit
    end_x=np.float64,  # the episode ends beyond it [m]
    arrival_station=np.float64,  # station on a goal lane at which the ego has arrived [m]
    ends_off_road=np.bool_,
    n_at_start=np.int64,  # greatest number of vehicles with which an episode begins
    n_others=np.int64,  # vehicles besides the ego
    n_new=np.int64,  # greatest number of vehicles that appear after a decision
    n_warm_up=np.int64,  # frames before the ego appears
    ego_lane=np.int64,  # number of the ego's lane, or DRAWN
    ego_spacing=np.float64,
    spacing=np.float64,  # of the other vehicles
    lane_factor=np.float64,  # of the spacing, for the number of lanes
    low_start_speed=np.float64,  # of the other vehicles [m/s]
    high_start_speed=np.float64,
    ego_destination=np.int64,  # row of `Starts.plans`, or DRAWN
    destination=np.int64,  # of the roundabout's incoming vehicle, or DRAWN
    spawn_probability=np.float64,
)


class Starts(NamedTuple):
    """Where vehicles start, and their routes."""

    lanes: Ints  # the lanes on which vehicles start, shape (starts,)
    # roads of the route from a road to a destination, padded with -1, shape (destinations, roads, steps). The first one
    # is the road itself.
    plans: Ints
    # shape (n,): cumulated probabilities of lanes (exit), offsets along the lanes [m] (intersection), or the end of the
    # ramp [m] (generic merge)
    numbers: Floats
    obstacles: Records  # the obstacles, shape (obstacles,) of `VEHICLE`


class Task(NamedTuple):
    """An environment's starts, rewards and ends."""

    rules: Records  # the numbers, shape (1,) of `TASK`
    terms: Records  # the terms of the reward, shape (terms,) of `TERM`
    starts: Starts  # where vehicles start, and their routes


def check_discrete(config: Config) -> None:
    """Check that the actions are discrete, for environments whose reward in highway-env needs it.

    Raises:
        InputError: if they are not.
    """
    if config["action"]["type"] == "ContinuousAction":
        raise InputError("action: highway-env's reward of this environment itself needs discrete actions")


@dataclass(frozen=True)
class TaskKind:
    """A kind of task: one of highway-env's environments with its variants."""

    env_classes: tuple[type[AbstractEnv], ...]  # the environments; a subclass comes before its parent
    # code of each term of the reward, in highway-env's order, with the type that it has in `info["rewards"]`. Gymnasium
    # collects values of numpy's own `bool_` in arrays of objects.
    terms: Mapping[str, tuple[int, type]]
    start_lanes: Callable[[Config], tuple[LaneIndex, ...]]  # lanes on which vehicles start, for a config
    worst: tuple[str, ...] = ("collision_reward",)  # the rewards whose sum is mapped to 0
    best: tuple[str, ...] = ()  # the rewards whose sum is mapped to 1
    is_normalized: bool | None = None  # whether they are mapped; None: if the config says so
    is_clipped: bool = False  # whether a reward that is mapped is clipped to [0, 1]
    first_gate: str | None = None  # name of a term by which the reward is multiplied before it is mapped
    gate: str | None = None  # name of a term by which it is multiplied in the end
    # name of a term at which the reward is the config's value of that name, and the episode ends
    arrival: str | None = None
    arrival_station: float = np.inf  # station on a goal lane at which the ego has arrived [m]
    has_newcomers: bool = False  # whether vehicles appear while an episode runs
    has_exit: bool = False  # whether there are the lanes of an `ExitObservation`
    success: str | None = None  # name of a term that says whether a decision was a success, for `info["is_success"]`
    has_agents: bool = False  # whether infos have the rewards and ends of each agent
    truncates: bool = True  # whether an episode is truncated after the config's `duration`
    may_end_off_road: bool = False  # whether the config can end episodes off the road
    end_x: Callable[[Config], float] = lambda _: np.inf  # where the episode ends, for a config [m]
    # whether a lane is one of the goals, for a config: the merging lane (merge), a lane to be reached (exit), or one
    # that leads out of the intersection
    is_goal: Callable[[LaneIndex, Config], bool] = lambda _, __: False
    destinations: tuple[str, ...] = ()  # ends of the routes that are planned, in the order in which they are drawn
    start_numbers: Callable[[Config], Floats] = lambda _: np.zeros(0)  # see `Starts.numbers`
    n_placed: int | None = None  # vehicles with which an episode begins, with the ego; None: 1 + `n_others`
    # puts a config's numbers for the start into the record `TASK`
    put_starts: Callable[[Any, Config], None] = lambda _, __: None
    unaware: tuple[type[AbstractEnv], ...] = ()  # environments whose traffic does not look for collisions of its own
    # keys of the config that only this kind reads, beside its rewards
    keys: Mapping[str, Kind] = field(default_factory=lambda: MappingProxyType({}))
    unread: frozenset[str] = frozenset()  # keys of the default config that highway-env itself does not read
    # checks what only this kind demands of a config, by raising an `InputError`
    check: Callable[[Config], None] = lambda _: None

    @cached_property
    def named_terms(self) -> tuple[tuple[str, str, type], ...]:
        """Name, name of the mask and type of each term in infos, where numpy's numbers count as floats."""
        types = {name: float if issubclass(wanted, float) else wanted for name, (_, wanted) in self.terms.items()}
        return tuple((name, f"_{name}", wanted) for name, wanted in types.items())

    def normalizes(self, config: Config) -> bool:
        """Return whether rewards are mapped to [0, 1]."""
        return bool(config["normalize_reward"]) if self.is_normalized is None else self.is_normalized

    def reward_range(self, config: Config) -> tuple[float, float]:
        """Return the rewards that are mapped to 0 and 1."""
        return sum(config[name] for name in self.worst), sum(config[name] for name in self.best)

    def position(self, name: str | None) -> int:
        """Return the position of a term of the reward, or NO_TERM."""
        return NO_TERM if name is None else list(self.terms).index(name)


def make_task(env: AbstractEnv, kind_number: int, kind: TaskKind, starts: Starts, most_decisions: int | None) -> Task:
    """Return the starts, rewards and ends of an environment that has been reset.

    `kind_number` is the place of `kind` in `behavexplor.envs.tasks.highway_tasks.KINDS`. After `most_decisions`, an
    episode is truncated; None for no limit.
    """
    config = env.config
    rules = np.zeros(1, TASK)
    row = rules.view(np.recarray)[0]
    row.kind = kind_number
    row.ego_lane = row.ego_destination = row.destination = DRAWN
    _put_rewards(row, config, kind)
    _put_ends(row, config, kind)
    row.most_decisions = most_decisions or np.inf
    kind.put_starts(row, config)
    row.n_new = kind.has_newcomers
    row.n_at_start = kind.n_placed or 1 + row.n_others
    weights = [config.get(name, 0) for name in kind.terms]
    terms = [
        (code, weight, kind_of_number(weight * wanted(1)))
        for weight, (code, wanted) in zip(weights, kind.terms.values(), strict=True)
    ]
    return Task(rules, np.array(terms, dtype=TERM), starts)


def kind_of_number(number: Any) -> int:
    """Return INTEGER, FLOAT or NUMPY."""
    if isinstance(number, np.generic):
        return NUMPY
    return FLOAT if isinstance(number, float) else INTEGER


def _put_rewards(row: Any, config: Config, kind: TaskKind) -> None:
    row.low_speed, row.high_speed = config.get("reward_speed_range", (0.0, 1.0))
    row.is_normalized, row.is_clipped = kind.normalizes(config), kind.is_clipped
    if row.is_normalized:
        row.worst, row.best = kind.reward_range(config)
    row.first_gate, row.gate = kind.position(kind.first_gate), kind.position(kind.gate)
    row.arrival = kind.position(kind.arrival)
    row.arrived_reward = 0 if kind.arrival is None else config[kind.arrival]


def _put_ends(row: Any, config: Config, kind: TaskKind) -> None:
    row.duration = config["duration"] if kind.truncates else np.inf
    row.end_x, row.arrival_station = kind.end_x(config), kind.arrival_station
    row.ends_off_road = kind.may_end_off_road and bool(config["offroad_terminal"])


def no_starts() -> Starts:
    """Return the starts of an environment that makes its own."""
    return Starts(np.zeros(0, np.int64), np.zeros((1, 1, 1), np.int64), np.zeros(0), np.zeros(0, VEHICLE))


def make_starts(env: AbstractEnv, kind: TaskKind, obstacles: Records) -> Starts:
    """Return where the vehicles of an environment start, and their routes.

    The environment has been reset, and makes its road and vehicles as highway-env does. `obstacles` are its obstacles,
    shape (obstacles,) of `VEHICLE`.

    Raises:
        InputError: if its road has no lanes where vehicles would start.
    """
    indexes = lane_indexes(env.road.network)
    starts = kind.start_lanes(env.config)
    for start in starts:
        if start not in indexes:
            raise InputError(f"The road of {type(env).__name__} has no lane {start}, where vehicles would appear")
    return Starts(
        lanes=np.array([indexes.index(start) for start in starts], dtype=np.int64),
        plans=_plans(env, kind.destinations),
        numbers=kind.start_numbers(env.config),
        obstacles=obstacles,
    )


def _plans(env: AbstractEnv, destinations: tuple[str, ...]) -> Ints:
    """Return `Starts.plans`: `ControlledVehicle.plan_route_to` from every road to every destination."""
    network = env.road.network
    numbers = road_numbers(network)
    plans: list[list[list[int]]] = []
    for destination in destinations:
        plans.append([])
        for origin, target in numbers:
            try:
                path = network.shortest_path(target, destination)
            except KeyError:
                path = []
            nodes = [origin, *(path or [target])]
            plans[-1].append([numbers[ends] for ends in pairwise(nodes)])
    steps = max((len(plan) for to in plans for plan in to), default=1)
    table = np.full((max(len(plans), 1), len(numbers), steps), SAME_NUMBER, dtype=np.int64)
    for row, to in zip(table, plans, strict=False):
        for cells, plan in zip(row, to, strict=True):
            cells[: len(plan)] = plan
    return table
