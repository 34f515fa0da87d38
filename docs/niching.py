"""Niching against uniform draws in highway-env's own environments: python docs/niching.py OUT.csv FOLDER METHOD...

FOLDER has policies, each with its settings file beside it. A METHOD is a name, with options as NAME:KEY=VALUE,... and
other budgets as NAME*750,3750. Each budget of a campaign is a row of the file: what it found, and its CPU time. Without
a method, the rows that are there are compared.
"""

import csv
import json
import math
import sys
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from behavexplor.bench.statistics import compare, compare_together
from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import Trace
from behavexplor.execution.simulation import Simulation
from behavexplor.fuzz.methods import load_method
from behavexplor.judge.classes import violation_class
from behavexplor.judge.closest_approach import ClosestApproach
from behavexplor.judge.fault import collision_fault, is_at_fault
from behavexplor.judge.situation import bearing_of
from behavexplor.judge.specs import SPECS, judge
from behavexplor.triage.closed_loop import last_chance

BUDGET, SEEDS, IN_FLIGHT, SLOTS = 750, 10, 8, 32
RARE = (0.02, 0.1)  # shares of failures among uniform draws; policies between them are compared together
MEASURES = ("failures", "classes", "cells", "mechanisms")
COLUMNS = ("policy", "env", "method", "seed", *MEASURES, "cpu")
EDGES = (  # of cells: place ahead and to the right, relative speed in these directions, and the ego's speed
    (-7.5, -2.5, 2.5, 7.5, 12.5, 20),
    (-9, -5, -2, 2, 5, 9),
    (-15, -10, -6, -3, 0, 3),
    (-5, -1, 1, 5),
    (4, 8, 12, 16, 20, 24, 28),
)


class Failure(NamedTuple):
    """A failure of a campaign."""

    number: int  # of the execution
    kind: str  # its class
    cell: Any  # of a collision with a vehicle; None for others
    crash: tuple[Scenario, Trace] | None  # of a collision at fault

    @classmethod
    def of(cls, number: int, scenario: Scenario, trace: Trace, violated: tuple[str, ...]) -> "Failure":
        """Describe the failure of an execution."""
        kind = violation_class(trace, violated)
        hit = trace.end == "collision" and trace.partner > 0
        at_fault = hit and is_at_fault(collision_fault(trace, violated))
        return cls(
            number,
            kind.id if kind else violated[0],
            cell(trace) if hit else None,
            (scenario, trace) if at_fault else None,
        )


def cell(trace: Trace) -> tuple[int, ...]:
    """Return where the partner was and how it moved one second before the contact, more finely than a niche."""
    nearest: Any = ClosestApproach.of(trace)
    frame, npc, heading = nearest.frame, nearest.npc, trace.heading[nearest.frame, 0]
    turn = np.array([[math.cos(heading), math.sin(heading)], [-math.sin(heading), math.cos(heading)]])
    place = turn @ (trace.position[frame, npc] - trace.position[frame, 0])
    motion = turn @ (trace.velocity[frame, npc] - trace.velocity[frame, 0])
    values = *place, *motion, math.hypot(*trace.velocity[frame, 0])
    edges = [int(np.digitize(value, own)) for value, own in zip(values, EDGES, strict=True)]
    return *edges, *nearest.niche(trace)[5:]


def mechanism(simulation: Simulation, scenario: Scenario, trace: Trace) -> object:
    """Return the last chance of a crash, and where the partner came from; None if there is no last chance."""
    nearest, chance = ClosestApproach.of(trace), last_chance(simulation, scenario, trace)
    return chance and nearest and (chance, bearing_of(trace, nearest.frame, nearest.npc))


