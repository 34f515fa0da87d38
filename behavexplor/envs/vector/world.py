"""An environment's map and rules as plain arrays, for the kernels."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from highway_env.envs.common.action import ContinuousAction, DiscreteMetaAction
from highway_env.road.lane import AbstractLane
from highway_env.road.road import LaneIndex
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from behavexplor.data.conventions import ARRIVAL_DISTANCE, STANDING_SPEED, STANDSTILL_TIME
from behavexplor.data.npc_motion import Routes, route_arrays
from behavexplor.data.roadmap import RoadMap
from behavexplor.data.trace import ENDS
from behavexplor.envs import driving
from behavexplor.envs.network import MapNetwork, road_network
from behavexplor.envs.vector.lanes import LaneNetwork, lane_row

Floats = NDArray[np.float64]

EGO_X, EGO_Y, EGO_HEADING, EGO_COS, EGO_SIN, EGO_CURVATURE, EGO_LENGTH, EGO_BEGIN = range(8)  # `ego_lanes` columns


class Rules(NamedTuple):
    """The numbers that determine how episodes run and end.

    Attributes:
        min_speed: least speed of the ego [m/s].
        max_speed: greatest speed of the ego [m/s].
        frequency: simulation frequency [Hz].
        substeps: simulation steps per decision.
        max_frames: number of steps at which an episode times out.
        arrival_distance: greatest distance from the destination that counts as arrival [m].
        passed_distance: distance beyond the destination at which it counts as passed [m].
        standstill_speed: speed below which the ego counts as standing [m/s].
        standstill_frames: number of standing steps at which an episode ends by a standstill.
        destination_x: position of the destination [m].
        destination_y: position of the destination [m].
        destination_cos: cosine of the lane's heading at the destination.
        destination_sin: sine of the lane's heading at the destination.
    """

    min_speed: float
    max_speed: float
    frequency: float
    substeps: int
    max_frames: float
    arrival_distance: float
    passed_distance: float
    standstill_speed: float
    standstill_frames: float
    destination_x: float
    destination_y: float
    destination_cos: float
    destination_sin: float


class World(NamedTuple):
    """An environment's map and rules.

    Attributes:
        network: the lanes, and the ego's route.
        rules: the numbers that determine how episodes run and end.
        npc_routes: the routes of NPCs.
        npc_ends: end point of each NPC route, shape (routes, 2) [m].
        ego_end: end point of the ego's route, shape (2,) [m].
        ego_lanes: lanes of the ego's route, with the columns `EGO_X` to `EGO_BEGIN`, shape (steps, 8).
        illegal_lines: end points of each illegal line, shape (lines, 4) [m].
        start: x [m], y [m] and heading [rad] of the ego's start, shape (3,).
        is_meta: whether the ego takes meta-actions.
        target_speeds: target speeds of meta-actions, shape (speeds,) [m/s].
        terminal: whether each end of `behavexplor.data.trace.ENDS` terminates an episode; others truncate it.
    """

    network: LaneNetwork
    rules: Rules
    npc_routes: Routes
    npc_ends: Floats
    ego_end: Floats
    ego_lanes: Floats
    illegal_lines: Floats
    start: Floats
    is_meta: bool
    target_speeds: Floats
    terminal: NDArray[np.bool_]


def make_world(env: driving.DrivingEnv) -> World:
    """Return the map and rules of an environment that has been reset."""
    roadmap, action = env.logical.roadmap, env.action_type
    network = road_network(roadmap)
    ends = [_end(network.get_lane(network.indexes(route)[-1])) for route in (roadmap.ego_route, *roadmap.npc_routes)]
    is_meta = isinstance(action, DiscreteMetaAction)
    return World(
        network=_make_network(network, network.indexes(roadmap.ego_route)),
        rules=_make_rules(env),
        npc_routes=route_arrays(roadmap),
        npc_ends=np.array(ends[1:]),
        ego_end=ends[0],
        ego_lanes=_ego_lanes(roadmap),
        illegal_lines=np.array(roadmap.illegal_lines, dtype=np.float64).reshape(-1, 4),
        start=np.array(roadmap.start_pose, dtype=np.float64),
        is_meta=is_meta,
        target_speeds=np.array(action.target_speeds, dtype=np.float64) if is_meta else np.zeros(2),
        terminal=np.array([end in driving.TERMINAL for end in ENDS]),
    )


def _make_rules(env: driving.DrivingEnv) -> Rules:
    roadmap, action = env.logical.roadmap, env.action_type
    speeds = action.speed_range if isinstance(action, ContinuousAction) and action.speed_range else None
    min_speed, max_speed = speeds or (Vehicle.MIN_SPEED, Vehicle.MAX_SPEED)
    frequency = env.config["simulation_frequency"]
    x, y = roadmap.destination_point
    heading = roadmap.ego_route.pose(roadmap.destination)[2]
    return Rules(
        min_speed=float(min_speed),
        max_speed=float(max_speed),
        frequency=float(frequency),
        substeps=int(frequency // env.config["policy_frequency"]),
        max_frames=float(env.config["duration"] * frequency),
        arrival_distance=ARRIVAL_DISTANCE,
        passed_distance=driving.PASSED_DISTANCE,
        standstill_speed=STANDING_SPEED,
        standstill_frames=float(STANDSTILL_TIME * frequency),
        destination_x=float(x),
        destination_y=float(y),
        destination_cos=float(np.cos(heading)),
        destination_sin=float(np.sin(heading)),
    )


def _make_network(network: MapNetwork, route: Sequence[LaneIndex]) -> LaneNetwork:
    groups = {(origin, target): lanes for origin, to in network.graph.items() for target, lanes in to.items()}
    road_of = {ends: road for road, ends in enumerate(groups)}
    nodes: dict[str, int] = {}
    roads: list[list[int]] = []
    lane_road: list[int] = []
    for (origin, target), lanes in groups.items():
        ends = [nodes.setdefault(node, len(nodes)) for node in (origin, target)]
        lane_road += [len(roads)] * len(lanes)
        roads.append([*ends, len(lane_road) - len(lanes), len(lanes)])
    return LaneNetwork(
        lanes=np.array([lane_row(lane) for lane in network.lanes_list()]),
        roads=np.array(roads),
        lane_road=np.array(lane_road),
        route=np.array([(road_of[index[:2]], index[2]) for index in route]),
    )


def _end(lane: AbstractLane) -> Floats:
    return np.array(lane.position(lane.length, 0), dtype=np.float64)


def _ego_lanes(roadmap: RoadMap) -> Floats:
    route = roadmap.ego_route
    rows = [
        (lane.x, lane.y, lane.heading, math.cos(lane.heading), math.sin(lane.heading), lane.curvature, lane.length, s)
        for lane, s in zip(route.lanes, route.bounds[:-1], strict=True)
    ]
    return np.array(rows, dtype=np.float64)
