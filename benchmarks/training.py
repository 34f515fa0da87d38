"""Speed of training with Stable-Baselines3's PPO, in comparison with plain highway-env in the same run.

    python benchmarks/training.py [--steps 50000] [--envs 64] [--stock-steps 2048]

The environments are this package's scenarios and, after them, highway-env's own `highway-fast-v0`, compiled; the latter
with PPO's default batch size and epochs, and with larger batches.

The script prints the steps per CPU second, including collecting and learning, and the ratio to highway-env's own
`intersection-v1`. Both use PPO's default policy, batch size and epochs, and one thread. Compare the ratios, not the
steps, because machines differ and may be busy. The last columns are the mean return of the first and of the last fifth
of the episodes.
"""

import argparse
import time

import gymnasium
import highway_env  # noqa: F401 - registers intersection-v1
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecMonitor

import behavexplor
from behavexplor.envs.sb3_vec_env import DrivingVecEnv, HighwayVecEnv

ROLLOUT = 8192  # total steps of all environments between two updates
FAST_SETTINGS: tuple[tuple[str, int, dict[str, int]], ...] = (
    ("default batches", 2048, {}),
    ("batches of 512", 4096, {"batch_size": 512, "n_epochs": 4}),
)


class Returns(BaseCallback):
    """Keeps the return of every episode."""

    def __init__(self) -> None:
        super().__init__()
        self.values: list[float] = []

    def _on_step(self) -> bool:
        self.values += [info["episode"]["r"] for info in self.locals["infos"] if "episode" in info]
        return True

    def fifths(self) -> tuple[float, float]:
        """Return the mean returns of the first and of the last fifth of the episodes."""
        count = max(len(self.values) // 5, 1)
        return float(np.mean(self.values[:count])), float(np.mean(self.values[-count:]))


def stock(name: str = "intersection-v1", count: int = 1) -> VecEnv:
    """Return one of highway-env's own environments; by default, its intersection with continuous actions."""
    return DummyVecEnv([lambda: gymnasium.make(name, disable_env_checker=True)] * count)


def compiled(name: str, count: int) -> VecEnv:
    """Return one of highway-env's own environments in its compiled form."""
    return HighwayVecEnv([lambda: gymnasium.make(name, disable_env_checker=True)] * count)


def ours(name: str, count: int) -> VecEnv:
    """Return one of this package's scenarios with many environments in lock-step."""
    settings = {"vectorization_mode": "vector_entry_point", "autoreset_mode": "SameStep"}
    return DrivingVecEnv(gymnasium.make_vec(f"{behavexplor.NAMESPACE}/{name}-v0", num_envs=count, **settings))


def train(env: VecEnv, steps: int, rollout: int = ROLLOUT, **settings: int) -> tuple[float, Returns]:
    """Return the training steps per CPU second, and the returns of the episodes."""
    returns = Returns()
    n_steps = max(min(rollout, steps) // env.num_envs, 1)
    model = PPO("MlpPolicy", VecMonitor(env), n_steps=n_steps, seed=0, device="cpu", **settings)
    start = time.process_time()
    model.learn(steps, callback=returns)
    rate = model.num_timesteps / (time.process_time() - start)
    env.close()
    return rate, returns


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=50_000)
    parser.add_argument("--envs", type=int, default=64)
    parser.add_argument("--stock-steps", type=int, default=2048)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    train(ours("lane-follow", arguments.envs), arguments.envs)  # compiles the kernels, unless they are cached
    print(f"{'':32}{'steps per CPU second':>22}{'times faster':>14}{'return: first':>15}{'last':>9}")
    reference, returns = train(stock(), arguments.stock_steps)
    print(row("highway-env's intersection-v1", reference, reference, returns), flush=True)
    for name in behavexplor.FUNCTIONAL_SCENARIOS:
        rate, returns = train(ours(name, arguments.envs), arguments.steps)
        print(row(name, rate, reference, returns), flush=True)
    train(compiled("highway-fast-v0", arguments.envs), arguments.envs)
    reference, returns = train(stock("highway-fast-v0", 16), min(arguments.stock_steps, 1024), rollout=256)
    print(row("highway-env's highway-fast-v0", reference, reference, returns), flush=True)
    for label, rollout, settings in FAST_SETTINGS:
        rate, returns = train(compiled("highway-fast-v0", arguments.envs), arguments.steps, rollout, **settings)
        print(row(f"highway-fast-v0, {label}", rate, reference, returns), flush=True)


def row(name: str, rate: float, reference: float, returns: Returns) -> str:
    """Return a line of the table."""
    first, last = returns.fifths()
    return f"{name:32}{rate:22.0f}{rate / reference:14.1f}{first:15.2f}{last:9.2f}"


if __name__ == "__main__":
    main()
