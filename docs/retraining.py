"""Trains policies further, with and without their failures: python docs/retraining.py [FOLDER [PROCESSES]].

Three policies are those that `behavexplor train --env NAME --steps 4000000` makes with seed 0, and one is a policy of
Stable-Baselines3 for highway-env's highway-fast-v0. Each is trained further in three ways: on ordinary scenarios, on
these and the failures of its own training, and on all these and the failures that campaigns find. Every way has the
same number of decisions, those of the campaigns included. Each retraining adds a line to lines.jsonl in FOLDER when it
is finished, and a line that is there is not made again. docs/retraining_tables.py puts the lines into tables.

FOLDER is by default runs/retraining.
"""

import json
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from retraining_tables import FRESH, GIVEN, POOLS

from behavexplor.campaign.config import CONFIG as CAMPAIGN
from behavexplor.campaign.opening import opened
from behavexplor.campaign.run_summary import summarize
from behavexplor.campaign.store import Store
from behavexplor.data.target import Target
from behavexplor.evaluation import start_judge, uniform_outcomes
from behavexplor.execution.simulation import Simulation
from behavexplor.execution.start import logical_of_target
from behavexplor.judge.outcomes import outcomes_of
from behavexplor.repair.retraining import policy_in, retrain, search_config
from behavexplor.repair.retraining_rounds import CONFIG, RetrainingConfig, best

LINES = "lines.jsonl"
ROUNDS = 4
FRESH_SEED = 77  # of the scenarios in which each policy is measured
BUDGET, SEARCH_SEED, HELD_OUT_SEED = 750, 9, 2  # the campaigns that look for failures of the retrained policies


@dataclass(frozen=True)
class Subject:
    """A policy that is trained further.

    Attributes:
        env: its environment.
        policy: the policy.
        steps: number of decisions in each of the rounds.
        method: search method of the campaigns, the best one in this environment as far as docs/results.md shows.
        seeds: number of retrainings with each pool.
    """

    env: str
    policy: str
    steps: int
    method: str
    seeds: int = 5


POLICIES = "docs/data/policies"
SUBJECTS = {
    "S1": Subject("intersection-straight", f"{POLICIES}/intersection-straight.npz", 250_000, "encounters"),
    "S2": Subject("intersection-left", f"{POLICIES}/intersection-left.npz", 250_000, "encounters"),
    "S4": Subject("lane-change", f"{POLICIES}/lane-change.npz", 250_000, "encounters"),
    "S4, longer": Subject("lane-change", f"{POLICIES}/lane-change.npz", 1_000_000, "encounters", seeds=2),
    "highway-fast": Subject("highway-fast-v0", f"{POLICIES}/highway-fast.zip", 50_000, "nsga2"),
}


@dataclass(frozen=True)
class Line:
    """What one retraining came to.

    Attributes:
        subject: name of the policy.
        pool: see `RetrainingConfig.pool`; `GIVEN` for the policy as it was given.
        seed: seed of the retraining.
        chosen: the round that the validation chose.
        validation: share of the validation scenarios with a failure at fault, after each round.
        failures: numbers of the `FRESH` scenarios in which the policy fails by its own fault.
        last: numbers of those in which the policy of the last round does so.
        found: number of failures at fault that a campaign finds in it.
        classes: number of their classes.
        held_out: number of the failures at fault of another campaign, on the policy as it was given, that are left.
    """

    subject: str
    pool: str
    seed: int
    chosen: int
    validation: Sequence[float]
    failures: Sequence[int]
    last: Sequence[int]
    found: int
    classes: int
    held_out: int


def retrained(folder: Path, name: str, pool: str, seed: int) -> Line:
    """Train a policy further, and measure the one that the validation chooses."""
    subject, place = SUBJECTS[name], folder / name / f"{pool}-{seed}"
    line = Line(name, pool, seed, 0, (), (), (), 0, 0, 0)
    if pool == GIVEN:
        return measured(line, subject.policy, subject.policy, folder)
    values: Any = {"pool": pool, "rounds": ROUNDS, "steps": subject.steps, "seed": seed, "method": subject.method}
    config = RetrainingConfig(subject.env, subject.policy, **values)
    place.mkdir(parents=True, exist_ok=True)
    (place / CONFIG).write_text(config.to_yaml())
    rounds = retrain(config, place, lambda _: None, lambda _: None)
    line = replace(line, chosen=best(rounds).number, validation=[one.at_fault for one in rounds])
    policy = policy_in(place, config)
    return measured(line, str(policy), str(place / "rounds" / f"round-{ROUNDS:04d}{policy.suffix}"), folder)


def measured(line: Line, policy: str, last: str, folder: Path) -> Line:
    """Return a line with the measurements of its policy, and of that of the last round."""
    subject, place = SUBJECTS[line.subject], folder / line.subject
    target = Target(subject.env, policy, unconfined=True)
    known, fresh = place / "held-out", place / f"{line.pool}-{line.seed}" / "campaign"
    if line.pool == GIVEN:  # before all others, which only read it
        search(target, subject.method, HELD_OUT_SEED, known)
    search(target, subject.method, SEARCH_SEED, fresh)
    with closing(Store.read(known)) as store:
        held_out = [one.scenario for one in store.executions() if one.record.at_fault]
    driven = Simulation(target.env, policy).run_all(held_out)
    left = sum(outcomes_of(trace).at_fault for _, trace in driven)
    found = summarize(fresh)
    return replace(
        line,
        failures=fresh_failures(target),
        last=fresh_failures(replace(target, ads=last)),
        found=found.at_fault,
        classes=sum(one.at_fault > 0 for one in found.classes),
        held_out=left,
    )


def fresh_failures(target: Target) -> list[int]:
    """Return the numbers of the fresh scenarios in which a policy fails by its own fault."""
    with start_judge(target, 0) as judge:
        drawn = uniform_outcomes(judge, logical_of_target(judge, target.env), FRESH, FRESH_SEED)
        return [i for i, one in enumerate(drawn) if one.at_fault]


def search(target: Target, method: str, seed: int, folder: Path) -> None:
    """Run a campaign in a folder, or finish it."""
    config = search_config(target, method, BUDGET, seed)
    with opened(config, folder, 0, resume=(folder / CAMPAIGN).is_file()) as ready:
        ready.campaign.run(lambda _: None)


def read_lines(folder: Path) -> list[Line]:
    """Return the lines that have been made."""
    path = folder / LINES
    return [Line(**json.loads(text)) for text in path.read_text().splitlines()] if path.is_file() else []


def make_lines(folder: Path, processes: int) -> None:
    """Make the lines that are missing: first those of the policies as they were given, then policy by policy."""
    folder.mkdir(parents=True, exist_ok=True)
    made = {(line.subject, line.pool, line.seed) for line in read_lines(folder)}
    given = [(name, GIVEN, 0) for name in SUBJECTS]
    others = [(name, pool, seed) for name, one in SUBJECTS.items() for seed in range(one.seeds) for pool in POOLS]
    with ProcessPoolExecutor(processes, get_context("spawn")) as executor:
        for stage in (given, others):
            futures = [executor.submit(retrained, folder, *job) for job in stage if job not in made]
            try:
                for future in as_completed(futures):
                    with (folder / LINES).open("a") as file:
                        file.write(json.dumps(asdict(future.result())) + "\n")
            finally:
                for future in futures:
                    future.cancel()


if __name__ == "__main__":
    given_folder, given_processes = (*sys.argv[1:], *("runs/retraining", "2")[len(sys.argv) - 1 :])
    make_lines(Path(given_folder), int(given_processes))
