"""Trains the policies of the experiments in stock environments: python docs/stock_policies.py [FOLDER [SET]].

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
from stable_baselines3 import A2C, DQN, PPO
from stable_baselines3.common.env_util import make_vec_env

from behavexplor.envs.sb3_vec_env import HighwayVecEnv

FOLDER = Path(__file__).parent / "data" / "policies"
N_ENVS = 32
_PPO = {"n_steps": 32, "batch_size": 256, "n_epochs": 10, "gamma": 0.9, "learning_rate": 1e-3}
_A2C = {"n_steps": 8, "gamma": 0.9, "learning_rate": 1e-3}
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
        seed: seed of the training.
    """

    env: str
    algorithm: type[PPO] | type[DQN] | type[A2C]
    steps: int
    config: dict[str, Any]
    settings: dict[str, Any] = field(default_factory=lambda: _PPO)
    seed: int = 0


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
OTHERS = {  # on which `niching` was developed, beside those above
    "highway-dqn": Training(
        "highway-fast-v0", DQN, 60_000, {"lanes_count": 4, "duration": 40, "collision_reward": -3}, _DQN, 11
    ),
    "highway-ppo": Training("highway-fast-v0", PPO, 100_000, {"collision_reward": -2}, _PPO, 12),
    "highway-a2c": Training("highway-fast-v0", A2C, 150_000, {"lanes_count": 4, "collision_reward": -3}, _A2C, 13),
    "roundabout-dqn": Training("roundabout-v0", DQN, 40_000, {"duration": 15, "collision_reward": -3}, _DQN, 14),
    "roundabout-ppo": Training("roundabout-v0", PPO, 30_000, {}, _PPO, 15),
    "intersection-dqn": Training("intersection-v0", DQN, 60_000, {"collision_reward": -10}, _DQN, 16),
    "merge-ppo": Training("merge-v0", PPO, 60_000, {"collision_reward": -5}, _PPO, 17),
}
HELD_OUT = {  # trained after that, and compared in docs/niching.py
    "highway": Training("highway-fast-v0", DQN, 80_000, {"lanes_count": 3, "collision_reward": -2}, _DQN, 21),
    "merge": Training("merge-v0", A2C, 60_000, {"collision_reward": -4}, _A2C, 22),
    "roundabout": Training("roundabout-v0", PPO, 40_000, {"duration": 13}, _PPO, 27),
    "intersection-often": Training(
        "intersection-v0",
        PPO,
        200_000,
        {"initial_vehicle_count": 5, "spawn_probability": 0.2, "collision_reward": -10},
        _PPO,
        24,
    ),
    "roundabout-often": Training("roundabout-v0", DQN, 40_000, {"duration": 13}, _DQN, 25),
}
SETS = {"own": TRAININGS, "others": OTHERS, "held-out": HELD_OUT}


def train(training: Training, path: Path) -> None:
    """Train a policy and save it, with a file that says where it was trained."""
    compiled: Any = HighwayVecEnv
    settings = {"env_kwargs": {"config": training.config}, "vec_env_cls": compiled}
    envs = make_vec_env(training.env, N_ENVS, seed=training.seed, **settings)
    model = training.algorithm("MlpPolicy", envs, seed=training.seed, device="cpu", **training.settings)
    model.learn(training.steps)
    envs.close()
    model.save(path)
    path.with_suffix(".yaml").write_text(yaml.safe_dump({"env": training.env, "config": training.config}))


if __name__ == "__main__":
    torch.set_num_threads(1)
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    for name, training in SETS[sys.argv[2] if len(sys.argv) > 2 else "own"].items():
        train(training, folder / f"{name}.zip")
        print(f"{name}: {training.algorithm.__name__}, {training.steps} steps in {training.env}")
