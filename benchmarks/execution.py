"""Speed of execution, in comparison with plain highway-env on the same scenarios in the same run."""

import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO

from behavexplor.data.scripted import ScriptedScenario
from behavexplor.data.target import Target
from behavexplor.envs.making import environment_id
from behavexplor.evaluation import start_judge, uniform_outcomes
from behavexplor.execution.evaluator import EXECUTE
from behavexplor.execution.simulation import Simulation
from behavexplor.execution.start import start_executor
from benchmarks.stock import drive_env, drive_objects

Row = dict[str, Any]

BATCHES = (1, 8, 32, 256)
FULL_BATCHES = 8  # least number of full batches, so that the beginning and the end of a row count little


class Cruiser:
    """A trivial driver in Python, which keeps a speed of 10 m/s and ignores traffic."""

    observation = {"type": "Scene"}  # noqa: RUF012 - the plainest way to write an ADS
    action = {"type": "ContinuousAction", "acceleration_range": [-8.0, 4.0], "steering_range": [-0.6, 0.6]}  # noqa: RUF012
    policy_frequency = 10
    vectorized = True

    def predict(self, observation, state=None, episode_start=None, deterministic=True):  # noqa: ANN001, ANN201, ARG002, D102
        speed = observation[:, 0, 4]
        return np.stack([np.where(speed < 10, 1.0, 1 / 3), 0 * speed], axis=1), state


def cpu(run: Callable[[], Any]) -> float:
    """Return the CPU time of this process for a call [s]."""
    start = time.process_time()
    run()
    return time.process_time() - start


def scenarios_of(simulation: Simulation, count: int) -> list[ScriptedScenario]:
    """Return uniformly drawn scenarios, the same in every run."""
    generator = np.random.default_rng(0)
    return [simulation.logical.sample(generator) for _ in range(count)]


def untrained_policy(env: str, folder: Path) -> Path:
    """Save a PPO model with Stable-Baselines3's default network for an environment's observations. Return its path."""
    model = PPO("MlpPolicy", gymnasium.make(environment_id(env), disable_env_checker=True), device="cpu", seed=0)
    model.save(folder / "untrained.zip")
    return folder / "untrained.zip"


class Pace:
    """How fast the machine is: the CPU time [s] of plain highway-env in one scenario, measured beside each row.

    The speed of a shared machine changes by a quarter within minutes, so ratios count only between rows of one pace.
    """

    def __init__(self, env: str) -> None:
        simulation = Simulation(env, "rule")
        self._scenario = scenarios_of(simulation, 1)[0]
        self._seconds = simulation.run(self._scenario).duration
        self._roadmap = simulation.logical.roadmap

    def during(self, run: Callable[[], Any]) -> tuple[float, float]:
        """Return the CPU time of a call [s], and the mean of those of highway-env just before and just after it."""
        before = self.now()
        used = cpu(run)
        return used, (before + self.now()) / 2

    def now(self) -> float:
        """Return the CPU time of plain highway-env in the scenario [s]."""
        return cpu(lambda: drive_objects(self._scenario, self._roadmap, self._seconds, None))


def stock_rows(env: str, count: int, pace: Pace) -> list[Row]:
    """Return rows for plain highway-env. Each scenario runs for as long as the rule planner takes in it."""
    simulation = Simulation(env, "rule")
    scenarios = scenarios_of(simulation, count)
    seconds = [trace.duration for _, trace in sorted(simulation.run_all(scenarios))]
    roadmap = simulation.logical.roadmap
    with tempfile.TemporaryDirectory() as folder:
        policy = PPO.load(untrained_policy(env, Path(folder)), device="cpu")

    def objects(policy: Any = None) -> None:
        for scenario, time_ in zip(scenarios, seconds, strict=True):
            drive_objects(scenario, roadmap, time_, policy)

    rows = {
        "highway-env: objects, no observation": objects,
        "highway-env: objects and predict of SB3": lambda: objects(policy),
        "highway-env: gymnasium, Kinematics": lambda: drive_env(scenarios, roadmap, seconds),
    }
    return [_row(env, name, 1, count, pace.during(run), seconds) for name, run in rows.items()]


