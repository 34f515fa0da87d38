"""The configuration of a retraining, and the results of its rounds."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import yaml
from pydantic import ConfigDict

from behavexplor.campaign.provenance import Claim, code_of
from behavexplor.data.conventions import MOST_ENVS
from behavexplor.data.drawn_scenario import DEFAULT, Traffic
from behavexplor.data.durable import write_durably
from behavexplor.data.target import Target
from behavexplor.data.untrusted import read_file
from behavexplor.data.validation import between, validated
from behavexplor.errors import InputError

CONFIG, ROUNDS = "retraining.yaml", "rounds.jsonl"

Sources = Literal["none", "own", "found", "both"]


class DivergedError(Exception):
    """A training has diverged: the network has weights that are not finite numbers."""

    def __init__(self, number: int) -> None:
        super().__init__(
            f"the training diverged in round {number}, that is, the network has weights that are not finite numbers: "
            "retrain it with a smaller --rate in another folder"
        )


@validated
class RetrainingConfig:
    """The configuration of a retraining.

    Attributes:
        env: Environment: S1 to S4, one of highway-env's own such as highway-fast-v0, or "module:id".
        policy: The policy: "learned:NAME", the file of a network that `train` made, or a model of Stable-Baselines3.
        pool: Scenarios in which the policy fails, mixed into its training: "none"; "own" (found in this training);
            "found" (by campaigns); or "both".
        share: Probability that the scenario of an episode comes from this pool. While the pool has fewer than 100
            scenarios, it is lower in proportion.
        rounds: Number of rounds. Each trains and validates; with --pool found or both, a search comes first.
        steps: Number of decisions in a round, including those of the campaign, but not those that train a new critic or
            fill a replay buffer.
        seed: Random seed. The same seed gives the same policy on the same kind of machine.
        envs: Number of environments in lock-step.
        rate: Learning rate of the first round.
        method: Search method of the campaigns.
        budget: Number of executions of each campaign.
        validation: Number of scenarios in which each round is validated, to choose the best one.
        env_config: Configuration of the environment as in the policy's training, as far as it differs from what the
            policy declares: keys of highway-env (docs/highway-env.md).
        traffic: Traffic in highway-env's own environments: their own, or a wider range (docs/highway-policies.md).
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")

    env: str
    policy: str
    pool: Sources = "own"
    share: Annotated[float, between(0, 0.95)] = 0.5
    rounds: Annotated[int, between(1, 1000)] = 8
    steps: Annotated[int, between(1, 10**9)] = 250_000
    seed: Annotated[int, between(0, 2**63 - 1)] = 0
    # None for the number in the model's file, or 64 for a network
    envs: Annotated[int, between(1, MOST_ENVS)] | None = None
    # None for the rate in the model's file, or 2.5e-4 if it has none
    rate: Annotated[float, between(1e-7, 0.1)] | None = None
    method: str = "uniform"
    budget: Annotated[int, between(1, 100_000)] = 250
    validation: Annotated[int, between(1, 100_000)] = 1000
    env_config: dict[str, Any] = field(default_factory=dict)
    traffic: Traffic = DEFAULT

    def to_yaml(self) -> str:
        """Return the whole configuration as YAML."""
        return yaml.safe_dump(asdict(self), sort_keys=False)

    @property
    def claim(self) -> Claim:
        """What the configuration says that may have code run. A policy's file is read without running code."""
        code = code_of(self.env, method=self.method if self.searches else "", env_config=self.env_config)
        return Claim(Path(CONFIG), asdict(self), code)

    @property
    def searches(self) -> bool:
        """True if each round begins with a campaign."""
        return self.pool in ("found", "both")

    @property
    def target(self) -> Target:
        """The policy and its environment."""
        # Nothing in the policy's file is executed, so no process has to confine it.
        return Target(self.env, self.policy, unconfined=True, env_config=self.env_config or None, traffic=self.traffic)


@dataclass(frozen=True)
class Round:
    """The result of a round."""

    number: int  # number of the round; 0 for the policy as it was given
    steps: int  # number of decisions in all training so far
    validated: int  # number of scenarios in the validation
    failures: tuple[int, ...]  # numbers of the validation scenarios in which the policy failed by its own fault
    passed: int  # number of validation scenarios without any failure
    pool: int = 0  # number of scenarios in the pool at the end of the round
    digest: str = ""  # SHA-256 of the scenarios in the pool
    # number of failures worth training on that the round's campaign found; None without a campaign
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
        """Return in how many validation scenarios the policy failed by its own fault before, and no longer does."""
        return len(set(before.failures) - set(self.failures))

    def broken(self, before: Self) -> int:
        """Return in how many validation scenarios the policy fails by its own fault now, and did not before."""
        return len(set(self.failures) - set(before.failures))


def best(rounds: list[Round]) -> Round:
    """Return the round with the lowest at-fault rate. Ties go to more passed scenarios, then to fewer steps."""
    return min(rounds, key=lambda one: (one.at_fault, -one.passed, one.steps))


def finished_rounds(folder: Path) -> list[Round]:
    """Return the finished rounds of a folder.

    Raises:
        InputError: if the file of the rounds cannot be read.
    """
    path = folder / ROUNDS
    if not path.is_file():
        return []
    try:
        return [Round.from_json(line) for line in read_file(path).decode().splitlines()]
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"{path} cannot be read: {error}; delete its last line to resume from the round before"
        ) from None


def append_round(folder: Path, finished: Round) -> None:
    """Add a finished round to the folder's file of rounds."""
    path = folder / ROUNDS
    earlier = read_file(path).decode() if path.is_file() else ""
    write_durably(path, earlier + json.dumps(asdict(finished)) + "\n")
