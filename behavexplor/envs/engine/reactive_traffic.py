"""Decisions of the reactive traffic, `IDMVehicle` and `LinearVehicle`, and the neighbors that they look at.

IDM is the Intelligent Driver Model (Treiber et al., 2000), which gives the acceleration. MOBIL (Kesting et al., 2007)
decides about changes of lane.
"""

import math
from typing import Final

from behavexplor.envs.engine.lane_geometry import (
    VEHICLE_LENGTH,
    coordinates_on,
    is_on_lane,
    is_reachable,
    lane_coordinates,
    may_be_on_lane,
)
from behavexplor.envs.engine.lane_keeping import clip, follow_road, linear_steering, not_zero, steering
from behavexplor.envs.engine.lane_network import STRAIGHT, Lane, Network
from behavexplor.envs.engine.state import LINEAR, OBSTACLE, PLAIN, Records, Scene, Traits, Vehicle
from behavexplor.jit import kernel_inner

MIN_CHANGE_SPEED: Final = 1  # a slower vehicle does not change lane [m/s]
NO_VEHICLE: Final = -1
UNKNOWN: Final = -1  # `n_on_lane` of a lane that has not been asked for in this frame
MARGIN: Final = 1.0  # a vehicle this far beside a lane still counts as on it [m]


@kernel_inner
def drive(network: Network, scene: Scene, i: int) -> None:
    """Decide lane, steering and acceleration of vehicle i, which is IDM or LINEAR and not crashed: `IDMVehicle.act`."""
    vehicle, traits, former = scene.vehicles[i], scene.traits[i], scene.vehicles[i].target_lane
    station, offset = coordinates_on(network, scene, i, former)
    follow_road(network, vehicle, scene.routes[i], station)
    free = _free_acceleration(network, scene, traits, i)
    if traits.changes_lanes and (vehicle.lane != vehicle.target_lane or traits.lane_change_delay < vehicle.timer):
        _change_lane(network, scene, i, free)
    target = network.lanes[vehicle.target_lane]
    if vehicle.target_lane != former:
        station, offset = coordinates_on(network, scene, i, vehicle.target_lane)
    if traits.kind == LINEAR:
        vehicle.steering = linear_steering(target, vehicle, station, offset, traits)
    else:
        vehicle.steering = steering(target, vehicle, station, offset, traits.length)
    front, _ = neighbors(network, scene, i, vehicle.lane, scene.scratch.stations[i])
    wanted = _acceleration(network, scene, traits, i, front, free)
    if vehicle.lane != vehicle.target_lane:
        front, _ = neighbors(network, scene, i, vehicle.target_lane, station)
        wanted = min(wanted, _acceleration(network, scene, traits, i, front, free))
    vehicle.acceleration = clip(wanted, -traits.max_acceleration, traits.max_acceleration)


@kernel_inner
def _change_lane(network: Network, scene: Scene, i: int, free: float) -> None:
    """Begin or abort a change of lane: `IDMVehicle.change_lane_policy`.

    If MOBIL recommends both sides, the right one is taken. `free` is the acceleration wanted on a free road [m/s2].
    """
    vehicle, traits = scene.vehicles[i], scene.traits[i]
    lane = network.lanes[vehicle.lane]
    if vehicle.lane != vehicle.target_lane:
        if lane.road == network.lanes[vehicle.target_lane].road and _is_cut_off(network, scene, i):
            vehicle.target_lane = vehicle.lane
        return
    vehicle.timer = 0.0
    if abs(vehicle.speed) < MIN_CHANGE_SPEED:
        return
    front, rear = neighbors(network, scene, i, vehicle.lane, scene.scratch.stations[i])
    unchanged = _acceleration(network, scene, traits, i, front, free)
    for side in (-1, 1):
        number = lane.number + side
        if number < 0 or number >= network.roads[lane.road].n_lanes:
            continue
        wanted = vehicle.lane + side
        if is_reachable(network.lanes[wanted], vehicle.x, vehicle.y) and _recommends(
            network, scene, i, wanted, free, unchanged, front, rear
        ):
            vehicle.target_lane = wanted


