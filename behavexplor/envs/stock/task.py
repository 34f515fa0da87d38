"""What distinguishes one of highway-env's environments from another: its starts, rewards and ends, as numbers."""

from collections.abc import Mapping
from itertools import pairwise
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np
from highway_env.envs import (
    ExitEnv,
    HighwayEnv,
    HighwayEnvFast,
    IntersectionEnv,
    MergeEnv,
    RoundaboutEnv,
    TwoWayEnv,
    UTurnEnv,
)
from highway_env.envs.common.abstract import AbstractEnv
from numpy.typing import NDArray

from behavexplor.envs.engine.lane_network import lane_indexes, road_numbers
from behavexplor.envs.engine.state import SAME_NUMBER, VEHICLE, Records, record_type
from behavexplor.errors import InputError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

HIGHWAY, MERGE, ROUNDABOUT, U_TURN, TWO_WAY, EXIT, INTERSECTION = range(7)

KINDS = MappingProxyType(  # a subclass comes before its parent
    {
        ExitEnv: EXIT,
        HighwayEnvFast: HIGHWAY,
        HighwayEnv: HIGHWAY,
        IntersectionEnv: INTERSECTION,
        MergeEnv: MERGE,
        RoundaboutEnv: ROUNDABOUT,
        TwoWayEnv: TWO_WAY,
        UTurnEnv: U_TURN,
    }
)

# The terms of each environment's reward, in highway-env's order, with the type that they have in `info["rewards"]`.
# Gymnasium collects values of numpy's own `bool_` in arrays of objects.
TERMS: Mapping[int, Mapping[str, type]] = MappingProxyType(
    {
        HIGHWAY: {
            "collision_reward": float,
            "right_lane_reward": float,
            "high_speed_reward": float,
            "on_road_reward": float,
        },
        MERGE: {
            "collision_reward": bool,
            "right_lane_reward": float,
            "high_speed_reward": float,
            "lane_change_reward": bool,
            "merging_speed_reward": float,
        },
        ROUNDABOUT: {
            "collision_reward": bool,
            "high_speed_reward": float,
            "lane_change_reward": bool,
            "on_road_reward": np.bool_,
        },
        U_TURN: {
            "collision_reward": bool,
            "left_lane_reward": float,
            "high_speed_reward": float,
            "on_road_reward": np.bool_,
        },
        TWO_WAY: {"high_speed_reward": float, "left_lane_reward": float},
        EXIT: {
            "collision_reward": bool,
            "goal_reward": bool,
            "high_speed_reward": float,
            "right_lane_reward": int,
        },
        INTERSECTION: {
            "collision_reward": float,
            "high_speed_reward": float,
            "arrived_reward": float,
            "on_road_reward": float,
        },
    }
)
MOST_TERMS: Final = max(len(terms) for terms in TERMS.values())

_DESTINATIONS = MappingProxyType(  # of the vehicles whose routes are planned, in the order in which they are drawn
    {
        ROUNDABOUT: ("exr", "sxr", "nxr"),
        U_TURN: ("d",),
        EXIT: ("3",),
        INTERSECTION: ("o0", "o1", "o2", "o3"),
    }
)
_EGO_DESTINATIONS = MappingProxyType({ROUNDABOUT: "nxs", U_TURN: "d"})
_START_LANES = MappingProxyType(  # lanes on which vehicles start, by the names that `Starts` and the resets use
    {
        HIGHWAY: (("0", "1", 0),),
        MERGE: (("a", "b", 0), ("a", "b", 1), ("j", "k", 0)),
        ROUNDABOUT: (("ser", "ses", 0), ("we", "sx", 0), ("we", "sx", 1), ("eer", "ees", 0)),
        U_TURN: (("a", "b", 0), ("a", "b", 1), ("b", "c", 0), ("b", "c", 1), ("c", "d", 0), ("c", "d", 1)),
        TWO_WAY: (("a", "b", 1), ("b", "a", 0)),
        EXIT: (("0", "1", 0),),
        INTERSECTION: (("o0", "ir0", 0), ("o1", "ir1", 0), ("o2", "ir2", 0), ("o3", "ir3", 0)),
    }
)

