"""S3: the ego follows its lane on a straight road with four lanes."""

from behavexplor.data.scripted_logical import ScriptedLogicalScenario
from behavexplor.envs.driving import DrivingEnv
from behavexplor.envs.roads import straight_road
from behavexplor.envs.vector import vector_env


class LaneFollowEnv(DrivingEnv):
    """The ego follows its lane on a straight road with four lanes (S3).

    ![S3](lane-follow.png)

    Four lanes run in the ego's direction, and the ego starts in the third from the left. The lanes of the opposite
    direction lie beyond the double yellow line.

    ## Version history

    - v0: first version.
    """

    logical = ScriptedLogicalScenario(
        name="lane-follow",
        roadmap=straight_road(start_lane=2, target_lane=2, ego_start=10.0, destination=230.0),
        n_npcs=6,
        waypoints_per_lane=4,
    )


LaneFollowVectorEnv = vector_env(LaneFollowEnv)
