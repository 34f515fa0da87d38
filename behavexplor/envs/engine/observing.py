"""The observations `Kinematics` and `ExitObservation`, computed from arrays."""

import math
from typing import Any, Final, NamedTuple

import numpy as np
from highway_env.envs.common.observation import ExitObservation, KinematicObservation
from highway_env.road.lane import AbstractLane
from numpy.typing import NDArray

from behavexplor.envs.engine.lane_geometry import lane_coordinates, lane_heading, lane_point, wrap_to_pi
from behavexplor.envs.engine.lane_network import Network
from behavexplor.envs.engine.state import OBSTACLE, SAME_NUMBER, Records, Scene, Vehicle, record_type
from behavexplor.envs.observation_types import FEATURES, RELATIVE, default_ranges
from behavexplor.jit import kernel_inner

Singles = NDArray[np.float32]

PRESENCE, POS_X, POS_Y, VEL_X, VEL_Y, ANGLE, COS_H, SIN_H, COS_D, SIN_D, LONG_OFF, LAT_OFF, ANG_OFF = range(
    len(FEATURES)
)
LANE_WIDTH: Final = float(AbstractLane.DEFAULT_WIDTH)  # [m]
NOT_A_LANE: Final = -1
_KNOWN: Any = np.bool_(True)  # numba would compile a function once more for each constant of Python's own type

COLUMN: Final = record_type(
    feature=np.int64,
    is_relative=np.bool_,  # to the ego
    is_ranged=np.bool_,  # mapped from its range to [-1, 1]
    depends_on_road=np.bool_,  # the range depends on the number of lanes of the ego's first road
    low=np.float64,
    width=np.float64,
)

OPTIONS: Final = record_type(
    is_grid=np.bool_,  # the observation is a TimeToCollision, and has no other options
    is_clipped=np.bool_,
    see_behind=np.bool_,
    observe_intentions=np.bool_,
    include_obstacles=np.bool_,
    is_sorted=np.bool_,
    is_shuffled=np.bool_,
    distance=np.float64,  # greatest distance at which vehicles are observed [m]
    behind=np.float64,  # vehicles further behind are not observed, unless all are [m]
    exit_lane=np.int64,  # lane along which the ego's x is measured, or NOT_A_LANE
)


class View(NamedTuple):
    """The options of a Kinematics observation.

    Attributes:
        options: shape (1,) of `OPTIONS`.
        columns: the features, shape (features,) of `COLUMN`.
    """

    options: Records
    columns: Records


def make_view(observation: KinematicObservation) -> View:
    """Return the options of an observation."""
    options = np.zeros(1, OPTIONS)
    row: Any = options[0]
    for name in ("see_behind", "observe_intentions", "include_obstacles"):
        row[name] = bool(getattr(observation, name))
    row.is_clipped = bool(observation.clip)
    row.is_shuffled = observation.order == "shuffled"
    row.is_sorted = not row.is_shuffled
    row.distance = observation.env.PERCEPTION_DISTANCE
    row.behind = 2 * observation.env.vehicle.LENGTH
    row.exit_lane = NOT_A_LANE
    if isinstance(observation, ExitObservation):
        network = observation.env.road.network
        row.exit_lane = network.lanes_list().index(network.get_lane(("1", "2", -1)))
        row.include_obstacles, row.is_sorted = False, True
    return View(options, _make_columns(observation))


def grid_view() -> View:
    """Return the options of the observation TimeToCollision."""
    options = np.zeros(1, OPTIONS)
    options[0].is_grid = True
    return View(options, np.zeros(0, COLUMN))


def _make_columns(observation: KinematicObservation) -> Records:
    given = observation.env.config["observation"].get("features_range")
    ranges = given or default_ranges(1)
    columns = np.zeros(len(observation.features), COLUMN)
    for column, feature in zip(columns, observation.features, strict=True):
        column.feature = FEATURES.index(feature)
        column.is_relative = feature in RELATIVE and not observation.absolute
        if observation.normalize and feature in ranges:
            low, high = ranges[feature]
            column.is_ranged, column.low, column.width = True, low, high - low
            column.depends_on_road = not given and feature == "y"
    return columns


@kernel_inner
def observe(network: Network, view: View, scene: Scene, table: Singles) -> None:
    """Fill a Kinematics observation, in highway-env's order even if it is "shuffled".

    Args:
        network: the road network.
        view: the options.
        scene: the episode.
        table: the observation, shape (vehicles_count, features).
    """
    options, ego = view.options[0], scene.episode.ego
    n_seen = _sort_seen(network, view, scene, len(table) - 1)
    table[:] = 0.0
    for k in range(len(view.columns)):
        column = view.columns[k]
        own = _feature(network, scene, ego, column.feature, _KNOWN)
        shown = own
        if column.feature == POS_X and options.exit_lane != NOT_A_LANE:
            vehicle = scene.vehicles[ego]
            shown, _ = lane_coordinates(network.lanes[options.exit_lane], vehicle.x, vehicle.y)
        table[0, k] = _normalized(view, scene, k, shown)
        for row in range(n_seen):
            other = scene.scratch.on_lane[0, row].vehicle
            value = _feature(network, scene, other, column.feature, options.observe_intentions)
            if column.is_relative:
                value -= own
            table[1 + row, k] = _normalized(view, scene, k, value)


