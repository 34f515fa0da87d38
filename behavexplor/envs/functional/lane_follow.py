"""S3: the ego follows its lane on a straight road of four lanes."""

from behavexplor.envs.driving import DrivingEnv
from behavexplor.envs.roads import straight_road
from behavexplor.logical import LogicalScenario


class LaneFollowEnv(DrivingEnv):
    """The ego follows its lane on a straight road of four lanes; see `behavexplor.envs.driving.DrivingEnv`."""

    logical = LogicalScenario(
        name="lane-follow",
        roadmap=straight_road(start_lane=2, target_lane=2, ego_start=10.0, destination=230.0),
        n_npcs=6,
        waypoints_per_lane=4,
    )
