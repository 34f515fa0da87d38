"""Retraining of a policy on the scenarios in which it fails, in resumable rounds.

A round searches for failures of the present policy if the configuration asks for a search. It trains the policy on a
mixture of ordinary scenarios and those in which the policy fails. Then it validates the policy, which decides
deterministically there, as it does in campaigns.
"""

import hashlib
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure

from behavexplor.ads.sb3.archive import MAX_BYTES
from behavexplor.campaign.campaign import search_method
from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.folder_format import CONFIG
from behavexplor.campaign.opening import opened
from behavexplor.campaign.store import Execution, Store
from behavexplor.data.drawn_scenario import DEFAULT, WIDE
from behavexplor.data.durable import make_folder, write_durably
from behavexplor.data.scenario import LogicalScenario, Scenario, read_scenarios
from behavexplor.data.target import Target
from behavexplor.data.untrusted import read_file
from behavexplor.evaluation import start_judge, uniform_outcomes
from behavexplor.execution.simulation import Simulation
from behavexplor.execution.start import logical_of_target
from behavexplor.judge.outcomes import Outcomes, outcomes_of
from behavexplor.repair.retraining_rounds import ROUNDS, RetrainingConfig, Round, append_round, best, finished_rounds
from behavexplor.repair.trainees import Trainee, copy_policy, given_file, open_trainee
from behavexplor.training import Learned, TrainingReporter, log_folder, log_formats, restore_model, save_model
from behavexplor.triage.blame import blame
from behavexplor.triage.examination import STREAM

VALIDATION_SEED: Final = 1_000_003  # seed of the scenarios by which the best round is chosen
FULL: Final = 100  # scenarios that a pool needs to be drawn from with its full share
MOST: Final = 2000  # scenarios in a pool; the newest are kept
_LAST_RATE: Final = 0.2  # learning rate of the last round, as a share of that of the first one


class Pool:
    """Scenarios in which a policy fails at present. It follows the policy.

    A scenario enters when the policy fails in it by its own fault. It leaves when an episode in it ends otherwise.

    An episode is drawn from the pool with the probability `share`, else from `logical`. The probability is lower, in
    proportion, for a pool of fewer than `FULL` scenarios, so that a few that cannot be mended do not fill the training.
    """

    def __init__(self, logical: LogicalScenario, share: float, scenarios: Iterable[Scenario] = ()) -> None:
        self._logical = logical
        self._share = share
        self._scenarios: dict[Scenario, None] = {}  # in the order in which they entered
        for scenario in scenarios:
            self.add(scenario)

    def __len__(self) -> int:
        """Return the number of scenarios."""
        return len(self._scenarios)

    def sample(self, rng: np.random.Generator) -> Scenario:
        """Draw the scenario of an episode."""
        if self._scenarios and rng.random() < self._share * min(len(self._scenarios) / FULL, 1.0):
            return list(self._scenarios)[int(rng.integers(len(self._scenarios)))]
        return self._logical.sample(rng)

    def add(self, scenario: Scenario) -> None:
        """Add a scenario in which the policy failed. If the pool is full, the oldest one leaves."""
        self._scenarios.setdefault(scenario)
        if len(self._scenarios) > MOST:
            del self._scenarios[next(iter(self._scenarios))]

    def discard(self, scenario: Scenario) -> None:
        """Remove a scenario in which the policy did not fail by its own fault, if the pool has it."""
        self._scenarios.pop(scenario, None)

    @property
    def digest(self) -> str:
        """SHA-256 of the scenarios in their order."""
        return hashlib.sha256(self._text().encode()).hexdigest()

    def write(self, path: Path) -> None:
        """Write the scenarios to a file, one as JSON in each line."""
        write_durably(path, self._text())

    def _text(self) -> str:
        return "".join(f"{scenario.to_json()}\n" for scenario in self._scenarios)


