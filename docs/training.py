"""Trains a policy with `FuzzCallback`, and draws its curves: python docs/training.py [SECONDS [METHOD]]."""

import json
import sys
import time
from pathlib import Path
from typing import Any

import highway_env  # noqa: F401 - registers roundabout-v0
import numpy as np
import torch
from matplotlib.figure import Figure
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback, CallbackList, EvalCallback
from stable_baselines3.common.env_util import make_vec_env

import behavexplor
from behavexplor.envs.sb3_vec_env import HighwayVecEnv
from behavexplor.sb3 import FuzzCallback

PICTURE = Path(__file__).parent / "training.png"
OUT = Path("runs/training-curves")
ENV, SEED = "roundabout-v0", 0
STATED_SHARE = 0.1  # of the time, for fuzzing
HELD_OUT, HELD_OUT_SEED = 1000, 4242  # scenarios that no callback has seen


class TimeLimit(BaseCallback):
    """Ends a training after some time.

    Args:
        seconds: the time [s].
    """

    def __init__(self, seconds: float) -> None:
        super().__init__()
        self._seconds, self._end = seconds, 0.0

    def _on_training_start(self) -> None:
        self._end = time.monotonic() + self._seconds

    def _on_step(self) -> bool:
        return time.monotonic() < self._end


def trained(seconds: float, method: str) -> tuple[FuzzCallback, dict[str, Any]]:
    """Train with both callbacks, and return that of this package, and the mean returns of the other one."""
    envs = make_vec_env(ENV, 64, seed=SEED, vec_env_cls=HighwayVecEnv)
    seen = make_vec_env(ENV, 20, seed=SEED + 1, vec_env_cls=HighwayVecEnv)
    fuzzing = FuzzCallback(
        every=20_000, budget=100, share=STATED_SHARE, method=method, confirm=False, out=str(OUT / "fuzzing"), verbose=1
    )
    returns = EvalCallback(
        seen, n_eval_episodes=100, eval_freq=20_000 // 64, best_model_save_path=str(OUT), log_path=str(OUT), verbose=0
    )
    model = PPO("MlpPolicy", envs, n_steps=64, batch_size=1024, n_epochs=5, gamma=0.9, ent_coef=0.01, seed=SEED)
    model.learn(10**9, callback=CallbackList([fuzzing, returns, TimeLimit(seconds)]))
    model.save(OUT / "last_model.zip")
    means = [float(np.mean(found)) for found in returns.evaluations_results]
    return fuzzing, {"steps": returns.evaluations_timesteps, "returns": means}


def figure(fuzzing: FuzzCallback, returns: dict[str, Any]) -> Figure:
    """Rates of failures and the mean return over the training steps."""
    sheet = Figure(figsize=(8.0, 4.2), layout="constrained")
    above, below = sheet.subplots(2, 1, sharex=True)
    steps = [found.steps for found in fuzzing.rounds]
    rates = [100 * found.summary.at_fault_rate for found in fuzzing.rounds]
    above.plot(steps, rates, "o-", ms=3, label="failures at fault [% of a round]")
    above.plot(steps, [len(found.summary.classes) for found in fuzzing.rounds], "s:", ms=3, label="classes [number]")
    above.set(ylim=(0, None))
    above.legend(fontsize="small")
    below.plot(returns["steps"], returns["returns"])
    below.set(ylabel="mean return", xlabel="training steps")
    return sheet


def main() -> None:
    """Train, draw the curves, and drive the last policy and both best ones through held-out scenarios."""
    torch.set_num_threads(1)
    seconds, method = (*sys.argv[1:], *("600", "uniform")[len(sys.argv) - 1 :])
    fuzzing, returns = trained(float(seconds), method)
    figure(fuzzing, returns).savefig(PICTURE, dpi=110, metadata={"Software": ""})
    chosen = {"FuzzCallback": fuzzing.folder / "best_model.zip", "EvalCallback": OUT / "best_model.zip"}
    chosen["last"] = OUT / "last_model.zip"
    found: dict[str, Any] = {"rounds": len(fuzzing.rounds), "share": fuzzing.share_of_time}
    for name, file in chosen.items():
        model = PPO.load(file)
        rates = behavexplor.evaluate(model, ENV, scenarios=HELD_OUT, seed=HELD_OUT_SEED)
        found[name] = {"steps": model.num_timesteps, "rates": str(rates)}
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
