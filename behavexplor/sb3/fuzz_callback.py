"""A callback for Stable-Baselines3 that fuzzes the present policy at intervals during a training."""

import numbers
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any, Final

from stable_baselines3.common.callbacks import BaseCallback

from behavexplor.ads.in_memory import given_driver
from behavexplor.api.campaigns import config_of, find_failures
from behavexplor.campaign.campaign import search_method
from behavexplor.campaign.config import stamped_folder
from behavexplor.campaign.run_summary import RunSummary
from behavexplor.data.durable import make_folder, write_saved
from behavexplor.errors import InputError, brief
from behavexplor.execution.start import logical_of_target, start_executor
from behavexplor.judge.robustness import load_specs

BEST: Final = "best_model.zip"  # file in the callback's folder
MOST_STEPS: Final = 10**12
_ROUND_PREFIX: Final = "step-"  # begins the name of a round's run folder; then comes the number of training steps


@dataclass(frozen=True)
class FuzzingRound:
    """One round of fuzzing.

    Attributes:
        steps: number of training steps before the round.
        folder: run folder of the round.
        summary: what the round found.
        seconds: how long the round took [s].
    """

    steps: int
    folder: Path
    summary: RunSummary
    seconds: float


class FuzzCallback(BaseCallback):
    """Fuzzes the present policy at intervals, logs what it finds, and saves the policy with the fewest failures.

    All rounds have the same seed and budget, so their figures can be compared. Only failures for which the policy was
    at fault count towards the fewest. Of equally good policies, the latest is saved. The training itself is the same
    with and without the callback, except that it takes longer.

    It logs `fuzz/failure_rate`, `fuzz/at_fault_rate`, `fuzz/classes`, and `fuzz/share_of_time`. All arguments are plain
    values, so that a hyperparameter file of rl-zoo3 can name the callback:

        callback:
          - behavexplor.sb3.FuzzCallback: {env: highway-fast-v0, every: 10000, budget: 50}

    Args:
        env: id of the environment; by default that of the training, in its configuration.
        every: number of training steps between two rounds.
        budget: number of executions of a round, or its running time, such as "20s".
        share: greatest share of the time since the training began that rounds may take. A round is left out if
            the rounds would then exceed this share, judging by the time of the last round. The first round always takes
            place.
        stop_below: at-fault rate above 0 and up to 1, below which the training ends; None to train on.
        out: folder for the rounds' run folders and the best policy; by default a new one in runs/.
        seed: seed of every round.
        specs: requirements in addition to R1, R2 and R3, each as "module:attribute".
        method: search method, see docs/methods.md; by default as for `behavexplor.find_failures`. With "uniform", the
            rates are those in ordinary scenarios of the environment. Other methods search for failures.
        settings: further keys of the configuration, see `behavexplor.campaign.config.CampaignConfig`.

    Attributes:
        rounds: the rounds so far.
        best: the round whose policy was saved; None before the first one.

    Raises:
        InputError: if a value is out of range.
    """

    def __init__(  # noqa: PLR0913 - one argument for each choice
        self,
        env: str | None = None,
        *,
        every: int = 10_000,
        budget: int | str = 50,
        share: float = 0.1,
        stop_below: float | None = None,
        out: str | None = None,
        seed: int = 0,
        specs: Sequence[str] = (),
        method: str | None = None,
        verbose: int = 0,
        **settings: Any,
    ) -> None:
        super().__init__(verbose)
        limit = 1.0 if stop_below is None else stop_below
        given: dict[str, Any] = {"every": every, "share": share, "stop_below": limit}
        for name, value in given.items():
            if not isinstance(value, numbers.Real):
                raise InputError(f"{name}={brief(value)} must be a number")
        if not 1 <= every <= MOST_STEPS:
            raise InputError(f"every={every} must lie between 1 and {MOST_STEPS} training steps")
        if not 0.0 < share <= 1.0:
            raise InputError(f"share={share} must be greater than 0 and at most 1")
        if stop_below is not None and not 0.0 < stop_below <= 1.0:
            raise InputError(f"stop_below={stop_below} must be greater than 0 and at most 1, or None to train on")
        self._env, self._every, self._share, self._stop_below = env, every, share, stop_below
        self._out = None if out is None else Path(out)
        self._folder: Path | None = None
        self._settings = {"budget": str(budget), "seed": seed, "specs": tuple(specs), **settings}
        if method is not None:
            self._settings["method"] = method
        self._begin = self._spent = 0.0
        self._next = every
        self.rounds: list[FuzzingRound] = []
        self.best: FuzzingRound | None = None

    @property
    def folder(self) -> Path:
        """Folder with the run folders and the best policy of this training: `out`, or training-2, ... in it."""
        if self._folder is None:
            self._out = self._out or stamped_folder("training")
            self._folder = _new_folder(self._out)
        return self._folder

    @property
    def share_of_time(self) -> float:
        """Share of the time since the training began that the rounds have taken."""
        return self._spent / max(time.monotonic() - self._begin, self._spent, 1e-9)

    def _on_training_start(self) -> None:
        self._check()
        self._begin, self._spent = time.monotonic(), 0.0
        self._next = self.num_timesteps + self._every
        if not self.num_timesteps:  # the counter began anew, and so would the names of the rounds
            self._folder = self.best = None

    def _check(self) -> None:
        """Check all that a round needs, because a mistake that shows in the first round costs the training."""
        given: Any = given_driver(self.model)
        settings = {"env_config": None, **self._settings}  # so that `env_config` in the settings wins
        config = config_of(given, self._env, **settings)
        load_specs(config.specs)
        with start_executor(config.target, 0, driver=given.driver) as executor:
            search_method(config, logical_of_target(executor, config.env))

    def _on_step(self) -> bool:
        if self.num_timesteps < self._next:
            return True
        self._next = self.num_timesteps + self._every
        if not self._has_time():
            return True
        found = self._round()
        self._keep(found)
        self._log(found)
        return self._stop_below is None or found.summary.at_fault_rate >= self._stop_below

    def _has_time(self) -> bool:
        if self.best is None:  # the first round of a training always takes place
            return True
        expected = self.rounds[-1].seconds
        elapsed = time.monotonic() - self._begin
        return self._spent + expected <= self._share * (elapsed + expected)

    def _round(self) -> FuzzingRound:
        begin = time.monotonic()
        folder = make_folder(self.folder, f"{_ROUND_PREFIX}{self.num_timesteps:09d}")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # a policy may be constant while it learns
            given = given_driver(self.model)
            run = find_failures(given, self._env, out=folder, progress=False, **self._settings)
        seconds = time.monotonic() - begin
        self._spent += seconds
        found = FuzzingRound(self.num_timesteps, folder, run.summary, seconds)
        self.rounds.append(found)
        return found

    def _keep(self, found: FuzzingRound) -> None:
        """Save the policy if it is the best one so far."""
        if self.best is None or found.summary.at_fault <= self.best.summary.at_fault:
            self.best = found
            write_saved(self.folder / BEST, self.model.save)

    def _log(self, found: FuzzingRound) -> None:
        figures = {
            "failure_rate": found.summary.failure_rate,
            "at_fault_rate": found.summary.at_fault_rate,
            "classes": len(found.summary.classes),
            "share_of_time": self.share_of_time,
        }
        for name, value in figures.items():
            self.logger.record(f"fuzz/{name}", value)
        if self.verbose:
            print(  # noqa: T201 - as all verbose callbacks do
                f"{found.steps} steps: of {found.summary.executions} scenarios, {found.summary.words}"
            )


def _new_folder(out: Path) -> Path:
    """Return the first of `out` and training-2, training-3, ... in it that has no rounds of an earlier training."""
    folder = out
    for number in count(2):
        if not any(folder.glob(f"{_ROUND_PREFIX}*")):
            break
        folder = out / f"training-{number}"
    return folder
