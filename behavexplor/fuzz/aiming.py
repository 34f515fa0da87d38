"""Vehicles aimed at the ego: NPCs that would have met it on a drive that was recorded before.

A scripted vehicle's motion depends on the scenario alone. So where it meets a recorded drive of the ego is known before
the scenario is executed. The ego will react to the new vehicle, and then drives elsewhere: the recorded drive is a
prediction of the ego, not a fact. Where other traffic reacts too, the motion of the aimed vehicle is a prediction as
well.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Final, Self

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.array_types import Floats, Ints
from behavexplor.data.conventions import REAR_END_ANGLE, STANDING_SPEED
from behavexplor.data.npc_motion import motion_on_route
from behavexplor.data.roadmap import RoadMap, Route
from behavexplor.data.scripted import NPC, Waypoint
from behavexplor.data.scripted_logical import ScriptedLogicalScenario
from behavexplor.data.trace import Trace
from behavexplor.data.validation import between, validated
from behavexplor.judge.situation import DRIFT, HALF_LANE

Predict = Callable[[RoadMap, Route, Floats, Floats], Floats]  # see `behavexplor.data.npc_motion.motion_on_route`

INTERVAL: Final = 0.25  # time between two frames of a drive [s]
CHANGE_TIME: Final = 3.0  # time over which the ego's motion across its heading is measured [s]
_ATTEMPTS: Final = 12  # routes that are tried for one vehicle
_CHOICES: Final = 5  # vehicles of one route that are tried, if the spawn rules refuse some


@validated
class AimingOptions:
    """Options of aiming."""

    draws: Annotated[int, between(1, 1000)] = 48  # vehicles drawn on a route, of which one that meets the ego is taken
    reach: Annotated[float, between(0.1)] = 4.5  # greatest distance between their centers when vehicle and ego meet [m]
    # share of vehicles that are aimed at the part of the drive in which the ego changed lanes or turned, if it did
    changing_share: Annotated[float, between(0, 1)] = 0.25


@dataclass(frozen=True)
class Drive:
    """The recorded motion of an ego, every `INTERVAL` seconds."""

    frame: Ints  # frames of the trace, shape (F,)
    time: Floats  # times, shape (F,) [s]
    pose: Floats  # x [m], y [m] and heading [rad], shape (F, 3)
    speed: Floats  # speeds, shape (F,) [m/s]
    # distance that the ego moved across its heading in the last `CHANGE_TIME`, positive to the right, shape (F,) [m]
    drift: Floats

    @classmethod
    def of(cls, trace: Trace) -> Self:
        """Return the ego's drive in a trace."""
        frame = np.searchsorted(trace.time, np.arange(0.0, trace.duration + 1e-9, INTERVAL) - 1e-9)
        time, place, heading = trace.time[frame], trace.position[frame, 0], trace.heading[frame, 0]
        moved = place - place[np.maximum(np.arange(len(frame)) - round(CHANGE_TIME / INTERVAL), 0)]
        return cls(
            frame=frame,
            time=time,
            pose=np.column_stack([place, heading]),
            speed=np.hypot(trace.velocity[frame, 0, 0], trace.velocity[frame, 0, 1]),
            drift=moved[:, 1] * np.cos(heading) - moved[:, 0] * np.sin(heading),
        )

    @cached_property
    def changing(self) -> "Drive":
        """The part in which the ego changes lanes or turns."""
        some = np.abs(self.drift) > DRIFT
        return Drive(self.frame[some], self.time[some], self.pose[some], self.speed[some], self.drift[some])


class Aiming:
    """Draws vehicles that would have met the ego on a recorded drive.

    `predict` predicts the motion of vehicles from their waypoints; None for that of scripted vehicles.
    """

    def __init__(
        self, logical: ScriptedLogicalScenario, options: AimingOptions, predict: Predict | None = None
    ) -> None:
        self._logical, self._options, self._predict = logical, options, predict or motion_on_route

    def aim(self, rng: np.random.Generator, drive: Drive, others: Sequence[NPC]) -> NPC | None:
        """Return a vehicle that would have met the ego and can start beside other vehicles, or None if none was found.

        Meetings with a standing ego do not count, and neither do those in which the vehicle comes from behind while the
        ego keeps its lane. The NPC would be to blame for these collisions.
        """
        routes, kinds = self._logical.roadmap.npc_routes, self._logical.vehicle_types
        for _ in range(_ATTEMPTS):
            route = routes[rng.integers(len(routes))]
            waypoints = self._draw(rng, route)
            whole = rng.random() >= self._options.changing_share or not len(drive.changing.time)
            part = drive if whole else drive.changing
            poses = self._predict(self._logical.roadmap, route, waypoints, part.time)
            meeting = np.flatnonzero(_meets(poses, part, self._options.reach))
            for k in rng.permutation(meeting)[:_CHOICES]:
                kind = kinds[rng.integers(len(kinds))]
                npc = NPC(kind, route.name, tuple(Waypoint(*values) for values in waypoints[k].tolist()))
                if self._logical.first_to_fit([npc], others) is not None:
                    return npc
        return None

    def _draw(self, rng: np.random.Generator, route: Route) -> Floats:
        """Draw waypoints of vehicles, shape (draws, waypoints, 2): positions [m] and speeds [m/s].

        Positions are uniform in their ranges. Half of the vehicles have uniform speeds, as the sampler's vehicles do. A
        quarter have speeds of any order of magnitude, and a quarter one such speed for all waypoints. Slow vehicles
        force an ego to act, and uniform speeds are seldom slow.
        """
        ranges, (slowest, fastest) = self._logical.position_ranges(route), self._logical.speed_range
        waypoints = np.zeros((self._options.draws, len(ranges), 2))
        before = np.zeros(len(waypoints))
        for i, (low, high) in enumerate(ranges):
            before = waypoints[:, i, 0] = rng.uniform(np.maximum(low, before), high)
        share = rng.random(waypoints.shape[:2])
        kind = rng.integers(4, size=len(waypoints))
        share[kind == 3] = share[kind == 3, :1]
        uniform = slowest + share * (fastest - slowest)
        magnitude = slowest * (fastest / slowest) ** share if slowest > 0 else uniform
        waypoints[..., 1] = np.where((kind >= 2)[:, None], magnitude, uniform)
        waypoints[:, -1, 1] = 0.0
        return waypoints


def _meets(poses: Floats, drive: Drive, reach: float) -> NDArray[np.bool_]:
    """Return whether each vehicle meets the ego in a way that the ego would be to blame for, shape (K,).

    `poses` are x, y and heading of each vehicle at the times of the drive, shape (K, F, 3). A vehicle meets
    the ego if their centers come closer than `reach` [m].
    """
    gap = poses[..., :2] - drive.pose[:, :2]
    at = np.hypot(gap[..., 0], gap[..., 1]).argmin(1)
    (x, y), heading = gap[np.arange(len(at)), at].T, drive.pose[at, 2]
    ahead, right = x * np.cos(heading) + y * np.sin(heading), y * np.cos(heading) - x * np.sin(heading)
    is_parallel = np.cos(poses[np.arange(len(at)), at, 2] - heading) > np.cos(REAR_END_ANGLE)
    keeps_lane = np.abs(drive.drift[at]) < DRIFT
    from_behind = (ahead < 0) & is_parallel & (np.abs(right) < HALF_LANE) & keeps_lane
    return np.asarray((np.hypot(x, y) < reach) & ~from_behind & (drive.speed[at] > STANDING_SPEED))
