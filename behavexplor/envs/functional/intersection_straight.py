"""S1: the ego goes straight through a non-signalised crossing."""

from behavexplor.envs.driving import DrivingEnv
from behavexplor.envs.roads import crossing
from behavexplor.envs.vector import vector_env
from behavexplor.logical import LogicalScenario


class IntersectionStraightEnv(DrivingEnv):
    """The ego goes straight through a non-signalised crossing (S1).

    ![S1](intersection-straight.png)

    Two roads with two lanes in each direction cross; nobody has the right of way, and NPCs yield to nobody. The ego
    comes from the south on the inner lane, starts 70 m before the stop line, and has arrived 60 m behind the crossing.

    | | |
    |---|---|
    | ego's way | 160 m, straight |
    | NPCs | 5, each on one of 16 routes: from every approach lane, its two ways on |
    | waypoints | 2 on each of a route's 4 lanes; the last one, where the NPC parks, lies behind the ego's destination |
    | illegal lines | the double yellow lines between the directions, the curbs, also round the corners |
    | speed limit | 11.176 m/s (25 mph) |

    ## Version history

    - v0: first version.
    """

    logical = LogicalScenario(
        name="intersection-straight",
        roadmap=crossing("straight", ego_start=20.0, destination=60.0),
        n_npcs=5,
        waypoints_per_lane=2,
    )


IntersectionStraightVectorEnv = vector_env(IntersectionStraightEnv)
