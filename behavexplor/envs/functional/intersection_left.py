"""S2: the ego turns left at a non-signalised crossing."""

from behavexplor.envs.driving import DrivingEnv
from behavexplor.envs.roads import crossing
from behavexplor.envs.vector import vector_env
from behavexplor.logical import LogicalScenario


class IntersectionLeftEnv(DrivingEnv):
    """The ego turns left at a non-signalised crossing (S2).

    ![S2](intersection-left.png)

    The crossing of S1. The ego comes from the south on the inner lane, starts 80 m before the stop line, turns left,
    across the way of those who come towards it, and has arrived 60 m behind the crossing.

    | | |
    |---|---|
    | ego's way | 166 m, a left turn of 16.75 m radius |
    | NPCs | 5, each on one of 16 routes: from every approach lane, its two ways on |
    | waypoints | 2 on each of a route's 4 lanes; the last one, where the NPC parks, lies behind the ego's destination |
    | illegal lines | the double yellow lines between the directions, the curbs, also round the corners |
    | speed limit | 11.176 m/s (25 mph) |

    ## Version history

    - v0: first version.
    """

    logical = LogicalScenario(
        name="intersection-left",
        roadmap=crossing("left", ego_start=10.0, destination=60.0),
        n_npcs=5,
        waypoints_per_lane=2,
    )


IntersectionLeftVectorEnv = vector_env(IntersectionLeftEnv)