class PoolReporter(TrainingReporter):
    """Callback that keeps a pool up to date with the ends of the training's episodes.

    A scenario leaves the pool when an episode in it ends without a failure at fault. If `own` is true, a scenario also
    enters the pool when an episode in it ends with such a failure.
    """

    def __init__(self, observe: Callable[[Learned], None], pool: Pool, *, own: bool) -> None:
        super().__init__(observe)
        self._pool = pool
        self._own = own
        self._running: list[Any] = []

    def _on_training_start(self) -> None:
        super()._on_training_start()
        self._running = self.training_env.get_attr("scenario")

    def _on_step(self) -> bool:
        for i in np.flatnonzero(self.locals["dones"]).tolist():
            self._ended(self._running[i], self.locals["infos"][i])
            (self._running[i],) = self.training_env.get_attr("scenario", [i])
        return super()._on_step()

    def _on_rollout_end(self) -> None:
        self.logger.record("pool/scenarios", len(self._pool))
        super()._on_rollout_end()

    def _ended(self, scenario: Any, info: Mapping[str, Any]) -> None:
        if not outcomes_of(info["trace"]).at_fault:
            self._pool.discard(scenario)
        elif self._own:
            self._pool.add(scenario)


def search_config(target: Target, method: str, budget: int, seed: int) -> CampaignConfig:
    """Return the configuration of the campaign of `found_failures`.

    Raises:
        InputError: if a value is out of range.
    """
    return CampaignConfig(
        env=target.env,
        ads=target.ads,
        method=method,
        budget=str(budget),
        seed=seed,
        batch=32,
        env_config=None if target.env_config is None else dict(target.env_config),
        traffic=WIDE if target.traffic == WIDE else DEFAULT,
        unconfined=target.unconfined,
    )


def found_failures(target: Target, method: str, budget: int, seed: int, folder: Path) -> tuple[list[Any], int]:
    """Run a campaign of `budget` executions on a policy, or read it if its folder has it.

    Return the scenarios of the failures for which the policy was at fault, without collisions that no tried evasion
    avoids; and the number of decisions of the whole campaign.

    Raises:
        ExecutionError: if an execution could not be carried out.
    """
    config = search_config(target, method, budget, seed)
    begun = (folder / CONFIG).is_file()  # a folder without it was interrupted before its campaign began
    with opened(config, folder, 0, resume=begun) as ready:
        ready.campaign.run(lambda _: None)
    with closing(Store.read(folder)) as store:
        executions = list(store.executions())
    simulation = Simulation(target.env, target.ads, env_config=target.env_config, traffic=target.traffic)
    with closing(simulation):
        failures = [one.scenario for one in executions if one.record.at_fault and _preventable(simulation, one, seed)]
        frequency = simulation.env.get_wrapper_attr("config")["policy_frequency"]
    return failures, round(sum(one.record.duration or 0.0 for one in executions) * frequency)


def _preventable(simulation: Simulation, execution: Execution, seed: int) -> bool:
    """Return False for a collision that no tried evasion avoids, and True for any other failure."""
    if execution.record.fault is None:
        return True
    rng = np.random.default_rng([STREAM, seed, execution.id])
    verdict = blame(simulation, execution.scenario, execution.load_trace(), rng)
    return verdict is None or verdict.at_fault


def retrain(
    config: RetrainingConfig, folder: Path, observe: Callable[[Learned], None], report: Callable[[Round], None]
) -> list[Round]:
    """Retrain a policy, or resume after the last round in the folder; return all rounds.

    `observe` gets the progress of a round after each batch of experience, and `report` each finished round. The policy
    of the round that `best` chooses is copied to `policy_in(folder, config)`.

    Raises:
        InputError: if the policy or the environment cannot be used, or a file of the folder cannot be read.
        DivergedError: if the training diverges. The best policy until then is in its place.
    """
    torch.set_num_threads(1)  # more threads change the last bits of results
    trainee = open_trainee(config.target, config.seed, config.envs)
    with closing(trainee.venv):
        rounds = finished_rounds(folder)
        logical = trainee.scenarios.logical
        stored = read_scenarios(folder / "rounds" / f"round-{rounds[-1].number:04d}.jsonl", logical) if rounds else []
        pool = Pool(logical, config.share, stored)
        trainee.scenarios.sampler = pool.sample
        work = _Work(config, folder, trainee, pool)
        if rounds:
            again = f"delete the last line of {folder / ROUNDS} to resume from the round before"
            restore_model(trainee.model, work.file(rounds[-1].number, ".pt"), again)
        else:
            rounds = [work.finish(0, None)]
            report(rounds[-1])
        try:
            work.run(rounds, PoolReporter(observe, pool, own=config.pool in ("own", "both")), report)
        finally:
            copy_policy(work.file(best(rounds).number, trainee.suffix), policy_in(folder, config))
    return rounds


