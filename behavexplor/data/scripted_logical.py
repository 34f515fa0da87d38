"""Logical scenarios of scripted vehicles: ranges of concrete scenarios on a map, with their mutations and encoding.

Source: paper section 2.2, for the parameters that are searched (the NPCs' routes and waypoints).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, Final

import numpy as np

from behavexplor.data.conventions import EGO_SIZE, VEHICLE_SIZES
from behavexplor.data.logical import Mutations, Noise, Part, Parts, Value
from behavexplor.data.scripted import NPC, ScriptedScenario, Waypoint
from behavexplor.data.scripted_encoding import ScriptedEncoding, mutate_routes, mutate_waypoints
from behavexplor.data.scripted_ranges import ScriptedRanges
from behavexplor.data.trace import Trace
from behavexplor.errors import InputError

WAYPOINTS: Final = "waypoints"
ROUTES: Final = "routes"


class ScriptedLogicalScenario(ScriptedRanges):
    """The parameters of a functional scenario and their ranges; see `behavexplor.data.logical.LogicalScenario`."""

    @cached_property
    def encoding(self) -> ScriptedEncoding:
        """The encoding of scenarios as vectors.

        Raises:
            InputError: if a scenario has no NPCs.
        """
        return ScriptedEncoding(self)

    @property
    def has_original(self) -> bool:
        """False: highway-env has no scripted vehicles."""
        return False

    @property
    def config(self) -> Mapping[str, Any]:
        """Nothing: the scripts hold in every configuration."""
        return {}

    def to_json(self) -> str:
        """Return nothing: the name of the environment says all."""
        return ""

    @property
    def removable(self) -> bool:
        """True: a scenario may have fewer vehicles."""
        return True

    @property
    def mutations(self) -> Mutations:
        """Names of the paper's mutations."""
        return Mutations(WAYPOINTS, ROUTES)

    @property
    def line_kinds(self) -> tuple[str, ...]:
        """The kinds of the illegal lines in a trace."""
        return tuple(self.roadmap.line_kinds)

    def adopted(self, scenario: ScriptedScenario) -> ScriptedScenario:
        """Return the scenario of another driver, which is the same for every driver.

        Raises:
            InputError: if it is not valid here.
        """
        self.check(scenario)
        return scenario

    def mutate_little(self, scenario: ScriptedScenario, rng: np.random.Generator, noise: Noise) -> ScriptedScenario:
        """Return a mutant by noise on the waypoints of some NPCs; see `mutate_waypoints`."""
        return mutate_waypoints(
            scenario,
            self,
            rng,
            keep_probability=noise.keep_probability,
            sigma_position=noise.sigma_position,
            sigma_speed=noise.sigma_speed,
            point_keep_probability=noise.point_keep_probability,
        )

    def mutate_much(
        self, scenario: ScriptedScenario, rng: np.random.Generator, keep_probability: float
    ) -> ScriptedScenario:
        """Return a mutant by new types, routes and waypoints for some NPCs; see `mutate_routes`."""
        return mutate_routes(scenario, self, rng, keep_probability=keep_probability)

    def first_frame(self, scenario: ScriptedScenario, end: str) -> Trace:
        """Return the trace of an episode that ended before any vehicle moved.

        Args:
            scenario: a valid scenario.
            end: kind of end, one of `behavexplor.data.trace.ENDS`.
        """
        roadmap = self.roadmap
        poses = np.stack([roadmap.start_pose, *map(self.start_pose_of, scenario.npcs)])
        speeds = np.array([0.0, *(npc.waypoints[0].speed for npc in scenario.npcs)])
        heading = poses[:, 2]
        return Trace(
            time=np.zeros(1),
            position=poses[None, :, :2],
            heading=heading[None],
            velocity=speeds[None, :, None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1),
            size=np.array([EGO_SIZE, *(VEHICLE_SIZES[npc.type] for npc in scenario.npcs)]),
            actions=np.zeros((0, 1)),
            action_frame=np.zeros(0, dtype=np.int64),
            route=roadmap.ego_line,
            destination=roadmap.destination_point,
            illegal_lines=roadmap.illegal_lines,
            end=end,
        )

    def describe(self, scenario: ScriptedScenario) -> str:
        """Return a short description: the number of NPCs and their routes."""
        routes = [npc.route for npc in scenario.npcs]
        listed = ", ".join(f"{routes.count(route)} on {route}" for route in dict.fromkeys(routes))
        return f"{len(routes)} NPCs: {listed}" if routes else "no NPCs"

    def parts(self, scenario: ScriptedScenario) -> Parts:
        """Return the vehicles of a scenario as parts; see `behavexplor.data.scripted_logical`."""
        return tuple(part_of(npc, self) for npc in scenario.npcs)

    def with_parts(self, scenario: ScriptedScenario, parts: Parts) -> ScriptedScenario:
        """Return a scenario with other vehicles.

        Raises:
            InputError: if the vehicles are not valid.
        """
        changed = replace(scenario, npcs=tuple(vehicle_of(part, self) for part in parts))
        self.check(changed)
        return changed


