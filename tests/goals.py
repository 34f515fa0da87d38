"""An environment with observations that are dictionaries, as highway-env's parking-v0 has them: `tests/goals-v0`."""

import gymnasium
import numpy as np

from behavexplor.envs.functional import LaneFollowEnv
from behavexplor.envs.vector_env import DrivingVectorEnv

NAME = "tests.goals:tests/goals-v0"
SPACE = gymnasium.spaces.Dict(
    {
        "achieved_goal": gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float32),
        "desired_goal": gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float32),
        "observation": gymnasium.spaces.Box(-np.inf, np.inf, (7, 5), np.float32),
    }
)


def with_goals(rows):
    """Observations with goals, one or a batch, from observations of the type Kinematics."""
    place = rows[..., 0, 1:3].copy()
    return {"observation": rows, "achieved_goal": place, "desired_goal": np.ones_like(place)}


class GoalEnv(LaneFollowEnv):
    def __init__(self, config=None, render_mode=None):
        super().__init__(config, render_mode)
        self.observation_space = SPACE

    def reset(self, *, seed=None, options=None):
        rows, info = super().reset(seed=seed, options=options)
        return with_goals(rows), info

    def step(self, action):
        rows, *rest = super().step(action)
        return with_goals(rows), *rest


class GoalVectorEnv(DrivingVectorEnv):
    env_class = LaneFollowEnv

    def __init__(self, *arguments, **keywords):
        super().__init__(*arguments, **keywords)
        self.single_observation_space = SPACE

    def reset(self, *, seed=None, options=None):
        rows, infos = super().reset(seed=seed, options=options)
        return with_goals(rows), infos

    def step(self, actions):
        rows, *rest = super().step(actions)
        return with_goals(rows), *rest


class Aimless:
    """Accelerates toward its goal, and spoils what it was shown."""

    action = {"type": "ContinuousAction"}
    vectorized = True

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        ahead = observation["desired_goal"] - observation["achieved_goal"]
        assert set(observation) == set(SPACE)
        actions = np.stack([np.clip(ahead[:, 0], -1, 1), np.zeros(len(ahead))], axis=1)
        observation.pop("achieved_goal")
        return actions, state


gymnasium.register("tests/goals-v0", entry_point=GoalEnv, vector_entry_point=GoalVectorEnv)
