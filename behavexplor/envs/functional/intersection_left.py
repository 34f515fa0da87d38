"""S2: the ego turns left at a non-signalised crossing."""

from behavexplor.envs.driving import DrivingEnv
from behavexplor.envs.roads import crossing
from behavexplor.logical import LogicalScenario


class IntersectionLeftEnv(DrivingEnv):
    """The ego turns left at a non-signalised crossing; see `behavexplor.envs.driving.DrivingEnv`."""

    logical = LogicalScenario(
        name="intersection-left",
        roadmap=crossing("left", ego_start=10.0, destination=60.0),
        n_npcs=5,
        waypoints_per_lane=2,
    )