@kernel_inner
def _is_cut_off(network: Network, scene: Scene, i: int) -> bool:
    """Return whether another vehicle is closely ahead and is also changing to the target lane of vehicle i."""
    vehicle = scene.vehicles[i]
    own = scene.scratch.stations[i]
    for j in range(scene.episode.n_vehicles):
        other = scene.vehicles[j]
        if other.target_lane == vehicle.target_lane and other.lane != vehicle.target_lane and j != i:
            distance = coordinates_on(network, scene, j, vehicle.lane)[0] - own
            if distance > 0 and distance < _desired_gap(scene.traits[i], vehicle, other):
                return True
    return False


@kernel_inner
def _recommends(
    network: Network, scene: Scene, i: int, lane: int, free: float, unchanged: float, old_front: int, old_rear: int
) -> bool:
    """Return whether MOBIL recommends a change to a lane: `IDMVehicle.mobil`.

    `free` is the acceleration that vehicle i would want on a free road, and `unchanged` the one that it wants in its
    present lane [m/s2], where `old_front` and `old_rear` are its neighbors, or `NO_VEHICLE`.
    """
    vehicle, traits = scene.vehicles[i], scene.traits[i]
    station, _ = lane_coordinates(network.lanes[lane], vehicle.x, vehicle.y)
    new_front, new_rear = neighbors(network, scene, i, lane, station)
    new_rear_changed = _acceleration_of(network, scene, traits, new_rear, i)
    if new_rear_changed < -traits.max_braking:
        return False
    changed = _acceleration(network, scene, traits, i, new_front, free)
    position = vehicle.route_position
    if position < vehicle.route_length and scene.routes[i, position].number >= 0:
        target = network.lanes[vehicle.target_lane].number
        wanted = scene.routes[i, position].number
        is_toward = _sign(network.lanes[lane].number - target) == _sign(wanted - target)
        return bool(is_toward and not changed < -traits.max_braking)
    gain = changed - unchanged
    if traits.politeness != 0.0:
        gain += traits.politeness * (
            new_rear_changed
            - _acceleration_of(network, scene, traits, new_rear, new_front)
            + _acceleration_of(network, scene, traits, old_rear, old_front)
            - _acceleration_of(network, scene, traits, old_rear, i)
        )
    return not gain < traits.min_gain


@kernel_inner
def _sign(number: int) -> int:
    return (1 if number > 0 else 0) - (1 if number < 0 else 0)


@kernel_inner
def _acceleration_of(network: Network, scene: Scene, traits: Traits, i: int, front: int) -> float:
    """Compute the acceleration that a driver with these traits would want in place of vehicle i [m/s2].

    Both i and `front` may be `NO_VEHICLE`.
    """
    if i == NO_VEHICLE:
        return 0.0
    return _acceleration(network, scene, traits, i, front, _free_acceleration(network, scene, traits, i))


@kernel_inner
def _free_acceleration(network: Network, scene: Scene, traits: Traits, i: int) -> float:
    """Compute the acceleration that a driver wants on a free road [m/s2]; see `_acceleration`."""
    vehicle, kind = scene.vehicles[i], scene.traits[i].kind
    target_speed = vehicle.target_speed
    if traits.kind == LINEAR:
        has_target = kind not in (PLAIN, OBSTACLE)
        return float(traits.speed_gain * (target_speed - vehicle.speed)) if has_target else 0.0
    if kind == OBSTACLE:
        return 0.0
    limit = network.lanes[vehicle.lane].speed_limit
    if not math.isnan(limit):
        target_speed = clip(target_speed, 0.0, limit)
    share = max(vehicle.speed, 0.0) / abs(not_zero(target_speed))
    return float(traits.comfort_acceleration * (1 - share**traits.delta))


@kernel_inner
def _acceleration(network: Network, scene: Scene, traits: Traits, i: int, front: int, free: float) -> float:
    """Compute the acceleration that a driver wants [m/s2]: `acceleration` of `IDMVehicle` and `LinearVehicle`.

    `traits` are the driver's, whose own vehicle need not be vehicle i. `front` is the vehicle in front of vehicle i, or
    `NO_VEHICLE`; `free` is what the driver would want on a free road [m/s2].
    """
    if front == NO_VEHICLE or (scene.traits[i].kind == OBSTACLE and traits.kind != LINEAR):
        return free
    vehicle, other = scene.vehicles[i], scene.vehicles[front]
    distance = coordinates_on(network, scene, front, vehicle.lane)[0] - scene.scratch.stations[i]
    if traits.kind == LINEAR:
        safe = traits.distance_wanted + max(vehicle.speed, 0.0) * traits.time_wanted
        follow = free + traits.front_speed_gain * min(other.speed - vehicle.speed, 0.0)
        return float(follow + traits.front_gap_gain * min(distance - safe, 0.0))
    closeness = _desired_gap(traits, vehicle, other) / not_zero(distance)
    return float(free - traits.comfort_acceleration * (closeness * closeness))


