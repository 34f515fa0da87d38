"""Retraining of a policy on the scenarios in which it fails, in resumable rounds.

A round searches for failures of the present policy (if the pool is to have found ones), trains the policy on a mixture
of these scenarios and ordinary ones, and validates it as it is driven, without chance.
"""

import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar, Final, Literal, Self

import numpy as np
import torch
import yaml
from pydantic import ConfigDict
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm

from behavexplor.ads.learned.driver import POLICY_FREQUENCY
from behavexplor.ads.learned.network_file import TrainedNetwork, read_network, write_network
from behavexplor.ads.learned.shipped import policy_file
from behavexplor.campaign.store import write_durably
from behavexplor.data.target import Target
from behavexplor.data.trace import ARRIVED
from behavexplor.errors import InputError
from behavexplor.evaluation import estimate_rates, start_judge
from behavexplor.execution.simulation import logical_scenario
from behavexplor.judge.fault import NPC_CAUSED, own_violations
from behavexplor.judge.specs import judge
from behavexplor.repair.finding import found_failures
from behavexplor.repair.scenario_pool import Pool, read_pool
from behavexplor.training import (
    Learned,
    TrainingConfig,
    Watch,
    begin_stage,
    log_formats,
    network_layers,
    new_model,
    restore_model,
    save_model,
    training_env,
)

CONFIG, ROUNDS, NETWORK = "retraining.yaml", "rounds.jsonl", "policy.npz"
VALIDATION_SEED: Final = 1_000_003  # seed of the scenarios by which the best round is chosen
_ENTROPY: Final = 0.005  # entropy bonus of the first round, which falls to none
_LAST_RATE: Final = 0.2  # learning rate of the last round, as a share of that of the first one

Sources = Literal["none", "own", "found", "both"]


