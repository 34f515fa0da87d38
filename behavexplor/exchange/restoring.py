"""Scenarios from scenes, the reverse of an export. A trajectory drawn or changed by hand gets the closest script."""

import math
from dataclasses import replace
from typing import Final

import numpy as np
import scipy

from behavexplor.data.array_types import Floats, Ints
from behavexplor.data.conventions import EGO_SIZE, VEHICLE_SIZES
from behavexplor.data.npc_motion import HEADING, motion_on_route
from behavexplor.data.roadmap import RoadMap, Route
from behavexplor.data.scenario import LogicalScenario, Scenario
from behavexplor.data.scripted import NPC, ScriptedScenario, Waypoint
from behavexplor.data.scripted_logical import ScriptedLogicalScenario, require_scripted
from behavexplor.errors import InputError, unknown_name
from behavexplor.exchange.axes import REAR_AXLE
from behavexplor.exchange.scenes import RECORDED, ROUTE, SCENARIO, VEHICLE, WAYPOINTS, Mover, SceneFile

MAX_DEVIATION: Final = 0.5  # greatest distance of a fitted motion from the trajectory [m]
_POINTS: Final = 200  # points of a trajectory that are fitted
_COMPARED: Final = 50  # points of a trajectory that are compared with each route
_EVALUATIONS: Final = 100  # greatest number of steps of a fit
_STRAIGHT: Final = 1e-3  # deviation from a line that needs no waypoint [m2/s2]
_MARGIN: Final = 1e-6  # distance from the limits of a range, beyond rounding errors
_SAME: Final = 0.01  # greatest deviation of a place or size that counts as the same [m]


def restored(scene: SceneFile, logical: LogicalScenario) -> Scenario:
    """Return the scenario of a scene. `logical` has the scenarios of the scene's environment.

    The script of a vehicle counts. If its motion was changed by hand, or it has no script, one is fitted to its motion.

    Raises:
        InputError: if the scene cannot be taken; the message names what is wrong.
    """
    if logical.has_original:  # it is that of a highway-env environment
        return _drawn(scene, logical)
    ranges = require_scripted(logical, "A scene")
    _check_ego(scene.movers[0], ranges)
    scenario = ScriptedScenario(ranges.name, tuple(_npc(mover, ranges) for mover in scene.movers[1:]))
    try:
        ranges.check(scenario)
    except InputError as error:
        raise InputError(f"This scene is not one of {ranges.name}: {_named(str(error), scene)}") from None
    return scenario


def _named(message: str, scene: SceneFile) -> str:
    """Return a message with the names of the scene's vehicles in place of their numbers."""
    for i in reversed(range(len(scene.movers) - 1)):
        message = message.replace(f"npcs[{i}].", f"{scene.movers[i + 1].name}: ")
    return message


def _drawn(scene: SceneFile, logical: LogicalScenario) -> Scenario:
    """Return the scenario that a scene of a highway-env environment holds. Its vehicles drive themselves."""
    changed = [mover.name for mover in scene.movers if mover.is_changed or mover.type != VEHICLE]
    if scene.scenario is None:
        raise InputError(f"This scene of {logical.name} lacks the property {SCENARIO}, its random draws")
    if changed or len(scene.movers) != scene.n_vehicles:
        what = f"{changed[0]} was changed" if changed else "vehicles were added or removed"
        raise InputError(
            f"The vehicles of {logical.name} drive themselves, so their motion cannot be given: {what}; export the "
            "scene again"
        )
    if scene.is_changed:
        raise InputError(
            f"The draws of a scene of {logical.name} cannot be changed, because other draws give other trajectories: "
            "export the scene again"
        )
    logical.check(scene.scenario)
    return scene.scenario


def _check_ego(ego: Mover, ranges: ScriptedLogicalScenario) -> None:
    """Check that the ego is the environment's, and starts where it always does."""
    if not _has_box(ego, *EGO_SIZE):
        raise InputError(f"The bounding box of the ego cannot be changed: it is {_box(*EGO_SIZE)}")
    start = ranges.roadmap.start_pose
    if math.dist(ego.pose[0, :2], start[:2]) > _SAME or ego.speed > _SAME:
        raise InputError(f"The start of the ego cannot be changed: in {ranges.name} it always stands at the same place")


def _npc(mover: Mover, ranges: ScriptedLogicalScenario) -> NPC:
    if mover.type not in ranges.vehicle_types:
        raise InputError(f"{mover.name}: {unknown_name('vehicle type', mover.type, ranges.vehicle_types)}")
    if not _has_box(mover, *VEHICLE_SIZES[mover.type]):
        box = _box(*VEHICLE_SIZES[mover.type])
        raise InputError(f"{mover.name}: a {mover.type} is {box}: give it this box, or choose another type of vehicle")
    if mover.time[0] > 0 or mover.is_gone:
        raise InputError(
            f"{mover.name} appears or leaves during the scene, but scripted vehicles are there all the time"
        )
    if mover.script is not None and not mover.is_changed:
        return mover.script
    if len(mover.time) < 2:
        if mover.script is None:
            raise InputError(f"{mover.name} has neither a trajectory nor the properties {ROUTE} and {WAYPOINTS}")
        raise InputError(
            f"{mover.name} has no trajectory, and its start, route or speed profile is not that which was exported "
            f"with its properties: change {ROUTE} and {WAYPOINTS} to what it should drive, and remove {RECORDED}"
        )
    return replace(fitted_script(mover, ranges), type=mover.type)