_N_PLACED = MappingProxyType({MERGE: 5, ROUNDABOUT: 5, U_TURN: 7, TWO_WAY: 6})  # vehicles, with the ego; see `resets`

DRAWN: Final = -1  # a lane or destination that is drawn at each reset

TASK: Final = record_type(
    kind=np.int64,
    low_speed=np.float64,  # `reward_speed_range` [m/s]
    high_speed=np.float64,
    is_normalized=np.bool_,
    worst=np.float64,  # rewards that are mapped to 0 and 1
    best=np.float64,
    arrived_reward=np.float64,
    duration=np.float64,  # [s]; infinite: the environment does not truncate
    most_decisions=np.float64,  # after which an episode is truncated; infinite: no limit
    ends_off_road=np.bool_,
    n_at_start=np.int64,  # greatest number of vehicles with which an episode begins
    n_others=np.int64,  # vehicles besides the ego
    n_warm_up=np.int64,  # frames before the ego enters the intersection
    ego_lane=np.int64,  # number of the ego's lane on the highway, or DRAWN
    ego_spacing=np.float64,
    spacing=np.float64,  # of the other vehicles
    lane_factor=np.float64,  # of the spacing, for the number of lanes
    low_start_speed=np.float64,  # of the other vehicles on the highway [m/s]
    high_start_speed=np.float64,
    ego_destination=np.int64,  # row of `Starts.plans`, or DRAWN
    destination=np.int64,  # of the incoming vehicle of the roundabout, or DRAWN
    spawn_probability=np.float64,
)


class Starts(NamedTuple):
    """Where vehicles start, and their routes.

    Attributes:
        lanes: the lanes on which vehicles start, shape (starts,).
        plans: roads of the route from a road to a destination, padded with -1, shape (destinations, roads, steps). The
            first one is the road itself.
        shares: cumulated probabilities of the lanes on which vehicles start at the exit, shape (lanes,).
        gaps: offsets along the lanes of the vehicles that are at the intersection from the start [m], shape (n,).
        obstacles: the obstacles, shape (obstacles,) of `VEHICLE`.
    """

    lanes: Ints
    plans: Ints
    shares: Floats
    gaps: Floats
    obstacles: Records


class Task(NamedTuple):
    """An environment's starts, rewards and ends.

    Attributes:
        rules: the numbers, shape (1,) of `TASK`.
        weights: the weights of the terms of the reward, shape (terms,).
        starts: where vehicles start, and their routes.
    """

    rules: Records
    weights: Floats
    starts: Starts


def make_task(env: AbstractEnv, kind: int, starts: Starts, most_decisions: int | None) -> Task:
    """Return the starts, rewards and ends of an environment that has been reset.

    Args:
        env: an environment of a kind that is known.
        kind: HIGHWAY to INTERSECTION.
        starts: where its vehicles start.
        most_decisions: number of decisions after which an episode is truncated, if there is one.
    """
    rules = np.zeros(1, TASK)
    row = rules.view(np.recarray)[0]
    row.kind, row.most_decisions = kind, most_decisions or np.inf
    _put_rewards(row, env.config, kind)
    _put_starts(row, env.config, kind)
    row.n_at_start = _N_PLACED.get(kind, 1 + row.n_others)
    weights = [env.config.get(name, 0) for name in TERMS[kind]]
    return Task(rules, np.array(weights, dtype=np.float64), starts)


def _put_rewards(row: Any, config: Mapping[str, Any], kind: int) -> None:
    row.low_speed, row.high_speed = config.get("reward_speed_range", (0.0, 1.0))
    row.is_normalized = is_normalized(config, kind)
    if row.is_normalized:
        row.worst, row.best = reward_range(config, kind)
    row.arrived_reward = config.get("arrived_reward", 0)
    truncates = kind not in (MERGE, TWO_WAY)
    row.duration = config["duration"] if truncates else np.inf
    row.ends_off_road = kind in (HIGHWAY, INTERSECTION) and bool(config["offroad_terminal"])


