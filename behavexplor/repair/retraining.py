"""Retraining of a policy on the scenarios in which it fails, in resumable rounds.

A round searches for failures of the present policy if the configuration asks for them. It trains the policy on a
mixture of ordinary scenarios and those in which the policy fails. Then it validates the policy as it is driven, without
chance.
"""

import json
import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Final, Literal, Self

import torch
import yaml
from pydantic import ConfigDict
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure

from behavexplor.ads.sb3.continuing import MOST_ENVS
from behavexplor.campaign.store import write_durably
from behavexplor.data.drawn_scenario import DEFAULT
from behavexplor.data.target import Target
from behavexplor.errors import InputError
from behavexplor.evaluation import Outcomes, start_judge, uniform_outcomes
from behavexplor.execution.start import logical_of_target
from behavexplor.repair.finding import found_failures
from behavexplor.repair.pool_watch import PoolWatch
from behavexplor.repair.scenario_pool import Pool, read_pool
from behavexplor.repair.trainees import Trainee, copy_policy, given_file, open_trainee
from behavexplor.training import Learned, log_formats, restore_model, save_model

CONFIG, ROUNDS = "retraining.yaml", "rounds.jsonl"
VALIDATION_SEED: Final = 1_000_003  # seed of the scenarios by which the best round is chosen
_LAST_RATE: Final = 0.2  # learning rate of the last round, as a share of that of the first one

Sources = Literal["none", "own", "found", "both"]