def _has_box(mover: Mover, length: float, width: float) -> bool:
    """Return whether a vehicle has a bounding box with this size, and with its center where an export puts it."""
    box = np.array([length, width, REAR_AXLE * length, 0.0])
    return bool(np.abs(np.array([*mover.size, *mover.center]) - box).max() <= _SAME)


def _box(length: float, width: float) -> str:
    return f"{length} x {width} m, with the center at x={REAR_AXLE * length:g} and y=0"


def fitted_script(mover: Mover, ranges: ScriptedLogicalScenario) -> NPC:
    """Return the script whose motion comes closest to a trajectory that begins at time 0.

    Raises:
        InputError: if no script comes within `MAX_DEVIATION` of it, or drives along it in its direction.
    """
    route, stations = _nearest_route(mover, ranges.roadmap)
    waypoints = _fitted(route, mover.time, stations, ranges)
    motion = motion_on_route(ranges.roadmap, route, waypoints[None], mover.time)[0]
    deviation = float(np.hypot(*(motion[:, :HEADING] - mover.pose[:, :2]).T).max())
    if deviation > MAX_DEVIATION:
        raise InputError(
            f"{mover.name}: no route with waypoints comes nearer to its trajectory than {deviation:.2f} m, the nearest "
            f"is {route.name!r}; a vehicle here drives along a route, from its first lane on, without stopping on it"
        )
    if (np.cos(motion[:, HEADING] - mover.pose[:, 2]) < 0).any():
        raise InputError(
            f"{mover.name}: its headings differ by more than 90 degrees from those of the route {route.name!r}, along "
            "which it would drive forward"
        )
    return NPC(mover.type, route.name, tuple(Waypoint(*waypoint) for waypoint in waypoints.tolist()))


def _nearest_route(mover: Mover, roadmap: RoadMap) -> tuple[Route, Floats]:
    """Return the route from which a trajectory deviates least, and the stations of its points [m]."""
    points = mover.pose[:, :2].tolist()
    some = points[:: max(len(points) // _COMPARED, 1)]
    nearest = min(roadmap.npc_routes, key=lambda route: max(abs(route.project(x, y)[1]) for x, y in some))
    return nearest, np.array([nearest.project(x, y)[0] for x, y in points])


def _fitted(route: Route, time: Floats, stations: Floats, ranges: ScriptedLogicalScenario) -> Floats:
    """Return waypoints whose motion along the route is the nearest to the stations, shape (waypoints, 2)."""
    low, high = ranges.position_ranges(route).T
    slowest, fastest = ranges.speed_range
    others = len(low) - 1  # the speed at the last waypoint is 0
    bounds = np.append(low, np.full(others, slowest)), np.append(high, np.full(others, fastest))
    positions, speeds = _corners(route, time, stations, ranges.waypoints_per_lane)
    first = np.clip(np.append(positions, speeds[:-1]), bounds[0] + _MARGIN, bounds[1] - _MARGIN)
    chosen = np.unique(np.linspace(0, len(time) - 1, _POINTS).astype(np.intp))
    wanted = route.pose(stations[chosen])[:, :2]

    def deviation(genes: Floats) -> Floats:
        motion = motion_on_route(ranges.roadmap, route, _waypoints(genes)[None], time[chosen])[0, :, :HEADING]
        return np.asarray((motion - wanted).ravel())

    found = scipy.optimize.least_squares(
        deviation, first, bounds=bounds, x_scale=bounds[1] - bounds[0], max_nfev=_EVALUATIONS
    )
    return _waypoints(found.x)


def _corners(route: Route, time: Floats, stations: Floats, per_lane: int) -> tuple[Floats, Floats]:
    """Return positions [m] and speeds [m/s] to begin with: the corners of the squared speed over the station.

    Between two waypoints, the squared speed is linear in the station. So a waypoint is added where the trajectory
    deviates most from the lines between those so far, in lanes that have fewer than `per_lane`.
    """
    middle, squared = (stations[1:] + stations[:-1]) / 2, np.maximum(np.diff(stations) / np.diff(time), 0.0) ** 2
    lane = np.searchsorted(route.bounds[1:-1], middle, side="right")
    found = [0]
    spare = np.full(len(route.lanes), per_lane)
    spare[lane[0]] -= 1
    while (open_ := np.flatnonzero(spare[lane] > 0)).size:
        corners = sorted(found)
        deviation = np.abs(squared - np.interp(middle, middle[corners], squared[corners]))[open_]
        worst = int(open_[deviation.argmax()])
        if deviation.max() <= _STRAIGHT:
            break
        found.append(worst)
        spare[lane[worst]] -= 1
    corners = sorted(found)
    places = [*middle[corners], *_unused(route, spare)]
    positions = np.sort(np.append(places[1:], stations[0]))
    return positions, np.sqrt(np.interp(positions, middle[corners], squared[corners]))


def _unused(route: Route, spare: Ints) -> list[float]:
    """Return positions, evenly over each lane, for the waypoints that a lane has to spare."""
    ends = zip(route.bounds[:-1], route.bounds[1:], spare.tolist(), strict=True)
    return [float(begin + (end - begin) * (i + 0.5) / count) for begin, end, count in ends for i in range(count)]


def _waypoints(genes: Floats) -> Floats:
    """Return waypoints in order of their positions. The speed at the last one is 0."""
    count = (len(genes) + 1) // 2
    return np.column_stack([np.maximum.accumulate(genes[:count]), np.append(genes[count:], 0.0)])
