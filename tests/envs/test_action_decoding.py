import numpy as np
import pytest

from behavexplor.envs.engine.actions import make_commands
from behavexplor.envs.functional import LaneFollowEnv

RANGES = {"acceleration_range": [-3.3, 4.7], "steering_range": [-0.1, 0.77]}


def continuous(**changes):
    return LaneFollowEnv({"action": {"type": "ContinuousAction", **RANGES, **changes}}).action_type


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, np.longdouble, np.int64])
@pytest.mark.parametrize("changes", [{}, {"lateral": False}, {"longitudinal": False}, {"clip": False}])
def test_commands_are_those_of_highway_env_to_the_last_bit(changes, dtype):
    action_type = continuous(**changes)
    actions = (np.random.default_rng(0).normal(size=(200, *action_type.space().shape)) * 1.5).astype(dtype)
    commands = make_commands(action_type)(actions)
    for action, command in zip(actions, commands, strict=True):
        wanted = action_type.get_action(action)
        assert command.tolist() == [float(wanted["acceleration"]), float(wanted["steering"])]