def is_normalized(config: Mapping[str, Any], kind: int) -> bool:
    """Return whether rewards are mapped to [0, 1]."""
    return kind == MERGE or (kind != TWO_WAY and bool(config["normalize_reward"]))


def reward_range(config: Mapping[str, Any], kind: int) -> tuple[float, float]:
    """Return the rewards that a normalized reward maps to 0 and 1."""
    worst: float = config["collision_reward"]
    if kind == MERGE:
        worst += config["merging_speed_reward"]
    names = {
        HIGHWAY: ("high_speed_reward", "right_lane_reward"),
        MERGE: ("high_speed_reward", "right_lane_reward"),
        ROUNDABOUT: ("high_speed_reward",),
        U_TURN: ("high_speed_reward", "left_lane_reward"),
        EXIT: ("goal_reward",),
        INTERSECTION: ("arrived_reward",),
    }[kind]
    return worst, sum(config[name] for name in names)


def _put_starts(row: Any, config: Mapping[str, Any], kind: int) -> None:
    row.ego_lane = row.ego_destination = row.destination = DRAWN
    if kind in (HIGHWAY, EXIT):
        lanes = config["lanes_count"]
        row.n_others = config["vehicles_count"]
        row.ego_spacing, row.spacing = config["ego_spacing"], 1 / config["vehicles_density"]
        row.lane_factor = np.exp(-5 / 40 * lanes)
        row.low_start_speed, row.high_start_speed = 0.7 * 30, 0.8 * 30  # of the speed limit of `_create_road`
        row.ego_lane = DRAWN if config.get("initial_lane_id") is None else config["initial_lane_id"]
    if kind == ROUNDABOUT and config["incoming_vehicle_destination"] is not None:
        row.destination = config["incoming_vehicle_destination"]
    if kind == INTERSECTION:
        row.n_others = config["initial_vehicle_count"]
        row.n_warm_up = 3 * config["simulation_frequency"]
        row.spawn_probability = config["spawn_probability"]
        if config["destination"]:
            row.ego_destination = _DESTINATIONS[INTERSECTION].index(config["destination"])
    elif kind in _EGO_DESTINATIONS:
        row.ego_destination = len(_DESTINATIONS[kind]) - 1 + (kind == ROUNDABOUT)


def no_starts() -> Starts:
    """Return the starts of an environment that makes its own."""
    return Starts(np.zeros(0, np.int64), np.zeros((1, 1, 1), np.int64), np.ones(1), np.zeros(0), np.zeros(0, VEHICLE))


def make_starts(env: AbstractEnv, kind: int, obstacles: Records) -> Starts:
    """Return where the vehicles of an environment start, and their routes.

    Args:
        env: an environment that has been reset and makes its road and vehicles as highway-env does.
        kind: its kind.
        obstacles: its obstacles, shape (obstacles,) of `VEHICLE`.

    Raises:
        InputError: if its road has no lanes where vehicles would start.
    """
    config, indexes = env.config, lane_indexes(env.road.network)
    starts = _START_LANES[kind]
    if kind == HIGHWAY:
        starts = tuple(index for index in indexes if index[:2] == ("0", "1"))
    for start in starts:
        if start not in indexes:
            raise InputError(f"The road of {type(env).__name__} has no lane {start}, where vehicles would appear")
    destinations = _DESTINATIONS.get(kind, ())
    if kind == ROUNDABOUT:
        destinations = (*destinations, _EGO_DESTINATIONS[kind])
    shares = np.arange(config["lanes_count"]) if kind == EXIT else np.ones(1)
    cumulated = (shares / shares.sum()).cumsum()
    count = config.get("initial_vehicle_count", 0)
    return Starts(
        lanes=np.array([indexes.index(start) for start in starts], dtype=np.int64),
        plans=_plans(env, destinations),
        shares=cumulated / cumulated[-1],
        gaps=np.linspace(0, 80, count)[: max(count - 1, 0)].copy(),
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