@dataclass(frozen=True)
class RetrainingConfig:
    """The configuration of a retraining.

    Attributes:
        env: functional scenario, or environment of highway-env.
        policy: the policy: "learned:NAME", the file of a network that `train` made, or a model of Stable-Baselines3.
        pool: scenarios that enter the pool: none; those in which the training itself fails ("own"); failures that
            campaigns find ("found"); or both.
        share: probability that an episode is drawn from the pool.
        rounds: number of rounds of training.
        steps: number of decisions in a round, including those of the campaign. The training of a new critic and the
            filling of a replay buffer come on top.
        seed: random seed.
        envs: number of sub-environments in lock-step; None for the number in the model's file, or 64 for a network.
        rate: learning rate of the first round; None for that in the model's file, or 2.5e-4 if there is none.
        method: search method of the campaigns.
        budget: number of executions in each campaign.
        validation: number of scenarios by which the best round is chosen.
        env_config: configuration of the environment, as far as it differs from what the policy declares.
        traffic: kind of traffic in an environment of highway-env.

    Raises:
        InputError: if a value is out of range.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")

    env: str
    policy: str
    pool: Sources = "both"
    share: float = 0.5
    rounds: int = 8
    steps: int = 250_000
    seed: int = 0
    envs: int | None = None
    rate: float | None = None
    method: str = "uniform"
    budget: int = 250
    validation: int = 1000
    env_config: dict[str, Any] = field(default_factory=dict)
    traffic: Literal["default", "wide"] = DEFAULT

    def __post_init__(self) -> None:
        ranges = {
            "share": (0.0, 0.95),
            "rounds": (1, 1000),
            "steps": (1, 10**9),
            "seed": (0, 2**63 - 1),
            "envs": (1, MOST_ENVS),
            "rate": (1e-7, 0.1),
            "budget": (1, 100_000),
            "validation": (1, 100_000),
        }
        for name, (low, high) in ranges.items():
            if getattr(self, name) is not None and not low <= getattr(self, name) <= high:
                raise InputError(f"{name} {getattr(self, name)} must lie between {low:g} and {high:g}")

    def to_yaml(self) -> str:
        """Return the whole configuration as YAML."""
        return yaml.safe_dump(asdict(self), sort_keys=False)

    @property
    def target(self) -> Target:
        """The policy and its environment."""
        # Nothing in the policy's file is executed, so no process has to confine it.
        return Target(self.env, self.policy, unconfined=True, env_config=self.env_config, traffic=self.traffic)


@dataclass(frozen=True)
class Round:
    """The result of a round.

    Attributes:
        number: number of the round; 0 for the policy as it was given.
        steps: number of decisions in which the policy was trained so far.
        validated: number of scenarios in the validation.
        failures: numbers of those in which the policy failed by its own fault.
        passed: number of those without any failure.
        pool: number of scenarios in the pool at the end of the round.
        digest: digest of the pool.
        found: number of failures that the round's campaign found, or None without a campaign.
    """

    number: int
    steps: int
    validated: int
    failures: tuple[int, ...]
    passed: int
    pool: int = 0
    digest: str = ""
    found: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "failures", tuple(self.failures))  # JSON has lists only

    @classmethod
    def from_json(cls, line: str) -> Self:
        """Return the round that a line of `ROUNDS` describes."""
        return cls(**json.loads(line))

    @property
    def at_fault(self) -> float:
        """Share of the validation scenarios in which the policy failed by its own fault."""
        return len(self.failures) / self.validated

    def fixed(self, before: Self) -> int:
        """Return in how many validation scenarios the policy no longer fails by its own fault."""
        return len(set(before.failures) - set(self.failures))

    def broken(self, before: Self) -> int:
        """Return in how many validation scenarios the policy fails by its own fault, and did not before."""
        return len(set(self.failures) - set(before.failures))


def retrain(
    config: RetrainingConfig, folder: Path, observe: Callable[[Learned], None], report: Callable[[Round], None]
) -> list[Round]:
    """Retrain a policy. If the folder has finished rounds, the retraining resumes after the last one.

    Args:
        config: configuration of the retraining.
        folder: folder for the rounds and the best policy, see `policy_in`.
        observe: callback that gets the progress of a round after each batch of experience.
        report: callback that gets each finished round.

    Returns:
        All rounds; see `best`.

    Raises:
        InputError: if the policy or the environment cannot be used, or a file of the folder cannot be read.
    """
    torch.set_num_threads(1)  # more threads change the last bits
    trainee = open_trainee(config.target, config.seed, config.envs)
    rounds = finished_rounds(folder)
    pool = Pool(trainee.scenarios.logical, config.share, _pool_of(folder, rounds))
    trainee.scenarios.sampler = pool.sample
    work = _Work(config, folder, trainee, pool)
    if rounds:
        restore_model(trainee.model, work.file(rounds[-1].number, ".pt"))
    else:
        rounds = [work.finish(0, None)]
        report(rounds[-1])
    trainee.model.set_logger(configure(str(folder / "logs" / f"round-{len(rounds):04d}"), log_formats()))
    watch = PoolWatch(observe, pool, own=config.pool in ("own", "both"))
    try:
        for number in range(len(rounds), config.rounds + 1):
            found, charged = work.refresh(number) if config.pool in ("found", "both") else (None, 0)
            work.train(number, max(config.steps - charged, 1), watch)
            rounds.append(work.finish(number, found))
            report(rounds[-1])
    finally:
        trainee.model.logger.close()
        trainee.venv.close()
    copy_policy(work.file(best(rounds).number, trainee.suffix), policy_in(folder, config))
    return rounds


def check(config: RetrainingConfig) -> None:
    """Check that a policy can be trained further.

    Raises:
        InputError: if it cannot; the message says why.
    """
    open_trainee(config.target, config.seed, config.envs).venv.close()


def policy_in(folder: Path, config: RetrainingConfig) -> Path:
    """Return the path of the best policy."""
    return folder / f"policy{given_file(config.policy).suffix}"


def best(rounds: list[Round]) -> Round:
    """Return the round with the lowest rate at fault, then the most passed scenarios, then the fewest steps."""
    return min(rounds, key=lambda one: (one.at_fault, -one.passed, one.steps))


def finished_rounds(folder: Path) -> list[Round]:
    """Return the finished rounds of a folder.

    Raises:
        InputError: if their file cannot be read.
    """
    path = folder / ROUNDS
    if not path.is_file():
        return []
    try:
        return [Round.from_json(line) for line in path.read_text().splitlines()]
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"{path} cannot be read: {error}; delete its last line to resume from the round before"
        ) from None


@dataclass(frozen=True)
class _Work:
    """The work of a round.

    Attributes:
        config: configuration of the retraining.
        folder: folder of the retraining.
        trainee: the policy.
        pool: the pool.
    """

    config: RetrainingConfig
    folder: Path
    trainee: Trainee
    pool: Pool

    def file(self, number: int, suffix: str) -> Path:
        """Return the path of a round's file."""
        return self.folder / "rounds" / f"round-{number:04d}{suffix}"

    def refresh(self, number: int) -> tuple[int, int]:
        """Add what a campaign on the present policy finds; return how much that is, and how many decisions it took."""
        config = self.config
        policy, place = self.file(number - 1, self.trainee.suffix), self.folder / "campaigns" / f"{number:04d}"
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
        policy.parent.mkdir(parents=True, exist_ok=True)
        save_model(self.trainee.model, self.file(number, ".pt"))
        self.trainee.write(policy)
        if number == 0:
            shutil.copyfile(given_file(config.policy), policy)
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
        earlier = (self.folder / ROUNDS).read_text() if (self.folder / ROUNDS).is_file() else ""
        write_durably(self.folder / ROUNDS, earlier + json.dumps(asdict(result)) + "\n")
        return result


def validation_outcomes(target: Target, count: int) -> list[Outcomes]:
    """Drive the scenarios of the validation, which are the same for all policies, and return their outcomes."""
    with start_judge(target, 0) as executor:
        return list(uniform_outcomes(executor, logical_of_target(executor, target.env), count, VALIDATION_SEED))


def _pool_of(folder: Path, rounds: list[Round]) -> list[Any]:
    return read_pool(folder / "rounds" / f"round-{rounds[-1].number:04d}.jsonl") if rounds else []
