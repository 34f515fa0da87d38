"""An environment's map and rules as records and arrays, for the kernels."""

import math
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from highway_env.envs.common.action import ContinuousAction, DiscreteMetaAction
from highway_env.vehicle.kinematics import Vehicle

from behavexplor.data.array_types import Bools, Floats, Ints
from behavexplor.data.conventions import ARRIVAL_DISTANCE, PASSED_DISTANCE, STANDING_SPEED, STANDSTILL_TIME, TERMINAL
from behavexplor.data.npc_motion import Routes, route_arrays
from behavexplor.data.roadmap import RoadMap
from behavexplor.data.trace import ENDS
from behavexplor.envs.engine.lane_network import Network, make_network, road_numbers
from behavexplor.envs.engine.state import ROUTE_STEP, Records, record_type
from behavexplor.envs.road_objects import LANE_CLASSES, road_network

ScriptedRules: TypeAlias = np.record  # a record of `RULES`

RULES: Final = record_type(
    min_speed=np.float64,  # least speed of the ego [m/s]
    max_speed=np.float64,  # greatest speed of the ego [m/s]
    frequency=np.float64,  # simulation frequency [Hz]
    dt=np.float64,  # duration of a simulation step [s]
    substeps=np.int64,  # simulation steps per decision
    max_frames=np.float64,  # step at which an episode times out
    arrival_distance=np.float64,  # greatest distance from the destination that counts as arrival [m]
    passed_distance=np.float64,  # distance beyond the destination at which it counts as passed [m]
    standstill_speed=np.float64,  # below which the ego counts as standing [m/s]
    standstill_frames=np.float64,  # number of standing steps at which an episode ends by a standstill
    destination_x=np.float64,  # position of the destination [m]
    destination_y=np.float64,
    destination_cos=np.float64,  # of the lane's heading at the destination
    destination_sin=np.float64,
    is_meta=np.bool_,  # whether the ego takes meta-actions
)

PIECE: Final = record_type(  # a lane of the ego's route
    x=np.float64,  # start [m]
    y=np.float64,
    heading=np.float64,  # at the start [rad]
    cos=np.float64,
    sin=np.float64,
    curvature=np.float64,  # [1/m]
    length=np.float64,  # [m]
    begin=np.float64,  # station on the route at which it begins [m]
)


class ScriptedWorld(NamedTuple):
    """An environment's map and rules. Row 0 of `routes` and `route_lengths` is the ego's route."""

    network: Network  # the road network
    rules: Records  # how episodes run and end, shape (1,) of `RULES`
    npc_routes: Routes  # the routes of NPCs
    routes: Records  # roads and lanes of all routes, shape (1 + routes, steps) of `ROUTE_STEP`
    route_lengths: Ints  # number of steps of each, shape (1 + routes,)
    ego_route: Records  # lanes of the ego's route, shape (steps,) of `PIECE`
    illegal_lines: Floats  # end points of each illegal line, shape (lines, 4) [m]
    start: Floats  # x [m], y [m] and heading [rad] of the ego's start, shape (3,)
    target_speeds: Floats  # target speeds of meta-actions, shape (speeds,) [m/s]
    # whether each end of `behavexplor.data.trace.ENDS` terminates an episode; others truncate it
    terminal: Bools


def make_world(env: Any) -> ScriptedWorld:
    """Return the map and rules of a `behavexplor.envs.driving.DrivingEnv` that has been reset."""
    roadmap, action = env.logical.roadmap, env.action_type
    is_meta = isinstance(action, DiscreteMetaAction)
    routes = _route_steps(roadmap)
    return ScriptedWorld(
        network=make_network(road_network(roadmap), same_geometry=LANE_CLASSES),
        rules=_make_rules(env),
        npc_routes=route_arrays(roadmap),
        routes=routes,
        route_lengths=np.array([len(route.lanes) for route in (roadmap.ego_route, *roadmap.npc_routes)]),
        ego_route=_ego_route(roadmap),
        illegal_lines=np.array(roadmap.illegal_lines, dtype=np.float64).reshape(-1, 4),
        start=np.array(roadmap.start_pose, dtype=np.float64),
        target_speeds=np.array(action.target_speeds, dtype=np.float64) if is_meta else np.zeros(2),
        terminal=np.array([end in TERMINAL for end in ENDS]),
    )


def _make_rules(env: Any) -> Records:
    """Return the rules of a `behavexplor.envs.driving.DrivingEnv`."""
    roadmap, action = env.logical.roadmap, env.action_type
    speeds = action.speed_range if isinstance(action, ContinuousAction) and action.speed_range else None
    table = np.zeros(1, RULES)
    rules: Any = table[0]  # a view: setting its fields fills the table
    frequency = env.config["simulation_frequency"]
    rules.min_speed, rules.max_speed = speeds or (Vehicle.MIN_SPEED, Vehicle.MAX_SPEED)
    rules.frequency = frequency
    rules.dt = 1 / frequency
    rules.substeps = int(frequency // env.config["policy_frequency"])
    rules.max_frames = env.config["duration"] * frequency
    rules.arrival_distance = ARRIVAL_DISTANCE
    rules.passed_distance = PASSED_DISTANCE
    rules.standstill_speed = STANDING_SPEED
    rules.standstill_frames = STANDSTILL_TIME * frequency
    rules.destination_x, rules.destination_y = roadmap.destination_point
    heading = roadmap.ego_route.pose(roadmap.destination)[2]
    rules.destination_cos, rules.destination_sin = np.cos(heading), np.sin(heading)
    rules.is_meta = isinstance(action, DiscreteMetaAction)
    return table


def _route_steps(roadmap: RoadMap) -> Records:
    network, routes = road_network(roadmap), (roadmap.ego_route, *roadmap.npc_routes)
    roads = road_numbers(network)
    steps = np.zeros((len(routes), max(len(route.lanes) for route in routes)), ROUTE_STEP)
    for row, route in zip(steps, routes, strict=True):
        for step, (origin, target, lane) in enumerate(network.indexes(route)):
            row[step] = roads[origin, target], lane
    return steps


def _ego_route(roadmap: RoadMap) -> Records:
    route = roadmap.ego_route
    rows = [
        (lane.x, lane.y, lane.heading, math.cos(lane.heading), math.sin(lane.heading), lane.curvature, lane.length, s)
        for lane, s in zip(route.lanes, route.bounds[:-1], strict=True)
    ]
    return np.array(rows, dtype=PIECE)
