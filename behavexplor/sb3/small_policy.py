"""A small policy for a first look at fuzzing, trained in less than a minute on the compiled highway."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import yaml
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env

from behavexplor.data.durable import write_durably, write_saved
from behavexplor.envs.sb3_vec_env import HighwayVecEnv

ENV: Final = "highway-fast-v0"
# highway-env's own, said in the model's YAML file
_CONFIG: Final = {"lanes_count": 3, "vehicles_count": 20, "duration": 30}
_ENVS: Final = 32
_SETTINGS: Final = {"n_steps": 32, "batch_size": 256, "n_epochs": 10, "gamma": 0.9, "learning_rate": 1e-3}


def train_small_policy(folder: Path, steps: int, observe: Callable[[int], None]) -> Path:
    """Train a small policy with PPO on highway-fast-v0, and return the model's file.

    The folder gets this file and one that describes it. `observe` gets the number of training steps so far.
    """
    compiled: Any = HighwayVecEnv
    envs = make_vec_env(ENV, _ENVS, seed=0, env_kwargs={"config": _CONFIG}, vec_env_cls=compiled)
    model = PPO("MlpPolicy", envs, seed=0, device="cpu", **_SETTINGS)  # type: ignore[arg-type]
    model.learn(steps, callback=_Watch(observe))
    envs.close()
    path = folder / "model.zip"
    write_saved(path, model.save)
    write_durably(path.with_suffix(".yaml"), yaml.safe_dump({"env": ENV, "config": _CONFIG}))
    return path


class _Watch(BaseCallback):
    def __init__(self, observe: Callable[[int], None]) -> None:
        super().__init__()
        self._observe = observe

    def _on_step(self) -> bool:
        self._observe(self.num_timesteps)
        return True
