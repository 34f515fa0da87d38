"""A road that is crossed where the ego starts: who comes from there leaves it no time."""

import math

import gymnasium
import numpy as np

from behavexplor.data.roadmap import CURB, Lane, RoadMap, Route
from behavexplor.data.scripted_logical import ScriptedLogicalScenario
from behavexplor.envs.driving import DrivingEnv
from behavexplor.envs.vector_env import vector_env

NAME = "tests/Crossing-v0"
EGO_START, CROSSED_AT = 20.0, 21.7  # stations on the ego's lane [m]


def _roadmap():
    along = Lane("along", "west", "east", 0.0, 0.0, 0.0, 200.0, 3.5)
    across = Lane("across", "north", "south", CROSSED_AT, -40.0, math.pi / 2, 120.0, 3.5)
    route = Route("along", (along,))
    return RoadMap(
        lanes=(along, across),
        npc_routes=(route, Route("across", (across,))),
        ego_route=route,
        ego_start=EGO_START,
        destination=150.0,
        illegal_lines=np.array([[(0.0, 60.0), (200.0, 60.0)]]),
        line_kinds=(CURB,),
        speed_limit=11.0,
    )


class CrossingEnv(DrivingEnv):
    """A lane, and another across it."""

    logical = ScriptedLogicalScenario(name="crossing", roadmap=_roadmap(), n_npcs=2, waypoints_per_lane=3)


CrossingVectorEnv = vector_env(CrossingEnv)


def register():
    """Make the environment known by its name."""
    if NAME not in gymnasium.registry:
        module = "tests.triage.crossing"
        gymnasium.register(NAME, entry_point=f"{module}:CrossingEnv", vector_entry_point=f"{module}:CrossingVectorEnv")
