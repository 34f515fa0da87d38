"""The logical scenarios of the functional scenarios S1 to S4. They are known without importing the simulator.

Source: paper section 4, for the four situations.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from behavexplor.data.scripted_logical import ScriptedLogicalScenario
from behavexplor.envs.roads import crossing, straight_road

INTERSECTION_STRAIGHT: Final = ScriptedLogicalScenario(
    name="intersection-straight",
    roadmap=crossing("straight", ego_start=20.0, destination=60.0),
    n_npcs=5,
    waypoints_per_lane=2,
)
INTERSECTION_LEFT: Final = ScriptedLogicalScenario(
    name="intersection-left",
    roadmap=crossing("left", ego_start=10.0, destination=60.0),
    n_npcs=5,
    waypoints_per_lane=2,
)
LANE_FOLLOW: Final = ScriptedLogicalScenario(
    name="lane-follow",
    roadmap=straight_road(start_lane=2, target_lane=2, ego_start=10.0, destination=230.0),
    n_npcs=6,
    waypoints_per_lane=4,
)
LANE_CHANGE: Final = ScriptedLogicalScenario(
    name="lane-change",
    roadmap=straight_road(start_lane=1, target_lane=3, ego_start=10.0, destination=230.0),
    n_npcs=6,
    waypoints_per_lane=4,
)

LOGICAL_SCENARIOS: Final[Mapping[str, ScriptedLogicalScenario]] = MappingProxyType(
    {logical.name: logical for logical in (INTERSECTION_STRAIGHT, INTERSECTION_LEFT, LANE_FOLLOW, LANE_CHANGE)}
)