def check(config: RetrainingConfig) -> None:
    """Check that a policy can be trained further, and that its failures can be searched for.

    Raises:
        InputError: if not; the message says why.
    """
    trainee = open_trainee(config.target, config.seed, config.envs)
    with closing(trainee.venv):
        if config.searches:
            last = search_config(config.target, config.method, config.budget, config.seed + config.rounds)
            search_method(last, trainee.scenarios.logical)


def policy_in(folder: Path, config: RetrainingConfig) -> Path:
    """Return the path of the best policy."""
    return folder / f"policy{given_file(config.policy).suffix}"


@dataclass(frozen=True)
class _Work:
    """The rounds of one retraining."""

    config: RetrainingConfig
    folder: Path
    trainee: Trainee
    pool: Pool

    def file(self, number: int, suffix: str) -> Path:
        """Return the path of a round's file."""
        return self.folder / "rounds" / f"round-{number:04d}{suffix}"

    def run(self, rounds: list[Round], watch: BaseCallback, report: Callable[[Round], None]) -> None:
        """Carry out the rounds that are left, and add them to `rounds`."""
        config, logs = self.config, log_folder(self.folder, f"round-{len(rounds):04d}")
        self.trainee.model.set_logger(configure(logs, log_formats()))
        with closing(self.trainee.model.logger):
            for number in range(len(rounds), config.rounds + 1):
                found, charged = self.refresh(number) if config.searches else (None, 0)
                self.train(number, max(config.steps - charged, 1), watch)
                rounds.append(self.finish(number, found))
                report(rounds[-1])

    def refresh(self, number: int) -> tuple[int, int]:
        """Add the failures that a campaign finds to the pool, and return the numbers of failures and of decisions."""
        config = self.config
        policy = self.file(number - 1, self.trainee.suffix)
        place = make_folder(self.folder, "campaigns", f"{number:04d}")
        target = replace(config.target, ads=str(policy))
        failures, decisions = found_failures(target, config.method, config.budget, config.seed + number, place)
        for scenario in failures:
            self.pool.add(scenario)
        return len(failures), decisions

    def train(self, number: int, steps: int, watch: BaseCallback) -> None:
        """Train for one round. The learning rate and the entropy bonus fall over the rounds."""
        left = 1 - (number - 1) / max(self.config.rounds - 1, 1)
        model: Any = self.trainee.model
        if self.trainee.entropy:
            model.ent_coef = self.trainee.entropy * left
        rate = (self.config.rate or self.trainee.rate) * max(left, _LAST_RATE)
        self.trainee.learn(self.config.seed, number, steps, rate, watch)

    def finish(self, number: int, found: int | None) -> Round:
        """Save and validate the policy, and return the result. Round 0 is the policy as it was given."""
        config, policy = self.config, self.file(number, self.trainee.suffix)
        make_folder(self.folder, "rounds")
        save_model(self.trainee.model, self.file(number, ".pt"))
        self.trainee.write(policy)
        if number == 0:
            write_durably(policy, read_file(given_file(config.policy), MAX_BYTES))
        self.pool.write(self.file(number, ".jsonl"))
        outcomes = validation_outcomes(replace(config.target, ads=str(policy)), config.validation)
        result = Round(
            number,
            self.trainee.model.num_timesteps,
            len(outcomes),
            tuple(i for i, one in enumerate(outcomes) if one.at_fault),
            sum(one.passed for one in outcomes),
            len(self.pool),
            self.pool.digest,
            found,
        )
        append_round(self.folder, result)
        return result


def validation_outcomes(target: Target, count: int) -> list[Outcomes]:
    """Drive the scenarios of the validation, which are the same for all policies, and return their outcomes."""
    with start_judge(target, 0) as executor:
        return list(uniform_outcomes(executor, logical_of_target(executor, target.env), count, VALIDATION_SEED))
