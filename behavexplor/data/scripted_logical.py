"""Logical scenarios of scripted vehicles: ranges of concrete scenarios on a map, with their mutations and encoding.

Source: paper section 2.2, for the parameters that are searched (the NPCs' routes and waypoints).
"""

from dataclasses import replace
from functools import cached_property
from typing import Final

import numpy as np

from behavexplor.data.logical import Mutations, Noise
from behavexplor.data.parts import Parts
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.data.scripted_encoding import ScriptedEncoding
from behavexplor.data.scripted_mutation import mutate_routes, mutate_waypoints
from behavexplor.data.scripted_parts import part_of, vehicle_of
from behavexplor.data.scripted_ranges import ScriptedRanges
from behavexplor.data.trace import Trace
from behavexplor.data.vehicle_sizes import EGO_SIZE, VEHICLE_SIZES
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
        """Return the vehicles of a scenario as parts; see `behavexplor.data.scripted_parts`."""
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
        InputError: if it is one of a stock environment.
    """
    if not isinstance(logical, ScriptedLogicalScenario):
        raise InputError(f"{what} needs one of the environments with scripted vehicles, such as intersection-straight")
    return logical
