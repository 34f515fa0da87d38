"""Scenes: what an exchanged file says about one execution, in this package's frame; and the table of a trace.

`openscenario` writes scenes to files, `scene_reading` reads them from files, and `restoring` makes scenarios of them.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from behavexplor.data.array_types import Floats
from behavexplor.data.conventions import EPISODE_TIME
from behavexplor.data.csv_text import csv_text
from behavexplor.data.durable import write_durably
from behavexplor.data.npc_motion import HEADING, SPEED, X, Y, motion_table
from behavexplor.data.roadmap import RoadMap
from behavexplor.data.scenario import LogicalScenario, Scenario
from behavexplor.data.scripted import NPC, Waypoint
from behavexplor.data.scripted_logical import require_scripted
from behavexplor.data.trace import Trace
from behavexplor.errors import InputError, brief
from behavexplor.exchange.axes import DIGITS, mirrored, mirrored_points

EGO: Final = "Ego"  # name of the ego; the other vehicles are NPC1, NPC2, ...
VEHICLE: Final = "vehicle"  # type of a vehicle that is not scripted
_PERIOD: Final = 0.05  # time between the points of a trajectory that goes on after the episode [s]
_DIGEST_LENGTH: Final = 16  # hexadecimal digits
ENVIRONMENT: Final = "behavexplor:environment"  # names of the properties of a file
ENV_CONFIG: Final = "behavexplor:env_config"
SCENARIO: Final = "behavexplor:scenario"
VEHICLES: Final = "behavexplor:vehicles"
ROUTE: Final = "behavexplor:route"  # names of the properties of a vehicle
WAYPOINTS: Final = "behavexplor:waypoints"
RECORDED: Final = "behavexplor:recorded"
# columns of the table of a trace
COLUMNS: Final = ("time", "vehicle", "type", "x", "y", "heading", "vx", "vy", "length", "width")


@dataclass(frozen=True, eq=False)
class Mover:
    """A vehicle of a scene."""

    name: str  # unique name
    type: str  # type of a scripted vehicle, such as "sedan", or `VEHICLE`
    size: tuple[float, float]  # length and width [m]
    time: Floats  # times at which its pose is known, increasing, shape (T,) [s]; T >= 1
    pose: Floats  # x [m], y [m] and heading [rad] of its center at these times, shape (T, 3)
    speed: float  # speed at the first of these times [m/s]
    is_gone: bool = False  # whether it leaves the scene after the last of these times, before the scene ends
    script: NPC | None = None  # its route and waypoints; None if it is not scripted
    # points of its route as they are written, shape (P, 2) [m]; empty if it is not scripted
    route: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    center: tuple[float, float] = (0.0, 0.0)  # its center relative to the file's reference point: along, across [m]
    is_changed: bool = False  # whether its numbers in a file differ from those that were written, see `motion_digest`


@dataclass(frozen=True, eq=False)
class SceneFile:
    """What an exchanged file says of one execution."""

    title: str  # a sentence for people
    environment: str  # name of the environment
    # configuration of the environment, as far as it differs from what the driving system declares
    env_config: Mapping[str, Any] = field(default_factory=dict)
    road_file: str = ""  # name of the road's file, beside the scene's
    movers: tuple[Mover, ...] = ()  # the vehicles; the ego first
    is_ego_free: bool = False  # whether the ego is driven by another tool's driver, so that only its start is known
    destination: Floats = field(default_factory=lambda: np.zeros(2))  # destination of the ego, shape (2,) [m]
    stops_there: bool = False  # whether the scene ends when the ego arrives
    time_limit: float = EPISODE_TIME  # time at which the scene ends [s]
    scenario: Scenario | None = None  # the scenario, if its vehicles are not scripted; see `behavexplor.data.scenario`
    n_vehicles: int = 0  # number of vehicles that were written
    is_changed: bool = False  # whether the scenario in a file differs from the one that was written


def motion_digest(mover: Mover, rows: Floats, *drive: Floats) -> str:
    """Return a digest of all numbers in a file that count for a vehicle, which tells whether they were changed.

    `rows` has the times and poses of its reference point, shape (T, 4); `drive` the points of its route and its speed
    profile, if the file has them. The size and the center of a scripted vehicle do not count, because its type
    determines them. Its speed at the start does not count if there is a trajectory, which determines it.
    """
    is_scripted = mover.script is not None
    numbers: list[ArrayLike] = [rows, *drive]
    if not is_scripted or len(rows) == 1:
        numbers.append(mover.speed)
    if not is_scripted:
        numbers += [mover.size, mover.center]
    flat = np.concatenate([np.asarray(part, dtype=np.float64).ravel() for part in numbers])
    return _digest(flat.tobytes())


def scenario_digest(scenario: Scenario, n_vehicles: int) -> str:
    """Return a digest of a scenario and its number of vehicles, which tells whether they were changed."""
    return _digest(f"{n_vehicles} {scenario.to_json()}".encode())


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:_DIGEST_LENGTH]


def vehicle_name(i: int) -> str:
    """Return the name of the vehicle with a number in a trace, of which the ego has 0."""
    return EGO if i == 0 else f"NPC{i}"


def vehicle_type(scenario: Scenario, i: int) -> str:
    """Return the type of the vehicle with a number in a trace."""
    return scenario.npcs[i - 1].type if scenario.npcs and i > 0 else VEHICLE


def movers_of(scenario: Scenario, trace: Trace, logical: LogicalScenario, *, is_ego_free: bool) -> tuple[Mover, ...]:
    """Return the vehicles of an execution.

    With a free ego, of which only the start is of interest, the scene may take longer than the execution. So scripted
    vehicles go on until they park.
    """
    speed = np.hypot(trace.velocity[..., 0], trace.velocity[..., 1])
    pose = np.concatenate([trace.position, trace.heading[..., None]], axis=2)
    movers = []
    for i, size in enumerate(trace.size.tolist()):
        there = np.flatnonzero(trace.present[:, i]) if trace.present.size else np.arange(len(trace.time))
        frames = there[:1] if i == 0 and is_ego_free else there
        movers.append(
            Mover(
                name=vehicle_name(i),
                type=vehicle_type(scenario, i),
                size=(size[0], size[1]),
                time=trace.time[frames],
                pose=pose[frames, i],
                speed=float(speed[there[0], i]),
                is_gone=bool(there[-1] < len(trace.time) - 1),
            )
        )
    if not scenario.npcs:  # not scripted, or without NPCs
        return tuple(movers)
    roadmap = require_scripted(logical, "A scene of scripted vehicles").roadmap
    scripted_movers = [
        replace(mover, script=npc, route=_route_points(npc, roadmap))
        for mover, npc in zip(movers[1:], scenario.npcs, strict=True)
    ]
    if is_ego_free:
        scripted_movers = _until_parked(scenario, roadmap, scripted_movers)
    return (movers[0], *scripted_movers)


def _route_points(npc: NPC, roadmap: RoadMap) -> Floats:
    """Return points of a vehicle's route as they are written, shape (P, 2) [m].

    They are the start and the place where it parks. Points between them, at the ends of lanes and in junctions, would
    belong to several roads.
    """
    route = roadmap.routes[npc.route]
    points = route.pose(np.array([npc.waypoints[0].position, npc.waypoints[-1].position]))[:, :2]
    return np.asarray(np.round(mirrored_points(points), DIGITS) + 0.0)  # no negative zeros


def _until_parked(scenario: Scenario, roadmap: RoadMap, movers: list[Mover]) -> list[Mover]:
    """Return scripted vehicles with their motion until the last one parks."""
    time = np.arange(0.0, EPISODE_TIME + _PERIOD / 2, _PERIOD)
    motion = motion_table(scenario, roadmap, time)
    moving = np.flatnonzero((motion[..., SPEED] > 0).any(1))
    last = min(int(moving[-1]) + 2, len(time)) if len(moving) else 1
    return [
        replace(mover, time=time[:last], pose=motion[:last, i][:, [X, Y, HEADING]]) for i, mover in enumerate(movers)
    ]


def write_table(scenario: Scenario, trace: Trace, path: Path) -> None:
    """Write a trace as a CSV table with the columns `COLUMNS`: one row for each frame and vehicle present in it."""
    pose = mirrored(np.concatenate([trace.position, trace.heading[..., None]], axis=2))
    motion = np.concatenate([pose, mirrored_points(trace.velocity)], axis=2)
    motion = np.round(motion, DIGITS) + 0.0  # no negative zeros
    present = trace.present if trace.present.size else np.ones(trace.heading.shape, dtype=bool)
    names = [(vehicle_name(i), vehicle_type(scenario, i)) for i in range(len(trace.size))]
    sizes, times = trace.size.tolist(), np.round(trace.time, DIGITS).tolist()
    rows = (
        [times[frame], *names[i], *motion[frame, i].tolist(), *sizes[i]] for frame, i in np.argwhere(present).tolist()
    )
    write_durably(path, csv_text(chain([COLUMNS], rows)))


def waypoint_text(script: NPC) -> str:
    """Return waypoints as a text that people can change, "position speed, position speed, ..." [m, m/s]."""
    return ", ".join(f"{waypoint.position!r} {waypoint.speed!r}" for waypoint in script.waypoints)


def read_script(name: str, kind: str, route: str, text: str) -> NPC:
    """Return a scripted vehicle of type `kind`, on the route named `route`, with the waypoints of a text.

    The text is as `waypoint_text` writes it. `name` is the vehicle's name in its scene, for error messages.

    Raises:
        InputError: if the text does not describe waypoints.
    """
    waypoints = []
    for pair in text.split(","):
        try:
            position, speed = map(float, pair.split())
        except ValueError:
            raise InputError(
                f"{name}: a waypoint is a position [m] and a speed [m/s], separated by a space, got {brief(pair)}"
            ) from None
        waypoints.append(Waypoint(position, speed))
    return NPC(kind, route, tuple(waypoints))
