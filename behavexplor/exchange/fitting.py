"""Scripts for trajectories that were drawn or changed by hand: the route and the waypoints that come closest."""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from behavexplor.data.npc_motion import HEADING, motion_on_route
from behavexplor.data.roadmap import RoadMap, Route
from behavexplor.data.scripted import NPC, Waypoint
from behavexplor.data.scripted_logical import ScriptedLogicalScenario
from behavexplor.errors import InputError
from behavexplor.exchange.scene import Mover

Floats = NDArray[np.float64]

MAX_DEVIATION: Final = 0.5  # greatest distance of a fitted motion from the trajectory [m]
_POINTS: Final = 200  # points of a trajectory that are fitted
_MARGIN: Final = 1e-6  # distance from the limits of a range, beyond rounding errors


def fitted_script(mover: Mover, ranges: ScriptedLogicalScenario) -> NPC:
    """Return the script whose motion comes closest to a trajectory that begins at time 0.

    Raises:
        InputError: if no script comes within `MAX_DEVIATION` of it.
    """
    route, stations = _nearest_route(mover, ranges.roadmap)
    chosen = np.unique(np.linspace(0, len(mover.time) - 1, _POINTS).astype(np.intp))
    waypoints = _fitted(route, mover.time[chosen], stations[chosen], ranges)
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
    best = None
    for route in roadmap.npc_routes:
        projected = np.array([route.project(x, y) for x, y in mover.pose[:, :2].tolist()])
        offset = float(np.abs(projected[:, 1]).max())
        if best is None or offset < best[0]:
            best = offset, route, projected[:, 0]
    if best is None:
        raise InputError(f"{mover.name}: the map has no routes")
    return best[1], best[2]


def _fitted(route: Route, time: Floats, stations: Floats, ranges: ScriptedLogicalScenario) -> Floats:
    """Return waypoints whose motion along the route is the nearest to the stations, shape (waypoints, 2)."""
    low, high = ranges.position_ranges(route).T
    slowest, fastest = ranges.speed_range
    speeds = np.gradient(stations, time)
    start = np.clip(_spread(route, stations, ranges.waypoints_per_lane), low + _MARGIN, high - _MARGIN)
    first = np.concatenate([start, np.clip(np.interp(start[:-1], stations, speeds), slowest, fastest)])
    bounds = np.concatenate([low, np.full(len(low) - 1, slowest)]), np.concatenate([high, np.full(len(low) - 1, fastest)])

    def deviation(genes: Floats) -> Floats:
        motion = motion_on_route(ranges.roadmap, route, _waypoints(genes)[None], time)[0, :, :HEADING]
        return np.asarray((motion - wanted).ravel())

    wanted = route.pose(stations)[:, :2]
    found = least_squares(deviation, np.clip(first, *bounds), bounds=bounds, x_scale=np.maximum(np.ptp(bounds, axis=0), 1.0))
    return _waypoints(found.x)


def _waypoints(genes: Floats) -> Floats:
    """Return waypoints in order of their positions. The speed at the last one is 0."""
    count = (len(genes) + 1) // 2
    return np.column_stack([np.maximum.accumulate(genes[:count]), np.append(genes[count:], 0.0)])


def _spread(route: Route, stations: Floats, per_lane: int) -> Floats:
    """Return positions to begin with: in each lane, evenly over the part that the trajectory covers."""
    positions = []
    for begin, end in zip(route.bounds[:-1], route.bounds[1:], strict=True):
        low, high = max(begin, stations[0]), min(end, stations[-1])
        low, high = (low, high) if low < high else (begin, end)
        shares = (np.arange(per_lane) + (0.0 if begin <= stations[0] else 0.5)) / per_lane
        positions.append(low + (high - low) * shares)
    return np.concatenate(positions)
