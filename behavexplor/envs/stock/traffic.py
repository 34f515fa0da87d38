"""Decisions of the reactive traffic: `IDMVehicle` and `LinearVehicle`.

IDM is the Intelligent Driver Model (Treiber et al., 2000), which gives the acceleration. MOBIL (Kesting et al., 2007)
decides about changes of lane.
"""

import math

from behavexplor.envs.stock.control import clip, linear_steering, not_zero, steering
from behavexplor.envs.stock.lane_network import Network
from behavexplor.envs.stock.lanes import is_reachable, lane_coordinates
from behavexplor.envs.stock.neighbors import NOBODY, neighbors
from behavexplor.envs.stock.routing import follow_road
from behavexplor.envs.stock.state import LINEAR, OBSTACLE, PLAIN, Scene, Traits, Vehicle
from behavexplor.jit import kernel_in_place

MIN_CHANGE_SPEED = 1  # a slower vehicle does not change lane [m/s]


@kernel_in_place
def drive(network: Network, scene: Scene, i: int) -> None:
    """Decide the lane, steering and acceleration of a vehicle: `IDMVehicle.act`.

    Args:
        network: the road network.
        scene: the episode. Vehicle i is changed in place.
        i: the vehicle, whose kind is IDM or LINEAR.
    """
    vehicle, traits = scene.vehicles[i], scene.traits[i]
    if vehicle.crashed:
        return
    follow_road(network, vehicle, scene.routes[i])
    if traits.changes_lanes:
        _change_lane(network, scene, i)
    if traits.kind == LINEAR:
        vehicle.steering = linear_steering(network, vehicle, traits)
    else:
        vehicle.steering = steering(network, vehicle, traits.length)
    front, _ = _neighbors_on(network, scene, i, vehicle.lane)
    wanted = _acceleration(network, scene, traits, i, front)
    if vehicle.lane != vehicle.target_lane:
        front, _ = _neighbors_on(network, scene, i, vehicle.target_lane)
        wanted = min(wanted, _acceleration(network, scene, traits, i, front))
    vehicle.acceleration = clip(wanted, -traits.max_acceleration, traits.max_acceleration)


@kernel_in_place
def _neighbors_on(network: Network, scene: Scene, i: int, lane: int) -> tuple[int, int]:
    """Return the vehicles in front of vehicle i and behind it on a lane."""
    station, _ = lane_coordinates(network.lanes[lane], scene.vehicles[i].x, scene.vehicles[i].y)
    return neighbors(network, scene, i, lane, station)


@kernel_in_place
def _change_lane(network: Network, scene: Scene, i: int) -> None:
    """Begin or abort a change of lane: `IDMVehicle.change_lane_policy`.

    If MOBIL recommends both sides, the right one is taken.
    """
    vehicle, traits = scene.vehicles[i], scene.traits[i]
    if vehicle.lane != vehicle.target_lane:
        if network.lanes[vehicle.lane].road == network.lanes[vehicle.target_lane].road and _is_cut_off(
            network, scene, i
        ):
            vehicle.target_lane = vehicle.lane
        return
    if not traits.lane_change_delay < vehicle.timer:
        return
    vehicle.timer = 0.0
    lane = network.lanes[vehicle.lane]
    for side in (-1, 1):
        number = lane.number + side
        if number < 0 or number >= network.roads[lane.road].n_lanes:
            continue
        wanted = vehicle.lane + side
        if not is_reachable(network.lanes[wanted], vehicle.x, vehicle.y) or abs(vehicle.speed) < MIN_CHANGE_SPEED:
            continue
        if _recommends(network, scene, i, wanted):
            vehicle.target_lane = wanted


@kernel_in_place
def _is_cut_off(network: Network, scene: Scene, i: int) -> bool:
    """Return whether another vehicle is closely ahead and is also changing to the target lane of vehicle i."""
    target = scene.vehicles[i].target_lane
    for j in range(scene.episode.n_vehicles):
        other = scene.vehicles[j]
        if other.target_lane == target and other.lane != target and j != i:
            distance = _lane_gap(network, scene, i, j)
            if distance > 0 and distance < _desired_gap(scene.traits[i], scene.vehicles[i], other):
                return True
    return False


