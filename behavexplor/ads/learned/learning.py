"""The training environment of a policy, with features and actions in place of scenes and commands."""

import gymnasium
import numpy as np
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from behavexplor.ads.learned.deciding import N_ACTIONS, N_MEMORIES, as_decisions
from behavexplor.ads.learned.driver import CourseKernels
from behavexplor.ads.learned.observation import N_FEATURES
from behavexplor.ads.learned.route_table import make_course
from behavexplor.data.array_types import Array, Floats, Singles
from behavexplor.data.roadmap import RoadMap


class LearningVecEnv(VecEnvWrapper):
    """A vector environment with features as observations, shape (N_FEATURES,), and N_ACTIONS discrete actions.

    `venv` observes `Scene` and takes the commands of `behavexplor.ads.learned.driver`, at that driver's frequency.
    """

    def __init__(self, venv: VecEnv, roadmap: RoadMap) -> None:
        space = gymnasium.spaces.Box(-np.inf, np.inf, (N_FEATURES,), np.float32)
        super().__init__(venv, space, gymnasium.spaces.Discrete(N_ACTIONS))
        self.roadmap = roadmap
        self._kernels = CourseKernels(make_course(roadmap))
        self._memory = np.zeros((venv.num_envs, N_MEMORIES))
        self._scenes: Floats = np.zeros(0)

    def reset(self) -> Singles:
        """Begin an episode in every sub-environment."""
        self._memory[:] = 0.0
        self._scenes = np.ascontiguousarray(self.venv.reset(), dtype=np.float64)
        return self._see()

    def step_async(self, actions: Array) -> None:
        """Pass on the commands for the actions, shape (num_envs,)."""
        chosen = np.asarray(actions, dtype=np.int64)
        self.venv.step_async(self._kernels.track(self._scenes, as_decisions(chosen), self._memory))

    def step_wait(self) -> VecEnvStepReturn:
        """Advance all sub-environments to the next decision."""
        scenes, rewards, dones, infos = self.venv.step_wait()
        self._scenes = np.ascontiguousarray(scenes, dtype=np.float64)
        for i in np.flatnonzero(dones):
            last = np.ascontiguousarray(infos[i]["terminal_observation"], dtype=np.float64)[None]
            infos[i]["terminal_observation"] = self._kernels.see(last, self._memory[i : i + 1])[0].astype(np.float32)
            self._memory[i] = 0.0
        return self._see(), rewards, dones, infos

    def _see(self) -> Singles:
        return self._kernels.see(self._scenes, self._memory).astype(np.float32)
