"""Trains the policies of the experiments in stock environments: python docs/stock_policies.py [FOLDER].

Each is trained on the compiled engine, with a seed, in one thread. The zip files of Stable-Baselines3 hold the time of
the training, so they differ from one training to the next; the weights do not on the same machine.
"""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import highway_env  # noqa: F401 - registers the environments
import torch
import yaml
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.env_util import make_vec_env

from behavexplor.envs.sb3_vec_env import HighwayVecEnv

FOLDER = Path(__file__).parent / "data" / "policies"
N_ENVS = 32
_PPO = {"n_steps": 32, "batch_size": 256, "n_epochs": 10, "gamma": 0.9, "learning_rate": 1e-3}
_DQN = {"learning_rate": 5e-4, "gamma": 0.8, "train_freq": 1, "gradient_steps": 4, "target_update_interval": 50}


@dataclass(frozen=True)
class Training:
    """The training of a policy.

    Attributes:
        env: gymnasium id of the environment.
        algorithm: algorithm of Stable-Baselines3.
        steps: number of steps.
        config: configuration of the environment.
        settings: settings of the algorithm.
    """

    env: str
    algorithm: type[PPO] | type[DQN]
    steps: int
    config: dict[str, Any]
    settings: dict[str, Any] = field(default_factory=lambda: _PPO)


TRAININGS = {
    "highway-fast": Training(
        "highway-fast-v0",
        PPO,
        100_000,
        {"lanes_count": 4, "duration": 40, "collision_reward": -4, "high_speed_reward": 0.2},
    ),
    "merge": Training("merge-v0", DQN, 40_000, {"collision_reward": -3}, _DQN),
    "roundabout": Training("roundabout-v0", PPO, 60_000, {"duration": 15}),
    "intersection": Training("intersection-v0", PPO, 400_000, {"collision_reward": -15}),
}


def train(training: Training, path: Path) -> None:
    """Train a policy and save it, with a file that says where it was trained."""
    compiled: Any = HighwayVecEnv
    envs = make_vec_env(training.env, N_ENVS, seed=0, env_kwargs={"config": training.config}, vec_env_cls=compiled)
    model = training.algorithm("MlpPolicy", envs, seed=0, device="cpu", **training.settings)
    model.learn(training.steps)
    envs.close()
    model.save(path)
    path.with_suffix(".yaml").write_text(yaml.safe_dump({"env": training.env, "config": training.config}))


if __name__ == "__main__":
    torch.set_num_threads(1)
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    for name, training in TRAININGS.items():
        train(training, folder / f"{name}.zip")
        print(f"{name}: {training.algorithm.__name__}, {training.steps} steps in {training.env}")