@kernel_in_place
def _recommends(network: Network, scene: Scene, i: int, lane: int) -> bool:
    """Return whether MOBIL recommends that vehicle i changes to a lane: `IDMVehicle.mobil`."""
    vehicle, traits = scene.vehicles[i], scene.traits[i]
    new_front, new_rear = _neighbors_on(network, scene, i, lane)
    new_rear_changed = _acceleration(network, scene, traits, new_rear, i)
    if new_rear_changed < -traits.max_braking:
        return False
    changed = _acceleration(network, scene, traits, i, new_front)
    position = vehicle.route_position
    if position < vehicle.route_length and scene.routes[i, position].number >= 0:
        target = network.lanes[vehicle.target_lane].number
        wanted = scene.routes[i, position].number
        is_toward = _sign(network.lanes[lane].number - target) == _sign(wanted - target)
        return bool(is_toward and not changed < -traits.max_braking)
    old_front, old_rear = _neighbors_on(network, scene, i, vehicle.lane)
    gain = changed - _acceleration(network, scene, traits, i, old_front)
    if traits.politeness != 0.0:
        gain += traits.politeness * (
            new_rear_changed
            - _acceleration(network, scene, traits, new_rear, new_front)
            + _acceleration(network, scene, traits, old_rear, old_front)
            - _acceleration(network, scene, traits, old_rear, i)
        )
    return not gain < traits.min_gain


@kernel_in_place
def _sign(number: int) -> int:
    return (1 if number > 0 else 0) - (1 if number < 0 else 0)


@kernel_in_place
def _acceleration(network: Network, scene: Scene, traits: Traits, i: int, front: int) -> float:
    """Compute the acceleration that a driver with these traits would want in place of vehicle i [m/s2].

    Both i and `front` may be `NOBODY`.
    """
    if i == NOBODY:
        return 0.0
    if traits.kind == LINEAR:
        return _linear_acceleration(network, scene, traits, i, front)
    if scene.traits[i].kind == OBSTACLE:
        return 0.0
    vehicle = scene.vehicles[i]
    target_speed = vehicle.target_speed
    limit = network.lanes[vehicle.lane].speed_limit
    if not math.isnan(limit):
        target_speed = clip(target_speed, 0.0, limit)
    share = max(vehicle.speed, 0.0) / abs(not_zero(target_speed))
    wanted = traits.comfort_acceleration * (1 - share**traits.delta)
    if front != NOBODY:
        distance = _lane_gap(network, scene, i, front)
        closeness = _desired_gap(traits, vehicle, scene.vehicles[front]) / not_zero(distance)
        wanted -= traits.comfort_acceleration * (closeness * closeness)
    return float(wanted)


@kernel_in_place
def _linear_acceleration(network: Network, scene: Scene, traits: Traits, i: int, front: int) -> float:
    """Compute the acceleration of a linear controller [m/s2]: `LinearVehicle.acceleration`."""
    vehicle = scene.vehicles[i]
    has_target = scene.traits[i].kind not in (PLAIN, OBSTACLE)
    to_target = vehicle.target_speed - vehicle.speed if has_target else 0.0
    to_front = to_safety = 0.0
    if front != NOBODY:
        safe = traits.distance_wanted + max(vehicle.speed, 0.0) * traits.time_wanted
        to_front = min(scene.vehicles[front].speed - vehicle.speed, 0.0)
        to_safety = min(_lane_gap(network, scene, i, front) - safe, 0.0)
    gains = traits.speed_gain * to_target + traits.front_speed_gain * to_front
    return float(gains + traits.front_gap_gain * to_safety)


@kernel_in_place
def _lane_gap(network: Network, scene: Scene, i: int, j: int) -> float:
    """Compute how far vehicle j is ahead of vehicle i along its lane [m]: `RoadObject.lane_distance_to`."""
    lane, vehicle, other = network.lanes[scene.vehicles[i].lane], scene.vehicles[i], scene.vehicles[j]
    return lane_coordinates(lane, other.x, other.y)[0] - lane_coordinates(lane, vehicle.x, vehicle.y)[0]


@kernel_in_place
def _desired_gap(traits: Traits, vehicle: Vehicle, front: Vehicle) -> float:
    """Compute the gap that a driver wants to the vehicle in front [m]: `IDMVehicle.desired_gap`."""
    dx = vehicle.speed * vehicle.cos - front.speed * front.cos
    dy = vehicle.speed * vehicle.sin - front.speed * front.sin
    closing = dx * vehicle.cos + dy * vehicle.sin
    follow = traits.distance_wanted + vehicle.speed * traits.time_wanted
    return float(follow + vehicle.speed * closing / traits.gap_divisor)
