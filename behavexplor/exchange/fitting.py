"""Scripts for trajectories that were drawn or changed by hand: the route and the waypoints that come closest."""

from typing import Final

import numpy as np
import scipy
from numpy.typing import NDArray

from behavexplor.data.array_types import Floats
from behavexplor.data.npc_motion import HEADING, motion_on_route
from behavexplor.data.roadmap import RoadMap, Route
from behavexplor.data.scripted import NPC, Waypoint
from behavexplor.data.scripted_logical import ScriptedLogicalScenario
from behavexplor.errors import InputError
from behavexplor.exchange.scenes import Mover

MAX_DEVIATION: Final = 0.5  # greatest distance of a fitted motion from the trajectory [m]
_POINTS: Final = 200  # points of a trajectory that are fitted
_COMPARED: Final = 50  # points of a trajectory that are compared with each route
_EVALUATIONS: Final = 100  # greatest number of steps of a fit
_STRAIGHT: Final = 1e-3  # deviation from a line that needs no waypoint [m2/s2]
_MARGIN: Final = 1e-6  # distance from the limits of a range, beyond rounding errors


def fitted_script(mover: Mover, ranges: ScriptedLogicalScenario) -> NPC:
    """Return the script whose motion comes closest to a trajectory that begins at time 0.

    Raises:
        InputError: if no script comes within `MAX_DEVIATION` of it.
    """
    route, stations = _nearest_route(mover, ranges.roadmap)
    waypoints = _fitted(route, mover.time, stations, ranges)
    motion = motion_on_route(ranges.roadmap, route, waypoints[None], mover.time)[0, :, :HEADING]
    deviation = float(np.hypot(*(motion - mover.pose[:, :2]).T).max())
    if deviation > MAX_DEVIATION:
        raise InputError(
            f"{mover.name}: no route with waypoints comes nearer to its trajectory than {deviation:.2f} m, the nearest "
            f"is {route.name!r}; a vehicle here drives along a route, from its first lane on, without stopping on it"
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


def _unused(route: Route, spare: NDArray[np.int64]) -> list[float]:
    """Return positions, evenly over each lane, for the waypoints that a lane has to spare."""
    ends = zip(route.bounds[:-1], route.bounds[1:], spare.tolist(), strict=True)
    return [float(begin + (end - begin) * (i + 0.5) / count) for begin, end, count in ends for i in range(count)]


def _waypoints(genes: Floats) -> Floats:
    """Return waypoints in order of their positions. The speed at the last one is 0."""
    count = (len(genes) + 1) // 2
    return np.column_stack([np.maximum.accumulate(genes[:count]), np.append(genes[count:], 0.0)])