def lock_step_rows(
    env: str, systems: Sequence[str], count: int, pace: Pace, batches: Sequence[int] = BATCHES
) -> list[Row]:
    """Return rows for this package in one process, by driver and by number of scenarios in lock-step."""
    rows = []
    for name in systems:
        simulation = Simulation(env, name)
        scenarios = scenarios_of(simulation, max(count, FULL_BATCHES * max(batches)))
        for batch in batches:
            few = scenarios[: max(count // 16, 4) if batch == 1 else max(count, FULL_BATCHES * batch)]
            list(simulation.run_all(scenarios[:2], batch))
            driven: list[float] = []
            run = partial(_drive_all, simulation, few, batch, driven)
            rows.append(_row(env, Path(name).name, batch, len(few), pace.during(run), driven))
        simulation.close()
    return rows


def worker_rows(env: str, ads: str, count: int, workers: Sequence[int]) -> list[Row]:
    """Return rows with wall times for several numbers of worker processes."""
    simulation = Simulation(env, ads)
    requests = [scenario.to_json().encode() for scenario in scenarios_of(simulation, count)]
    rows = []
    for number in workers:
        with start_executor(Target(env, ads), number) as executor:
            for future in [executor.submit(EXECUTE, request) for request in requests[: 128 * number]]:  # all start
                future.result()
            start = time.perf_counter()
            for future in [executor.submit(EXECUTE, request) for request in requests]:
                future.result()
            wall = time.perf_counter() - start
        rows.append({"env": env, "ads": ads, "workers": number, "executions per second, wall": count / wall})
    return rows


def _drive_all(simulation: Simulation, scenarios: list[ScriptedScenario], batch: int, driven: list[float]) -> None:
    driven += [trace.duration for _, trace in simulation.run_all(scenarios, batch)]


def _row(env: str, ads: str, batch: int, count: int, measured: tuple[float, float], driven: list[float]) -> Row:
    used, pace = measured
    return {
        "env": env,
        "ads": ads,
        "batch": batch,
        "n": count,
        "ms per execution": 1000 * used / count,
        "ms per simulated second": 1000 * used / sum(driven),
        "pace": pace,
    }


def main_systems(env: str, folder: Path) -> list[str]:
    """Return the names of the measured drivers."""
    torch.set_num_threads(1)
    shipped = f"learned:{env}"
    return ["constant", "benchmarks.execution:Cruiser", shipped, str(untrained_policy(env, folder)), "idm", "rule"]


def counting_rows(count: int, rounds: int = 3) -> list[Row]:
    """Return rows on episodes per CPU second of this process: judged by their traces, and counted.

    Both ways take turns, and the best round of each counts, since the machine may be busy.
    """
    rows = []
    for env, ads in (("highway-fast-v0", "docs/data/policies/highway-fast.zip"), ("roundabout-v0", "careful")):
        logical = Simulation(env, ads).logical
        generator = np.random.default_rng(0)
        requests = [logical.sample(generator).to_json().encode() for _ in range(count)]
        with start_judge(Target(env, ads, unconfined=True), 0) as judge:
            ways = {
                "traces": lambda judge=judge, requests=requests: [
                    future.result() for future in [judge.submit(EXECUTE, request) for request in requests]
                ],
                "counted": lambda judge=judge, logical=logical: list(uniform_outcomes(judge, logical, 4 * count, 0)),
            }
            times = {
                way: min(used)
                for way, used in zip(
                    ways, zip(*([cpu(run) for run in ways.values()] for _ in range(rounds)), strict=True), strict=True
                )
            }
        traces, counted = count / times["traces"], 4 * count / times["counted"]
        rows.append({"env": env, "ads": Path(ads).name, "traces": traces, "counted": counted, "x": counted / traces})
    return rows