@dataclass(frozen=True)
class RetrainingConfig:
    """The configuration of a retraining.

    Attributes:
        env: functional scenario.
        policy: the policy: "learned:NAME", or the file of a network that `train` made.
        pool: scenarios that enter the pool: none; those in which the training itself fails ("own"); failures that
            campaigns find ("found"); or both.
        share: probability that an episode is drawn from the pool.
        rounds: number of rounds of training.
        steps: number of decisions in a round, the campaign's included.
        seed: random seed.
        envs: number of sub-environments in lock-step.
        rate: learning rate of the first round.
        method: search method of the campaigns.
        budget: number of executions in each campaign.
        validation: number of scenarios by which the best round is chosen.

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
    envs: int = 64
    rate: float = 2.5e-4
    method: str = "uniform"
    budget: int = 250
    validation: int = 1000

    def __post_init__(self) -> None:
        ranges = {
            "share": (0.0, 0.95),
            "rounds": (1, 1000),
            "steps": (1, 10**9),
            "seed": (0, 2**63 - 1),
            "rate": (1e-7, 0.1),
            "budget": (1, 100_000),
            "validation": (1, 100_000),
        }
        for name, (low, high) in ranges.items():
            if not low <= getattr(self, name) <= high:
                raise InputError(f"{name} {getattr(self, name)} must lie between {low:g} and {high:g}")

    def to_yaml(self) -> str:
        """Return the whole configuration as YAML."""
        return yaml.safe_dump(asdict(self), sort_keys=False)

    @property
    def training(self) -> TrainingConfig:
        """The configuration of the training in each round."""
        layers = tuple(len(bias) for _, bias in read_network(policy_file(self.policy)).layers[:-1])
        return TrainingConfig(env=self.env, seed=self.seed, envs=self.envs, layers=layers)


@dataclass(frozen=True)
class Round:
    """The result of a round.

    Attributes:
        number: number of the round; 0 for the policy as it was given.
        steps: number of decisions in which the policy was trained so far.
        at_fault: share of the validation scenarios in which the policy did not arrive, without those in which another
            vehicle caused a collision.
        arrived: share of the validation scenarios in which it arrived.
        pool: number of scenarios in the pool at the end of the round.
        digest: digest of the pool.
        found: number of failures that the round's campaign found, or None without a campaign.
    """

    number: int
    steps: int
    at_fault: float
    arrived: float
    pool: int = 0
    digest: str = ""
    found: int | None = None

    @classmethod
    def from_json(cls, line: str) -> Self:
        """Return the round that a line of `ROUNDS` describes."""
        return cls(**json.loads(line))


def retrain(
    config: RetrainingConfig, folder: Path, observe: Callable[[Learned], None], report: Callable[[Round], None]
) -> list[Round]:
    """Retrain a policy. If the folder has finished rounds, the retraining resumes after the last one.

    Args:
        config: configuration of the retraining.
        folder: folder for the rounds and the best policy, `NETWORK`.
        observe: callback that gets the progress of a round after each batch of experience.
        report: callback that gets each finished round.

    Returns:
        All rounds. The best one has the lowest rate at fault in the validation, then the most arrivals.

    Raises:
        InputError: if the policy or the environment cannot be used, or a file of the folder cannot be read.
    """
    torch.set_num_threads(1)  # more threads change the last bits
    training = config.training
    venv = training_env(training)
    envs: Any = venv.venv
    model = new_model(training, venv)
    rounds = finished_rounds(folder)
    pool = Pool(envs.env.logical, config.share, _pool_of(folder, rounds))
    if rounds:
        restore_model(model, _file(folder, rounds[-1].number, ".pt"))
    else:
        _load_layers(model, policy_file(config.policy))
        rounds = [_finished(config, folder, model, 0, pool, None)]
        report(rounds[-1])
    envs.env.sampler = pool.sample
    model.set_logger(configure(str(folder / "logs" / f"round-{len(rounds):04d}"), log_formats()))
    watch = _PoolWatch(observe, pool, own=config.pool in ("own", "both"))
    try:
        for number in range(len(rounds), config.rounds + 1):
            found, charged = None, 0
            if config.pool in ("found", "both"):
                found, charged = _refresh(config, folder, number, pool)
            _train(config, model, venv, number, max(config.steps - charged, 1), watch)
            rounds.append(_finished(config, folder, model, number, pool, found))
            report(rounds[-1])
    finally:
        model.logger.close()
        venv.close()
    shutil.copyfile(_file(folder, best(rounds).number, ".npz"), folder / NETWORK)
    return rounds


def best(rounds: list[Round]) -> Round:
    """Return the round with the lowest rate at fault, then the most arrivals, then the fewest steps."""
    return min(rounds, key=lambda one: (one.at_fault, -one.arrived, one.steps))


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


def _train(
    config: RetrainingConfig, model: OnPolicyAlgorithm, venv: Any, number: int, steps: int, watch: BaseCallback
) -> None:
    """Train for one round. In the first one, only the new critic learns, for as many steps again before."""
    left = 1 - (number - 1) / max(config.rounds - 1, 1)
    rate = config.rate * max(left, _LAST_RATE)
    model.ent_coef = _ENTROPY * left
    if number == 1:
        _freeze(model, frozen=True)
        begin_stage(model, venv, (config.seed, 0), config.rate)
        model.learn(steps, reset_num_timesteps=False)
        _freeze(model, frozen=False)
    begin_stage(model, venv, (config.seed, number), rate)
    model.learn(steps, callback=watch, reset_num_timesteps=False)


def _refresh(config: RetrainingConfig, folder: Path, number: int, pool: Pool) -> tuple[int, int]:
    """Add what a campaign on the present policy finds, and return how much that is, and how many decisions it took."""
    network = _file(folder, number - 1, ".npz")
    place = folder / "campaigns" / f"{number:04d}"
    failures, seconds = found_failures(config.env, network, config.method, config.budget, config.seed + number, place)
    for scenario in failures:
        pool.add(scenario)
    return len(failures), round(seconds * POLICY_FREQUENCY)


def _finished(
    config: RetrainingConfig, folder: Path, model: OnPolicyAlgorithm, number: int, pool: Pool, found: int | None
) -> Round:
    """Save and validate a model, and return the result."""
    network = _file(folder, number, ".npz")
    network.parent.mkdir(parents=True, exist_ok=True)
    save_model(model, _file(folder, number, ".pt"))
    if number == 0:
        shutil.copyfile(policy_file(config.policy), network)
    else:
        write_network(network, TrainedNetwork(network_layers(model)))
    pool.write(_file(folder, number, ".jsonl"))
    at_fault, arrived = validated_rates(config.env, network, config.validation)
    result = Round(number, model.num_timesteps, at_fault, arrived, len(pool), pool.digest, found)
    earlier = (folder / ROUNDS).read_text() if (folder / ROUNDS).is_file() else ""
    write_durably(folder / ROUNDS, earlier + json.dumps(asdict(result)) + "\n")
    return result


def validated_rates(env: str, network: Path, count: int, seed: int = VALIDATION_SEED) -> tuple[float, float]:
    """Return the rates of failures at fault and of arrivals of a policy."""
    with start_judge(Target(env, str(network)), 0) as executor:  # the network is plain numbers
        found = estimate_rates(executor, logical_scenario(env), count, seed)
    others = sum(found.counts.get(f"collision: {fault}", 0) for fault in NPC_CAUSED)
    return (found.n - found.counts[ARRIVED] - others) / found.n, found.rate(ARRIVED)


def _file(folder: Path, number: int, suffix: str) -> Path:
    return folder / "rounds" / f"round-{number:04d}{suffix}"


def _pool_of(folder: Path, rounds: list[Round]) -> list[Any]:
    return read_pool(_file(folder, rounds[-1].number, ".jsonl")) if rounds else []


def _load_layers(model: OnPolicyAlgorithm, path: Path) -> None:
    """Put the weights of a network into a new model, whose critic stays new."""
    parts = _policy_layers(model)
    for part, (weights, bias) in zip(parts, read_network(path).layers, strict=True):
        part.weight.data = torch.as_tensor(weights, dtype=torch.float32)
        part.bias.data = torch.as_tensor(bias, dtype=torch.float32)


def _policy_layers(model: OnPolicyAlgorithm) -> list[torch.nn.Linear]:
    policy: Any = model.policy
    parts = [*policy.mlp_extractor.policy_net, policy.action_net]
    return [part for part in parts if isinstance(part, torch.nn.Linear)]


def _freeze(model: OnPolicyAlgorithm, *, frozen: bool) -> None:
    for layer in _policy_layers(model):
        layer.requires_grad_(not frozen)


class _PoolWatch(Watch):
    """Callback that keeps a pool up to date with the ends of the training's episodes."""

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

    def _ended(self, scenario: Any, info: Mapping[str, Any]) -> None:
        trace = info["trace"]
        if not own_violations(trace, judge(trace).violated):
            self._pool.discard(scenario)
        elif self._own:
            self._pool.add(scenario)
