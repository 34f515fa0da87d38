"""Niching against uniform draws in highway-env's own environments: python docs/niching.py OUT.csv FOLDER METHOD...

FOLDER has policies, each with its settings file beside it. A METHOD is a name, with options as NAME:KEY=VALUE,... and
another budget as NAME*1000. Each campaign is a row of the file: what it found, and its CPU time. Without a method, the
rows that are there are compared.
"""

import csv
import json
import math
import sys
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from behavexplor.bench.statistics import a12, holm, mann_whitney
from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import Trace
from behavexplor.execution.simulation import Simulation
from behavexplor.fuzz.methods import load_method
from behavexplor.judge.classes import violation_class
from behavexplor.judge.closest_approach import ClosestApproach
from behavexplor.judge.fault import collision_fault, is_at_fault
from behavexplor.judge.situation import bearing_of
from behavexplor.judge.specs import SPECS, judge
from behavexplor.triage.last_chance import last_chance

BUDGET, SEEDS, IN_FLIGHT, SLOTS = 750, 10, 8, 32
MEASURES = ("failures", "classes", "cells", "mechanisms")
COLUMNS = ("policy", "env", "method", "seed", *MEASURES, "cpu")
EDGES = (  # of cells: place ahead and to the right, relative speed in these directions, and the ego's speed
    (-7.5, -2.5, 2.5, 7.5, 12.5, 20),
    (-9, -5, -2, 2, 5, 9),
    (-15, -10, -6, -3, 0, 3),
    (-5, -1, 1, 5),
    (4, 8, 12, 16, 20, 24, 28),
)


class Found:
    """What a campaign has found: failures, their classes, cells, and the crashes at fault."""

    def __init__(self) -> None:
        self.failures = 0
        self.classes: set[str] = set()
        self.cells: set[Any] = set()
        self.crashes: list[tuple[Scenario, Trace]] = []

    def add(self, scenario: Scenario, trace: Trace, violated: tuple[str, ...]) -> None:
        """Count an execution."""
        if not violated:
            return
        self.failures += 1
        kind = violation_class(trace, violated)
        self.classes.add(kind.id if kind else violated[0])
        if trace.end == "collision" and trace.partner > 0:
            self.cells.add(cell(trace))
            if is_at_fault(collision_fault(trace, violated)):
                self.crashes.append((scenario, trace))


def cell(trace: Trace) -> tuple[int, ...]:
    """Return where the partner was and how it moved one second before the contact, more finely than a niche."""
    nearest: Any = ClosestApproach.of(trace)
    frame, npc, heading = nearest.frame, nearest.npc, trace.heading[nearest.frame, 0]
    turn = np.array([[math.cos(heading), math.sin(heading)], [-math.sin(heading), math.cos(heading)]])
    place = turn @ (trace.position[frame, npc] - trace.position[frame, 0])
    motion = turn @ (trace.velocity[frame, npc] - trace.velocity[frame, 0])
    values = *place, *motion, math.hypot(*trace.velocity[frame, 0])
    edges = [int(np.digitize(value, own)) for value, own in zip(values, EDGES, strict=True)]
    return *edges, *nearest.niche(trace)[3:]


def mechanism(simulation: Simulation, scenario: Scenario, trace: Trace) -> object:
    """Return the last chance of a crash, and where the partner came from; None if there is no last chance."""
    nearest, chance = ClosestApproach.of(trace), last_chance(simulation, scenario, trace)
    return chance and nearest and (chance, bearing_of(trace, nearest.frame, nearest.npc))


def campaign(episodes: Any, method: Any, in_flight: int, budget: int) -> Found:
    """Run a campaign in lock-step."""
    found, ended = Found(), dict[int, Trace]()
    waiting: deque[Any] = deque()
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
        found.add(candidate.scenario, trace, verdict.violated)
    return found


def rows(policy: Path, method: str) -> Iterator[tuple[Any, ...]]:
    """Run the campaigns of a method on a policy, and yield a row for each."""
    settings = yaml.safe_load(policy.with_suffix(".yaml").read_text())
    simulation = Simulation(settings["env"], str(policy), env_config=settings["config"])
    called, _, budget = method.partition("*")
    name, _, given = called.partition(":")
    options = {key: json.loads(value) for key, value in (pair.split("=") for pair in given.split(",") if pair)}
    kind, episodes = load_method(name), simulation.lock_step(SLOTS)
    for seed in range(SEEDS):
        begun = time.process_time()
        search = kind(simulation.logical, seed, kind.Options(**options))
        found = campaign(episodes, search, SLOTS if name == "uniform" else IN_FLIGHT, int(budget or BUDGET))
        cpu = time.process_time() - begun
        mechanisms = {mechanism(simulation, *crash) for crash in found.crashes} - {None}
        counts = found.failures, len(found.classes), len(found.cells), len(mechanisms)
        yield policy.stem, settings["env"], method, seed, *counts, round(cpu, 3)


def compare(path: Path, base: str = "uniform") -> None:
    """Print the means of each method, and A12 against uniform draws with p (Mann-Whitney, Holm over a table)."""
    with path.open() as file:
        stored = list(csv.DictReader(file, COLUMNS))
    samples: dict[tuple[str, str, str], list[float]] = {}
    for row in stored:
        for measure in (*MEASURES, "cpu"):
            samples.setdefault((row["policy"], row["method"], measure), []).append(float(row[measure]))
    policies, methods = (list(dict.fromkeys(row[column] for row in stored)) for column in ("policy", "method"))
    pairs = [key for key in samples if key[1] != base and key[2] != "cpu"]
    tests = [mann_whitney(samples[key], samples[key[0], base, key[2]]) for key in pairs]
    corrected = dict(zip(pairs, holm(tests), strict=True))
    for policy in policies:
        for method in [one for one in methods if (policy, one, "cpu") in samples]:
            cells = [f"{np.mean(samples[policy, method, 'cpu']):6.2f} s"]
            for measure in MEASURES:
                own, text = samples[policy, method, measure], ""
                if method != base:
                    effect = a12(own, samples[policy, base, measure])
                    text = f" A12 {effect:.2f} p {corrected[policy, method, measure]:.3f}"
                cells.append(f"{measure} {np.mean(own):6.1f}{text}")
            print(f"{policy:14} {method:24}", "  ".join(cells))


if __name__ == "__main__":
    out, *others = sys.argv[1:]
    for policy in sorted(Path(others[0]).glob("*.zip")) if others else ():
        for method in others[1:]:
            with Path(out).open("a", newline="") as file:
                csv.writer(file).writerows(rows(policy, method))
    compare(Path(out))