def campaign(episodes: Any, method: Any, in_flight: int, budget: int) -> tuple[list[Failure], list[float]]:
    """Run a campaign in lock-step. Return its failures, and the CPU time after each execution [s]."""
    failures, times, ended = list[Failure](), list[float](), dict[int, Trace]()
    waiting, begun = deque[Any](), time.process_time()
    for number in range(budget):
        while len(waiting) < min(in_flight, budget - number):
            candidate = method.ask()
            waiting.append(candidate)
            episodes.begin(candidate.number, candidate.scenario)
        while number not in ended:
            ended.update(episodes.step())
        candidate, trace = waiting.popleft(), ended.pop(number)
        verdict = judge(trace, SPECS)
        method.tell(candidate, trace, verdict)
        if verdict.violated:
            failures.append(Failure.of(number, candidate.scenario, trace, verdict.violated))
        times.append(time.process_time() - begun)
    return failures, times


def rows(policy: Path, method: str) -> Iterator[tuple[Any, ...]]:
    """Run the campaigns of a method on a policy, and yield a row for each and each of its budgets."""
    settings = yaml.safe_load(policy.with_suffix(".yaml").read_text())
    simulation = Simulation(settings["env"], str(policy), env_config=settings["config"])
    called, _, others = method.partition("*")
    name, _, given = called.partition(":")
    options = {key: json.loads(value) for key, value in (pair.split("=") for pair in given.split(",") if pair)}
    budgets = [int(one) for one in others.split(",") if one] or [BUDGET]
    kind, episodes = load_method(name), simulation.lock_step(SLOTS)
    for seed in range(SEEDS):
        search = kind(simulation.logical, seed, kind.Options(**options))
        failures, times = campaign(episodes, search, SLOTS if name == "uniform" else IN_FLIGHT, max(budgets))
        mechanisms = [one.crash and mechanism(simulation, *one.crash) for one in failures]
        for budget in budgets:
            within = [
                (one.kind, one.cell, of) for one, of in zip(failures, mechanisms, strict=True) if one.number < budget
            ]
            counts = [len({row[column] for row in within} - {None}) for column in range(3)]
            label = called if budget == BUDGET else f"{called}*{budget}"
            yield policy.stem, settings["env"], label, seed, len(within), *counts, round(times[budget - 1], 3)


def print_comparison(path: Path, base: str = "uniform") -> None:
    """Print the means of each method, and A12 against uniform draws with p (Holm over the lines of a measure).

    The last lines are those of all policies whose failures are rare (van Elteren).
    """
    samples: dict[tuple[str, str], dict[str, list[float]]] = {}  # by policy and method, and by measure
    with path.open() as file:
        for row in csv.DictReader(file, COLUMNS):
            own = samples.setdefault((row["policy"], row["method"]), {name: [] for name in (*MEASURES, "cpu")})
            for name, values in own.items():
                values.append(float(row[name]))
    against = {key: samples[key[0], base] for key in samples if key[1] != base and (key[0], base) in samples}
    lines = {key: [f"{np.mean(own['cpu']):6.2f} s"] for key, own in samples.items()}
    shares = {policy: np.mean(own["failures"]) / BUDGET for (policy, method), own in samples.items() if method == base}
    rare = {policy for policy, share in shares.items() if RARE[0] <= share <= RARE[1]}
    for measure in MEASURES:
        for key, own in samples.items():
            lines[key].append(f"{measure} {np.mean(own[measure]):6.1f}")
        pairs = {key: (samples[key][measure], uniform[measure]) for key, uniform in against.items()}
        for key, found in zip(pairs, compare(list(pairs.values())), strict=True):
            lines[key][-1] += f" A12 {found.effect:.2f} p {found.corrected:.3f}"
        strata = {method: [pairs[key] for key in pairs if key[1] == method and key[0] in rare] for _, method in pairs}
        strata = {method: some for method, some in strata.items() if len(some) == len(rare)}
        for method, joint in zip(strata, compare_together(list(strata.values())), strict=True):
            lines.setdefault(("rare", method), []).append(f"{measure} A12 {joint.effect:.2f} p {joint.corrected:.3f}")
    for (policy, method), cells in lines.items():
        print(f"{policy:14} {method:24}", "  ".join(cells))


if __name__ == "__main__":
    out, *others = sys.argv[1:]
    for policy in sorted(Path(others[0]).glob("*.zip")) if others else ():
        for method in others[1:]:
            with Path(out).open("a", newline="") as file:
                csv.writer(file).writerows(rows(policy, method))
    print_comparison(Path(out))