@kernel_inner
def _desired_gap(traits: Traits, vehicle: Vehicle, front: Vehicle) -> float:
    """Compute the gap that a driver wants to the vehicle in front [m]: `IDMVehicle.desired_gap`."""
    dx = vehicle.speed * vehicle.cos - front.speed * front.cos
    dy = vehicle.speed * vehicle.sin - front.speed * front.sin
    closing = dx * vehicle.cos + dy * vehicle.sin
    follow = traits.distance_wanted + vehicle.speed * traits.time_wanted
    return float(follow + vehicle.speed * closing / traits.gap_divisor)


@kernel_inner
def neighbors(network: Network, scene: Scene, i: int, lane: int, station: float) -> tuple[int, int]:
    """Return the nearest vehicles or obstacles in front of vehicle i and behind it on a lane, or `NO_VEHICLE`.

    This is `Road.neighbour_vehicles`. `station` is that of vehicle i on this lane [m]. No vehicle moves while all of
    them decide, so each lane has one list of the vehicles on it, made when it is first asked for in a frame.
    """
    on_lane = scene.scratch.on_lane[lane]
    if scene.scratch.n_on_lane[lane] == UNKNOWN:
        scene.scratch.n_on_lane[lane] = _find_on_lane(network, scene, lane, on_lane)
    return _nearest(on_lane, scene.scratch.n_on_lane[lane], i, station)


@kernel_inner
def _nearest(on_lane: Records, count: int, i: int, station: float) -> tuple[int, int]:
    front = rear = NO_VEHICLE
    front_station = rear_station = 0.0
    for k in range(count):
        other = on_lane[k]
        if other.vehicle == i:
            continue
        if station <= other.station:
            if front == NO_VEHICLE or other.station <= front_station:
                front, front_station = other.vehicle, other.station
        elif rear == NO_VEHICLE or other.station > rear_station:
            rear, rear_station = other.vehicle, other.station
    return front, rear


@kernel_inner
def _find_on_lane(network: Network, scene: Scene, lane: int, on_lane: Records) -> int:
    """List the vehicles and obstacles on a lane and on those that it is linked to, each once; return their number."""
    found, vehicles = 0, scene.vehicles
    count = scene.episode.n_vehicles + scene.episode.n_obstacles
    first = network.lanes[lane].first_link
    if network.lanes[lane].kind == STRAIGHT and network.lanes[lane].n_links == 1:
        return _find_on_straight_lane(network.lanes[lane], vehicles, count, on_lane)
    for j in range(count):
        for k in range(first, first + network.lanes[lane].n_links):
            link = network.links[k]
            searched = network.lanes[link.lane]
            if link.lane != vehicles[j].lane and not may_be_on_lane(searched, vehicles[j].x, vehicles[j].y, MARGIN):
                continue
            station, offset = coordinates_on(network, scene, j, link.lane)
            if is_on_lane(searched, station, offset, MARGIN):
                on_lane[found].vehicle = j
                on_lane[found].station = station + link.offset
                found += 1
                break
    return found


@kernel_inner
def _find_on_straight_lane(lane: Lane, vehicles: Records, count: int, on_lane: Records) -> int:
    """List the vehicles on a lane without links to others. It is the most frequent case."""
    found = 0
    start_x, start_y, cos, sin = lane.x, lane.y, lane.cos, lane.sin
    reach, end = lane.width / 2 + MARGIN, lane.length + VEHICLE_LENGTH
    for j in range(count):
        dx, dy = vehicles[j].x - start_x, vehicles[j].y - start_y
        station = dx * cos + dy * sin
        if abs(dx * -sin + dy * cos) <= reach and -VEHICLE_LENGTH <= station < end:
            on_lane[found].vehicle = j
            on_lane[found].station = station
            found += 1
    return found
