"""An environment's road and rules as tables, for the kernels, and new vehicles on the road.

New vehicles are as the constructors of highway-env's classes make them; routes and drawn behaviors come afterwards.
"""

import math
from collections.abc import Callable
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from highway_env import utils
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.common.action import ContinuousAction, DiscreteMetaAction
from highway_env.road.regulation import RegulatedRoad
from highway_env.road.road import LaneIndex, Road, RoadNetwork
from highway_env.vehicle.behavior import LinearVehicle
from highway_env.vehicle.objects import Obstacle

from behavexplor.data.array_types import Floats, Ints
from behavexplor.envs.engine.lane_geometry import closest_lane, lane_heading, lane_point
from behavexplor.envs.engine.lane_keeping import nearest_speed
from behavexplor.envs.engine.lane_network import Network, make_network
from behavexplor.envs.engine.pcg64 import Words, normal, uniform
from behavexplor.envs.engine.state import (
    IDM,
    LINEAR,
    MDP,
    NO_LANE,
    NO_ROUTE,
    OBSTACLE,
    PLAIN,
    SAME_NUMBER,
    TRAITS,
    Records,
    Scene,
    record_type,
)
from behavexplor.envs.engine.vehicle_parameters import kind_of, traits_of
from behavexplor.envs.source_gate import replaced
from behavexplor.errors import InputError
from behavexplor.jit import int64, kernel_inner

Rules: TypeAlias = np.record

EGO, OTHER, BARRIER = range(3)  # rows of `World.templates`

RULES: Final = record_type(
    n_frames=np.int64,  # of a decision
    dt=np.float64,  # duration of a frame [s]
    policy_period=np.float64,  # duration of a decision [s]
    regulation_period=np.int64,  # frames from one check of the right of way to the next; 0: none
)
# As `int64`: for a Python number, numba would compile the kernel that gets it once more.
FIRST_LANE: Final = int64(0)
AS_EGO: Final = int64(EGO)
AS_OTHER: Final = int64(OTHER)
_GAINS: tuple[tuple[float, ...], ...] = tuple(
    tuple(map(float, gains)) for gains in (*LinearVehicle.ACCELERATION_RANGE, *LinearVehicle.STEERING_RANGE)
)


class World(NamedTuple):
    """An environment's road and rules."""

    network: Network  # the road network
    rules: Records  # the numbers that determine how a decision runs, shape (1,) of `RULES`
    speeds: Floats  # target speeds of the ego's meta-actions [m/s], shape (speeds,)
    templates: Records  # traits of the ego, of new vehicles of the traffic, and of obstacles, shape (3,) of `TRAITS`


def make_world(env: AbstractEnv, is_goal: Callable[[LaneIndex], bool] = lambda _: False) -> World:
    """Return the road and rules of a highway-env environment that has been reset.

    For `is_goal`, see `make_network`. The parameters of the traffic are those that highway-env's classes have at this
    moment: `IntersectionEnv` changes them for the whole process.

    Raises:
        InputError: if the environment has a road, lanes, vehicles or actions that the engine does not know.
    """
    config = env.config
    _check_road(env)
    return World(
        network=make_network(
            env.road.network, connected_lanes=config["neighbour_vehicles_connected_lanes"], is_goal=is_goal
        ),
        rules=_make_rules(env),
        speeds=_target_speeds(env),
        templates=_make_templates(env),
    )


def _check_road(env: AbstractEnv) -> None:
    """Raise an `InputError` if the road or its network behaves differently from highway-env's."""
    for thing, known in ((env.road, (RegulatedRoad, Road)), (env.road.network, (RoadNetwork,))):
        parent = next((parent for parent in type(thing).__mro__ if parent in known), None)
        changed = type(thing).__name__ if parent is None else replaced(type(thing), parent, {"__init__"})
        if changed is not None:
            raise InputError(
                f"The compiled engine does not know {changed}; use gymnasium.make_vec with vectorization_mode='sync'"
            )


