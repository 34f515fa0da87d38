"""How fast scenarios are executed, beside plain highway-env in the same run.

    python benchmarks/execution.py [--scenarios 50]

Prints CPU milliseconds for each simulated second, and how many times faster that is than highway-env's own
`intersection-v1` (its road, vehicles and Kinematics observation, at 15 Hz and one decision a second). Compare the
ratios, not the milliseconds: machines differ, and are not always alone.
"""

import argparse
import time
from collections.abc import Callable

import gymnasium
import highway_env  # noqa: F401 - registers intersection-v1
import numpy as np

from behavexplor.ads.rule import RulePlanner
from behavexplor.envs.functional.intersection_straight import IntersectionStraightEnv
from behavexplor.rollout import rollout

LOGICAL = IntersectionStraightEnv.logical


class Cruiser:
    """Drives at 10 m/s, whatever stands in its way: the cost of the environment alone."""

    observation = RulePlanner.observation
    action = RulePlanner.action
    policy_frequency = RulePlanner.policy_frequency

    def predict(self, observation, state=None, episode_start=None, deterministic=True):  # noqa: ANN001, ANN201, ARG002, D102
        speed = observation[:, 0, 4]
        return np.stack([np.where(speed < 10, 1.0, 1 / 3), 0 * speed], axis=1), state


def stock(scenarios: int) -> float:
    """Simulated seconds of highway-env's own intersection."""
    env = gymnasium.make("intersection-v1", disable_env_checker=True)
    seconds = 0.0
    for seed in range(max(scenarios // 10, 2)):
        env.reset(seed=seed)
        for _ in range(13):
            *_, terminated, truncated, _ = env.step(np.zeros(2, dtype=np.float32))
            seconds += 1 / env.unwrapped.config["policy_frequency"]
            if terminated or truncated:
                break
    return seconds


def ours(ads: object, scenarios: int) -> float:
    """Simulated seconds of S1 with an ADS."""
    config = {name: getattr(ads, name) for name in ("observation", "action", "policy_frequency")}
    env = gymnasium.make("behavexplor/intersection-straight-v0", config=config, disable_env_checker=True)
    return sum(rollout(env, ads, LOGICAL.sample(np.random.default_rng(i))).duration for i in range(scenarios))


def cost(run: Callable[[int], float], scenarios: int) -> float:
    """CPU milliseconds for each simulated second, after a warm-up."""
    run(2)
    start = time.process_time()
    seconds = run(scenarios)
    return 1000 * (time.process_time() - start) / seconds


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenarios", type=int, default=50)
    scenarios = parser.parse_args().scenarios
    planner = RulePlanner(LOGICAL.roadmap)
    rows = {
        "highway-env's intersection-v1": cost(stock, scenarios),
        "S1, constant speed": cost(lambda n: ours(Cruiser(), n), scenarios),
        "S1, rule planner": cost(lambda n: ours(planner, n), scenarios),
    }
    reference = next(iter(rows.values()))
    print(f"{'':32}{'ms per simulated second':>26}{'times faster':>16}")
    for name, milliseconds in rows.items():
        print(f"{name:32}{milliseconds:26.2f}{reference / milliseconds:16.1f}")


if __name__ == "__main__":
    main()
