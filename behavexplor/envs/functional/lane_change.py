"""S4: the ego changes lanes, two to the right, on a straight road of four lanes."""

from behavexplor.envs.driving import DrivingEnv
from behavexplor.envs.roads import straight_road
from behavexplor.logical import LogicalScenario


class LaneChangeEnv(DrivingEnv):
    """The ego changes two lanes to the right on a four-lane road; see `behavexplor.envs.driving.DrivingEnv`."""

    logical = LogicalScenario(
        name="lane-change",
        roadmap=straight_road(start_lane=1, target_lane=3, ego_start=10.0, destination=230.0),
        n_npcs=6,
        waypoints_per_lane=4,
    )
