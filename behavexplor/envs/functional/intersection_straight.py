"""S1: the ego goes straight through a non-signalised crossing."""

from behavexplor.envs.driving import DrivingEnv
from behavexplor.envs.roads import crossing
from behavexplor.logical import LogicalScenario


class IntersectionStraightEnv(DrivingEnv):
    """The ego goes straight through a non-signalised crossing; see `behavexplor.envs.driving.DrivingEnv`."""

    logical = LogicalScenario(
        name="intersection-straight",
        roadmap=crossing("straight", ego_start=20.0, destination=60.0),
        n_npcs=5,
        waypoints_per_lane=2,
    )
