"""S4: the ego changes lanes, two to the right, on a straight road of four lanes."""

from behavexplor.envs.driving import DrivingEnv
from behavexplor.envs.roads import straight_road
from behavexplor.envs.vector import vector_env
from behavexplor.logical import LogicalScenario


class LaneChangeEnv(DrivingEnv):
    """The ego changes two lanes to the right on a straight road of four lanes (S4).

    ![S4](lane-change.png)

    The road of S3. The ego starts in the second lane from the left; its destination lies 220 m further on in the
    rightmost lane.

    | | |
    |---|---|
    | ego's way | 220 m and two lanes (7 m) to the right |
    | NPCs | 6, each on one of the four lanes |
    | waypoints | 4 on each of a route's 2 lanes; the last one, where the NPC parks, lies behind the ego's destination |
    | illegal lines | the double yellow line on the left, the curbs on both sides |
    | speed limit | 11.176 m/s (25 mph) |

    ## Version history

    - v0: first version.
    """

    logical = LogicalScenario(
        name="lane-change",
        roadmap=straight_road(start_lane=1, target_lane=3, ego_start=10.0, destination=230.0),
        n_npcs=6,
        waypoints_per_lane=4,
    )


LaneChangeVectorEnv = vector_env(LaneChangeEnv)