@kernel_inner
def _sort_seen(network: Network, view: View, scene: Scene, most: int) -> int:
    """List the vehicles that get a row in the scratch memory, and return their number: `Road.close_objects_to`."""
    options, ego = view.options[0], scene.vehicles[scene.episode.ego]
    lane, seen = network.lanes[ego.lane], scene.scratch.on_lane[0]
    own, _ = lane_coordinates(lane, ego.x, ego.y)
    count, n_vehicles = 0, scene.episode.n_vehicles
    for j in range(n_vehicles + scene.episode.n_obstacles * options.include_obstacles):
        other = scene.vehicles[j]
        dx, dy = other.x - ego.x, other.y - ego.y
        if j == scene.episode.ego or not math.sqrt(dx * dx + dy * dy) < options.distance:
            continue
        gap = lane_coordinates(lane, other.x, other.y)[0] - own
        if not (gap > -options.behind or (options.see_behind and j < n_vehicles)):
            continue
        place = count
        if options.is_sorted:
            while place > 0 and seen[place - 1].station > abs(gap):
                place -= 1
        if place == most:
            continue
        for k in range(min(count, most - 1), place, -1):
            seen[k] = seen[k - 1]
        seen[place].vehicle, seen[place].station = j, abs(gap)
        count = min(count + 1, most)
    return count


@kernel_inner
def _normalized(view: View, scene: Scene, k: int, value: float) -> float:
    """Map a value from its range to [-1, 1], if it has one."""
    column = view.columns[k]
    if not column.is_ranged:
        return value
    low, width = column.low, column.width
    if column.depends_on_road:
        low, width = -LANE_WIDTH * scene.episode.n_side_lanes, 2 * LANE_WIDTH * scene.episode.n_side_lanes
    value = -1 + (value - low) * 2 / width
    if view.options[0].is_clipped:
        return value if math.isnan(value) else min(max(value, -1.0), 1.0)
    return value


@kernel_inner
def _feature(network: Network, scene: Scene, i: int, feature: int, knows_destination: bool) -> float:
    """Compute a feature of vehicle or obstacle i in world coordinates: `Vehicle.to_dict`."""
    vehicle = scene.vehicles[i]
    is_vehicle = scene.traits[i].kind != OBSTACLE
    if feature <= POS_Y:
        return 1.0 if feature == PRESENCE else float(vehicle.x if feature == POS_X else vehicle.y)
    if feature <= VEL_Y:
        speed = float(vehicle.speed) if is_vehicle else 0.0
        return speed * float(vehicle.cos if feature == VEL_X else vehicle.sin)
    if feature in (COS_H, SIN_H):
        return float(vehicle.cos if feature == COS_H else vehicle.sin)
    if feature in (COS_D, SIN_D):
        return _destination_direction(network, scene, i, feature) if is_vehicle and knows_destination else 0.0
    if not is_vehicle:
        return math.nan  # highway-env's obstacles have no such feature
    return float(vehicle.heading) if feature == ANGLE else _lane_offset(network, vehicle, feature)


@kernel_inner
def _destination_direction(network: Network, scene: Scene, i: int, feature: int) -> float:
    """Compute a component of the unit vector toward the end of a vehicle's route; 0 without a route."""
    vehicle = scene.vehicles[i]
    if vehicle.route_position >= vehicle.route_length:
        return 0.0
    last = scene.routes[i, vehicle.route_length - 1]
    lane = network.lanes[network.roads[last.road].first_lane + (0 if last.number == SAME_NUMBER else last.number)]
    x, y = lane_point(lane, lane.length)
    dx, dy = x - vehicle.x, y - vehicle.y
    distance = math.sqrt(dx * dx + dy * dy)
    return 0.0 if dx == 0.0 and dy == 0.0 else (dx if feature == COS_D else dy) / distance


@kernel_inner
def _lane_offset(network: Network, vehicle: Vehicle, feature: int) -> float:
    """Compute the station [m], offset [m] or angle [rad] of a vehicle in its lane: `Vehicle.lane_offset`."""
    lane = network.lanes[vehicle.lane]
    station, offset = lane_coordinates(lane, vehicle.x, vehicle.y)
    if feature == LONG_OFF:
        return station
    return offset if feature == LAT_OFF else wrap_to_pi(vehicle.heading - lane_heading(lane, station))