def scripted(logical: object, what: str) -> ScriptedLogicalScenario:
    """Return a logical scenario of scripted vehicles as what it is.

    Args:
        logical: any logical scenario.
        what: what needs scripted vehicles, for the error message.

    Raises:
        InputError: if it is one of a highway-env environment.
    """
    if not isinstance(logical, ScriptedLogicalScenario):
        raise InputError(f"{what} needs one of the environments with scripted vehicles, such as intersection-straight")
    return logical


def part_of(npc: NPC, ranges: ScriptedRanges) -> Part:
    """Return a vehicle as a part: its type, the positions of all waypoints, and the speeds of all but the last one."""
    positions, speeds = [], []
    before = Waypoint(0.0, ranges.speed_range[1])
    for waypoint, plain in zip(npc.waypoints, _middles(npc.route, ranges), strict=True):
        positions.append(_unless(waypoint.position, max(plain, before.position)))
        speeds.append(_unless(waypoint.speed, before.speed))
        before = waypoint
    kind = None if npc.type == ranges.vehicle_types[0] else npc.type
    return Part(npc.route, (kind, *positions, *speeds[:-1]))


def vehicle_of(part: Part, ranges: ScriptedRanges) -> NPC:
    """Return the vehicle of a part. This is the inverse of `part_of`.

    Raises:
        InputError: if the route is unknown, or the values are not those of a vehicle on this route.
    """
    middles = _middles(part.label, ranges)
    if len(part.values) != 2 * len(middles):
        raise InputError(f"{part.label}: a vehicle on this route has {2 * len(middles)} values")
    kind, *numbers = part.values
    waypoints: list[Waypoint] = []
    at, speed = 0.0, ranges.speed_range[1]
    for plain, position, pace in zip(middles, numbers[: len(middles)], [*numbers[len(middles) :], 0.0], strict=True):
        at = _number(position, max(plain, at))
        speed = _number(pace, speed)
        waypoints.append(Waypoint(at, speed))
    return NPC(ranges.vehicle_types[0] if kind is None else str(kind), part.label, tuple(waypoints))


def _middles(route: str, ranges: ScriptedRanges) -> Sequence[float]:
    """Return the plain position of each waypoint on a route, regardless of the waypoints before it."""
    if route not in ranges.roadmap.routes:
        raise InputError(f"route: there is no route {route!r}")
    bounds = ranges.position_ranges(ranges.roadmap.routes[route])
    return [*bounds[:-1].mean(axis=1).tolist(), float(bounds[-1, 1])]


def _unless(value: float, plain: float) -> float | None:
    return None if value == plain else value


def _number(value: Value, plain: float) -> float:
    return plain if value is None else float(value)
