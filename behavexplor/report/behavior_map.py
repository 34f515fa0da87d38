"""The behaviors of a run: abstract states over time, and a map on which similar behaviors are near each other."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import groupby
from typing import Final

import numpy as np
from threadpoolctl import threadpool_limits

from behavexplor.behavior.features import ATTRIBUTES, STATISTICS, TIME_STEP, Labels
from behavexplor.behavior.miner import BehaviorMiner, MinerOptions
from behavexplor.data.array_types import Floats
from behavexplor.data.trace import Trace

LETTERS: Final = "ABCDEFGHIJ"  # names of the abstract states, the slowest first
_SHOWN: Final = ("speed", "speed-change", "yaw-rate")  # attributes whose means describe a state


@dataclass(frozen=True)
class State:
    """One abstract state."""

    letter: str  # name of the state
    share: float  # share of all windows
    speed: float  # mean speed of the ego [m/s]
    deviation: float  # standard deviation of the speed [m/s]
    acceleration: float  # mean acceleration [m/s2]
    yaw_rate: float  # mean yaw rate [rad/s]


@dataclass(frozen=True)
class Behaviors:
    """Behaviors of the ego in some executions."""

    states: tuple[State, ...]  # abstract states, the slowest first
    # abstract trace of each execution by its number, as indices of `states`, one for each `TIME_STEP`
    labels: Mapping[int, Labels]
    # point of each execution on the map, by its number; distances on the map approximate those of behaviors
    places: Mapping[int, tuple[float, float]]

    def stretches(self, number: int) -> list[tuple[str, int]]:
        """Return the abstract trace of an execution as letters with their numbers of windows."""
        return [(LETTERS[label], sum(1 for _ in same)) for label, same in groupby(self.labels[number].tolist())]

    def text(self, number: int) -> str:
        """Return the abstract trace of an execution as text, such as "A 3.2 s, B 0.4 s"."""
        return ", ".join(f"{letter} {count * TIME_STEP:.1f} s" for letter, count in self.stretches(number))


def find_behaviors(traces: Mapping[int, Trace]) -> Behaviors:
    """Abstract traces with clusters fitted to them. They are given by the numbers of their executions, at least one."""
    miner = BehaviorMiner(MinerOptions(clusters=len(LETTERS)))
    described = [miner.describe(trace) for trace in traces.values()]
    for behavior in described:
        miner.add(behavior)
    miner.fit()
    found = [miner.abstract(behavior) for behavior in described]
    distances = np.stack([miner.distances(labels) for labels in found])
    ranks, states = _states(np.concatenate([behavior.merged for behavior in described]), np.concatenate(found))
    labels = {number: ranks[old] for number, old in zip(traces, found, strict=True)}
    places = {number: (float(x), float(y)) for number, (x, y) in zip(traces, classical_scaling(distances), strict=True)}
    return Behaviors(states, labels, places)


def _states(merged: Floats, labels: Labels) -> tuple[Labels, tuple[State, ...]]:
    """Return the rank of each cluster by speed, and the states; clusters without any window come last."""
    columns = [ATTRIBUTES.index(name) * len(STATISTICS) + STATISTICS.index("mean") for name in _SHOWN]
    means = np.full((len(LETTERS), len(columns)), np.inf)
    deviations = np.zeros(len(LETTERS))
    counts = np.bincount(labels, minlength=len(LETTERS))
    for label in np.flatnonzero(counts):
        here = merged[labels == label][:, columns]
        means[label] = here.mean(axis=0)
        deviations[label] = here[:, 0].std()
    slowest = np.argsort(means[:, 0], kind="stable")
    ranks = np.empty(len(LETTERS), dtype=np.uint8)
    ranks[slowest] = np.arange(len(LETTERS))
    states = tuple(
        State(
            letter=LETTERS[ranks[label]],
            share=float(counts[label] / len(labels)),
            speed=float(means[label, 0]),
            deviation=float(deviations[label]),
            acceleration=_plain(means[label, 1]),
            yaw_rate=_plain(means[label, 2]),
        )
        for label in slowest
        if counts[label]
    )
    return ranks, states


def _plain(value: float) -> float:
    """Round a value for display, without a negative zero."""
    return round(float(value), 2) + 0.0


def classical_scaling(distances: Floats) -> Floats:
    """Lay n points out in the plane by classical multidimensional scaling, at about the given distances, shape (n, n).

    The result has the shape (n, 2). Of the mirror images, each axis has its farthest point on the positive side.
    """
    # scikit-learn's ClassicalMDS gives NaN where an eigenvalue is negative, as for points on a line.
    squared = distances**2
    centered = squared - squared.mean(0) - squared.mean(1)[:, None] + squared.mean()
    with threadpool_limits(limits=1):  # the last bits must not depend on the number of cores
        values, vectors = np.linalg.eigh(-centered / 2)
    points = np.zeros((len(distances), 2))
    largest = np.arange(len(values))[::-1][:2]  # `eigh` gives them last
    for axis, index in enumerate(largest):
        column = vectors[:, index] * np.sqrt(max(values[index], 0.0))
        points[:, axis] = column * (1.0 if column[np.abs(column).argmax()] >= 0 else -1.0)
    return points