def _make_rules(env: AbstractEnv) -> Records:
    config = env.config
    rules = np.zeros(1, RULES)
    row = rules[0]
    row.n_frames = int(config["simulation_frequency"] // config["policy_frequency"])
    row.dt = 1 / config["simulation_frequency"]
    row.policy_period = 1 / config["policy_frequency"]
    if isinstance(env.road, RegulatedRoad):
        row.regulation_period = int(1 / row.dt / env.road.REGULATION_FREQUENCY)
    return rules


def _target_speeds(env: AbstractEnv) -> Floats:
    action = env.action_type
    if isinstance(action, DiscreteMetaAction):
        return np.array(action.target_speeds, dtype=np.float64)
    if isinstance(action, ContinuousAction):
        return np.zeros(2)  # never read without meta-actions
    raise InputError(
        f"The compiled engine does not know the action {type(action).__name__}; it knows DiscreteMetaAction, "
        f"DiscreteAction and ContinuousAction; use gymnasium.make_vec with vectorization_mode='sync'"
    )


def _make_templates(env: AbstractEnv) -> Records:
    other = utils.class_from_path(env.config["other_vehicles_type"])
    templates = np.zeros(3, TRAITS)
    templates[EGO] = traits_of(env.vehicle, kind_of(type(env.vehicle)))
    if isinstance(env.action_type, ContinuousAction) and env.action_type.speed_range:
        templates[EGO].min_speed, templates[EGO].max_speed = env.action_type.speed_range
    templates[OTHER] = traits_of(other, kind_of(other))
    templates[BARRIER] = traits_of(Obstacle, OBSTACLE)
    return templates


@kernel_inner
def place_vehicle(world: World, scene: Scene, template: int, x: float, y: float, heading: float, speed: float) -> int:
    """Add a vehicle after all others in the list, and return its place. There must be no obstacles yet.

    The template is AS_EGO or AS_OTHER, x and y are in m, and the heading is in rad. The speed [m/s] is also the target.
    """
    i: int = scene.episode.n_vehicles
    scene.episode.n_vehicles = i + 1
    scene.traits[i] = world.templates[template]
    vehicle, traits = scene.vehicles[i], scene.traits[i]
    vehicle.number = scene.episode.n_numbered
    scene.episode.n_numbered += 1
    vehicle.x, vehicle.y, vehicle.heading, vehicle.speed = x, y, heading, speed
    vehicle.cos, vehicle.sin = math.cos(heading), math.sin(heading)
    vehicle.steering = vehicle.acceleration = vehicle.impact_x = vehicle.impact_y = vehicle.timer = 0.0
    vehicle.has_impact = vehicle.crashed = vehicle.is_yielding = False
    vehicle.speed_index = vehicle.route_position = 0
    vehicle.route_length = NO_ROUTE
    vehicle.lane, _, _ = closest_lane(world.network, FIRST_LANE, x, y, heading)
    vehicle.target_lane, vehicle.target_speed = vehicle.lane, speed
    if traits.kind == PLAIN:
        vehicle.target_lane, vehicle.target_speed = NO_LANE, 0.0
    elif traits.kind == MDP:
        vehicle.speed_index = nearest_speed(world.speeds, speed)
        vehicle.target_speed = world.speeds[vehicle.speed_index]
    else:
        vehicle.timer = ((x + y) * math.pi) % traits.lane_change_delay
    return i


@kernel_inner
def place_on_lane(world: World, scene: Scene, template: int, lane: int, station: float, speed: float) -> int:
    """Add a vehicle at a station [m] of a lane, in the lane's direction: `RoadObject.make_on_lane`."""
    x, y = lane_point(world.network.lanes[lane], station)
    return place_vehicle(world, scene, template, x, y, lane_heading(world.network.lanes[lane], station), speed)


@kernel_inner
def place_nearby(world: World, scene: Scene, words: Words, lane: int, station: float, speed: float) -> int:
    """Add traffic near a station [m] of a lane: station and speed have standard deviations of 2 m and 2 m/s."""
    station += normal(words) * 2.0
    return place_on_lane(world, scene, AS_OTHER, lane, station, speed + normal(words) * 2.0)


@kernel_inner
def plan_route(world: World, scene: Scene, i: int, plans: Ints) -> None:
    """Plan the route of vehicle i from its lane to a destination: `ControlledVehicle.plan_route_to`.

    `plans` are the roads of the route from every road, padded with -1, shape (roads, steps).
    """
    if scene.traits[i].kind == PLAIN:
        return
    vehicle = scene.vehicles[i]
    lane = world.network.lanes[vehicle.lane]
    vehicle.route_length = 0
    for road in plans[lane.road]:
        if road < 0:
            break
        scene.routes[i, vehicle.route_length].road = road
        scene.routes[i, vehicle.route_length].number = lane.number if vehicle.route_length == 0 else SAME_NUMBER
        vehicle.route_length += 1


@kernel_inner
def draw_behavior(words: Words, scene: Scene, i: int) -> None:
    """Draw the behavior of vehicle i: `randomize_behavior` of `IDMVehicle` or `LinearVehicle`."""
    traits = scene.traits[i]
    if traits.kind == LINEAR:
        low, high, low_steering, high_steering = _GAINS
        traits.speed_gain = low[0] + uniform(words, 0.0, 1.0) * (high[0] - low[0])
        traits.front_speed_gain = low[1] + uniform(words, 0.0, 1.0) * (high[1] - low[1])
        traits.front_gap_gain = low[2] + uniform(words, 0.0, 1.0) * (high[2] - low[2])
        traits.heading_gain = low_steering[0] + uniform(words, 0.0, 1.0) * (high_steering[0] - low_steering[0])
        traits.offset_gain = low_steering[1] + uniform(words, 0.0, 1.0) * (high_steering[1] - low_steering[1])
    if traits.kind in (IDM, LINEAR):
        traits.delta = uniform(words, traits.low_delta, traits.high_delta)
