"""The observations `Kinematics`, `ExitObservation` and `TimeToCollision`, computed from arrays."""

import math
from typing import Any, Final, NamedTuple

import numpy as np
from highway_env.envs.common.observation import ExitObservation, KinematicObservation
from highway_env.road.lane import AbstractLane

from behavexplor.data.array_types import Floats, Ints, Singles
from behavexplor.envs.engine.lane_geometry import lane_coordinates, lane_heading, lane_point, wrap_to_pi
from behavexplor.envs.engine.lane_keeping import not_zero
from behavexplor.envs.engine.lane_network import Network
from behavexplor.envs.engine.state import OBSTACLE, SAME_NUMBER, Records, Scene, Vehicle, record_type
from behavexplor.envs.observation_types import FEATURES, RELATIVE, default_ranges
from behavexplor.jit import kernel_inner

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
    low=np.float64,  # of the range
    width=np.float64,  # of the range
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
N_SHOWN: Final = 3  # speeds, and lanes, of a TimeToCollision observation
DEPTH: Final = 3  # roads ahead on which it considers vehicles


class View(NamedTuple):
    """The options of a Kinematics observation."""

    options: Records  # shape (1,) of `OPTIONS`
    columns: Records  # the features, shape (features,) of `COLUMN`


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
    """Fill a Kinematics observation, shape (vehicles_count, features). A "shuffled" order is left to the caller."""
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
    """List in the scratch memory which vehicles get a row, at most `most`; return how many: `Road.close_objects_to`."""
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


class GridMemory(NamedTuple):
    """Memory for a TimeToCollision observation."""

    grid: Singles  # cost of each cell, shape (speeds, lanes, times), with the lanes of the widest road
    stack: Ints  # roads that are still to be searched, shape (3 x roads + 1, 3)


def make_memory(network: Network, n_speeds: int, n_times: int) -> GridMemory:
    """Create the memory for TimeToCollision observations of `n_speeds` speeds and `n_times` times."""
    n_lanes = max(road.n_lanes for road in network.roads)
    stack = np.zeros((DEPTH * len(network.roads) + 1, 3), dtype=np.int64)
    return GridMemory(np.zeros((n_speeds, n_lanes, n_times), dtype=np.float32), stack)


@kernel_inner
def observe_times(
    network: Network, scene: Scene, speeds: Floats, period: float, memory: GridMemory, observation: Singles
) -> None:
    """Fill a TimeToCollision observation, shape (9, times): when the ego would meet others, by speed and lane.

    Its rows are three target speeds times three lanes. `speeds` are the ego's target speeds [m/s], `period` is the
    duration of a cell [s], and the memory is overwritten.
    """
    ego = scene.vehicles[scene.episode.ego]
    lane = network.lanes[ego.lane]
    n_speeds, n_lanes = len(speeds), network.roads[lane.road].n_lanes
    grid = memory.grid
    _fill_grid(network, scene, speeds, period, memory)
    for a in range(N_SHOWN):
        speed = min(max(ego.speed_index + a - N_SHOWN // 2, 0), n_speeds - 1)
        for b in range(N_SHOWN):
            shown = lane.number + b - N_SHOWN // 2
            is_lane = shown >= 0 and shown < n_lanes
            for time in range(grid.shape[2]):
                observation[a * N_SHOWN + b, time] = grid[speed, shown, time] if is_lane else 1.0


@kernel_inner
def _fill_grid(network: Network, scene: Scene, speeds: Floats, period: float, memory: GridMemory) -> None:
    """Compute the cost of each cell: `compute_ttc_grid`."""
    grid = memory.grid
    grid[:] = 0.0
    ego = scene.vehicles[scene.episode.ego]
    lane = network.lanes[ego.lane]
    n_lanes = network.roads[lane.road].n_lanes
    own, _ = lane_coordinates(lane, ego.x, ego.y)
    for j in range(scene.episode.n_vehicles):
        other = scene.vehicles[j]
        road = network.lanes[other.lane].road
        if j == scene.episode.ego or not _is_connected(network, scene, road, memory.stack):
            continue
        first, last = 0, n_lanes
        if network.roads[road].n_lanes == n_lanes:
            first = network.lanes[other.lane].number
            last = first + 1
        gap = lane_coordinates(lane, other.x, other.y)[0] - own
        projected = other.speed * (other.cos * ego.cos + other.sin * ego.sin)
        margin = scene.traits[j].length / 2 + scene.traits[scene.episode.ego].length / 2
        for k in range(len(speeds)):
            if speeds[k] == other.speed:
                continue
            closing = not_zero(speeds[k] - projected)
            _mark(grid[k], first, last, gap / closing / period, 1.0)
            _mark(grid[k], first, last, (gap - margin) / closing / period, 0.5)
            _mark(grid[k], first, last, (gap + margin) / closing / period, 0.5)


@kernel_inner
def _mark(grid: Singles, first: int, last: int, time: float, cost: float) -> None:
    """Raise the cost of a time, in cells, on the lanes from `first` to before `last`."""
    if time < 0:
        return
    for rounded in (math.floor(time), math.ceil(time)):
        if rounded < grid.shape[1]:
            for lane in range(first, last):
                cell = int(rounded)
                grid[lane, cell] = max(grid[lane, cell], np.float32(cost))


@kernel_inner
def _is_connected(network: Network, scene: Scene, road: int, stack: Ints) -> bool:
    """Return whether vehicles on a road can be met on the ego's way: `RoadNetwork.is_connected_road`."""
    ego, route = scene.vehicles[scene.episode.ego], scene.routes[scene.episode.ego]
    stack[0, 0], stack[0, 1], stack[0, 2] = network.lanes[ego.lane].road, ego.route_position, DEPTH
    count = 1
    while count > 0:
        count -= 1
        reached, position, depth = stack[count, 0], stack[count, 1], stack[count, 2]
        if road == reached or network.roads[road].target == network.roads[reached].origin:
            return True
        if depth == 0:
            continue
        while position < ego.route_length and route[position].road == reached:
            position += 1
        target = network.roads[reached].target
        if position < ego.route_length and network.roads[route[position].road].origin == target:
            stack[count, 0], stack[count, 1], stack[count, 2] = route[position].road, position + 1, depth - 1
            count += 1
            continue
        first = network.roads[reached].first_exit
        for k in range(first, first + network.roads[reached].n_exits):
            stack[count, 0], stack[count, 1], stack[count, 2] = network.exits[k], position, depth - 1
            count += 1
    return False
