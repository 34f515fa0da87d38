"""AVFuzzer: a genetic algorithm for high risk, with restarts in unexplored regions and a local fuzzer.

Source: Li et al., "AV-Fuzzer: Finding Safety Violations in Autonomous Driving Systems", ISSRE 2020. In this
implementation, a gene is an NPC, a slice is a waypoint, and a maneuver is a route. Docstrings and comments that begin
with "AV-Fuzzer" name the step of the publication that the code follows.

The fitness is not the publication's, which minimizes the safety potential: the distance to a vehicle less the ego's
stopping distance. It is that of the baseline AVFuzzer of the ISSTA 2023 paper, as its authors' program computes it.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.array_types import Floats
from behavexplor.data.geometry import distances_from_first
from behavexplor.data.scenario import LogicalScenario
from behavexplor.data.trace import Trace
from behavexplor.data.validation import between, validated
from behavexplor.errors import InputError
from behavexplor.fuzz.search import INITIAL, Candidate
from behavexplor.fuzz.vector_search import Asker
from behavexplor.judge.specs import Verdict

GLOBAL, LOCAL, RESTART = "global", "local", "restart"  # origins of candidates
_COLLISION = 100.0  # fitness of a collision, to which its relative speed is added
_NEAR = 256  # pairs of frame and NPC whose exact distances are computed at once


@validated
class AVFuzzerOptions:
    """Options of `AVFuzzer`. The defaults are the published values, where the publication states them."""

    population: Annotated[int, between(2)] = 4  # number of individuals in a generation
    crossover_probability: Annotated[float, between(0.01, 1)] = 0.4  # probability that two individuals swap one NPC
    mutation_probability: Annotated[float, between(0.01, 1)] = 0.4  # probability that one property of one NPC changes
    patience: Annotated[int, between(1)] = 5  # generations in a row without a better best individual before a restart
    restart_samples: int = 1000  # scenarios drawn at a restart; those farthest from all earlier ones are kept
    local_after: Annotated[int, between(0)] = 2  # generations since start or restart before the local fuzzer may begin
    local_generations: Annotated[int, between(1)] = 5  # number of generations of the local fuzzer
    local_factor: Annotated[float, between(0)] = 1.5  # factor on the mutation probability in the local fuzzer

    def __post_init__(self) -> None:
        if self.restart_samples < self.population:
            raise InputError(f"restart_samples: must be at least population, got {self.restart_samples}")


@dataclass(slots=True)
class _Individual:
    """A scenario as a vector, with its fitness once it was executed."""

    vector: Floats
    number: int | None = None  # number of its candidate, or of its parent until it becomes a candidate
    fitness: float | None = None


@dataclass(slots=True)
class _Generation:
    """Individuals of one generation. It is complete once all of them have a fitness."""

    kind: str
    individuals: list[_Individual]

    @property
    def complete(self) -> bool:
        return all(individual.fitness is not None for individual in self.individuals)

    @property
    def best(self) -> _Individual:
        return max(self.individuals, key=_fitness)


@dataclass(slots=True)
class _LocalFuzzer:
    """AV-Fuzzer: the second genetic algorithm, around the best individual of the first."""

    parents: list[_Individual]
    planned: int = 0
    completed: int = 0
    best: _Individual | None = None


@dataclass(slots=True)
class _Epoch:
    """State of the genetic algorithm since its start or its last restart."""

    population: list[_Individual] = field(default_factory=list)  # empty until the first generation is complete
    generations: int = 0
    best: float = -np.inf
    stale: int = 0  # generations in a row without a better best individual


class AVFuzzer:
    """Genetic search for high relative speeds at small distances, with restarts and a local fuzzer (ISSRE 2020).

    A generation is bred from the last complete one. With one candidate in flight, this is the previous generation; with
    more, generations overlap. An individual that neither crossover nor mutation changed keeps its fitness and is not
    executed again.
    """

    Options: ClassVar[type] = AVFuzzerOptions

    def __init__(self, logical: LogicalScenario, seed: int, options: AVFuzzerOptions) -> None:
        self._options = options
        self._asker = Asker(logical, seed)
        self._queue: deque[tuple[_Generation, _Individual]] = deque()
        self._in_flight: dict[int, tuple[_Generation, _Individual, _Epoch]] = {}
        self._epoch = _Epoch()
        self._local: _LocalFuzzer | None = None
        self._restarts = 0

    def ask(self) -> Candidate:
        """Return the next individual that is not executed yet."""
        rng = self._asker.draws()
        while not self._queue:
            generation = self._plan(rng)
            self._queue.extend((generation, one) for one in generation.individuals if one.fitness is None)
            if generation.complete:  # neither crossover nor mutation changed any individual
                self._end(generation)
        generation, individual = self._queue.popleft()
        candidate = self._asker.candidate(individual.vector, rng, generation.kind, individual.number)
        individual.number = candidate.number
        self._in_flight[candidate.number] = generation, individual, self._epoch
        return candidate

    def tell(self, candidate: Candidate, trace: Trace, verdict: Verdict) -> Mapping[str, Any]:
        """Set the `fitness` of an individual, and end its generation if it was the last one."""
        generation, individual, epoch = self._in_flight.pop(candidate.number)
        individual.vector = self._asker.told(candidate)
        individual.fitness = fitness(trace, collided="collision" in verdict.violated)
        if generation.complete and epoch is self._epoch:
            self._end(generation)
        return {"fitness": individual.fitness}

    def _plan(self, rng: np.random.Generator) -> _Generation:
        """Create the next generation."""
        local, epoch = self._local, self._epoch
        if local is not None and local.planned < self._options.local_generations:
            local.planned += 1
            rate = self._options.mutation_probability * self._options.local_factor
            return _Generation(LOCAL, self._bred(local.parents, rate, rng))
        if epoch.population:
            return _Generation(GLOBAL, self._bred(epoch.population, self._options.mutation_probability, rng))
        if not self._restarts:
            return _Generation(INITIAL, [_Individual(v) for v in self._asker.uniform(rng, self._options.population)])
        # AV-Fuzzer, restart: among many random scenarios, keep those farthest from all earlier ones
        far = self._asker.farthest(rng, self._options.restart_samples, self._options.population)
        return _Generation(RESTART, [_Individual(vector) for vector in far])

    def _bred(self, parents: list[_Individual], mutation: float, rng: np.random.Generator) -> list[_Individual]:
        """AV-Fuzzer: breed a generation by roulette selection, crossover and mutation."""
        weights = np.array([_fitness(parent) for parent in parents]) + 1e-9
        chosen = rng.choice(len(parents), self._options.population, p=weights / weights.sum())
        children = [parents[i] for i in chosen]
        for i in range(0, len(children) - 1, 2):
            if rng.random() < self._options.crossover_probability:
                children[i : i + 2] = self._crossed(children[i], children[i + 1], rng)
        return [self._mutated(child, rng) if rng.random() < mutation else child for child in children]

    def _crossed(self, one: _Individual, other: _Individual, rng: np.random.Generator) -> list[_Individual]:
        """AV-Fuzzer: swap the whole motion of one random NPC between two individuals."""
        first, second = self._blocks(one), self._blocks(other)
        npc = rng.integers(len(first))
        if np.array_equal(first[npc], second[npc]):
            return [one, other]
        first[npc], second[npc] = second[npc].copy(), first[npc].copy()
        return [_Individual(first.ravel(), one.number), _Individual(second.ravel(), other.number)]

    def _mutated(self, parent: _Individual, rng: np.random.Generator) -> _Individual:
        """AV-Fuzzer: change one slice of one NPC, to a new speed or a new maneuver."""
        blocks = self._blocks(parent)
        gene = self._asker.encoding.draw_gene(rng)
        blocks[rng.integers(len(blocks)), gene] = rng.random()
        return _Individual(blocks.ravel(), parent.number)

    def _blocks(self, individual: _Individual) -> Floats:
        return individual.vector.reshape(self._asker.encoding.n_blocks, -1).copy()

    def _end(self, generation: _Generation) -> None:
        """End a complete generation: update the population, then start the local fuzzer or restart if it is time."""
        if generation.kind == LOCAL:
            self._end_local(generation)
            return
        epoch = self._epoch
        epoch.population = generation.individuals
        epoch.generations += 1
        best = generation.best
        improved = _fitness(best) > epoch.best
        epoch.best = max(epoch.best, _fitness(best))
        epoch.stale = 0 if improved else epoch.stale + 1
        if improved and epoch.generations > self._options.local_after and self._local is None:
            self._local = _LocalFuzzer([best] * self._options.population)  # AV-Fuzzer: begin with copies of the best
        elif epoch.stale >= self._options.patience and self._local is None:
            self._restart()

    def _end_local(self, generation: _Generation) -> None:
        local = self._local
        if local is None:
            return
        local.completed += 1
        local.parents = generation.individuals
        if local.best is None or _fitness(generation.best) > _fitness(local.best):
            local.best = generation.best
        if local.completed == self._options.local_generations:
            worst = min(range(len(self._epoch.population)), key=lambda i: _fitness(self._epoch.population[i]))
            self._epoch.population = [*self._epoch.population]
            self._epoch.population[worst] = local.best  # AV-Fuzzer: the local fuzzer's best replaces the worst
            self._epoch.best = max(self._epoch.best, _fitness(local.best))
            self._local = None

    def _restart(self) -> None:
        self._restarts += 1
        self._epoch = _Epoch()
        self._queue.clear()

    def status(self) -> Mapping[str, float]:
        """Return the best fitness since the last restart, the number of restarts, and whether the local fuzzer runs."""
        best = max(self._epoch.best, 0.0)
        return {"best_fitness": best, "restarts": self._restarts, "local": int(self._local is not None)}


def fitness(trace: Trace, *, collided: bool) -> float:
    """Compute the fitness of an execution. A greater value is riskier [1/(m s)].

    The fitness is that of the ISSTA 2023 paper's baseline, see the module. It is the largest value of
    |v_ego - v_npc| / (d + 1)^2 over all frames and NPCs, where d is the distance of the boxes [m]. If the ego has
    `collided` with an NPC, it is 100 + |v_ego - v_npc| for the nearest NPC in the last frame.
    """
    if len(trace.size) == 1:
        return 0.0
    gap = trace.position[:, 1:] - trace.position[:, :1]
    centers = np.hypot(gap[..., 0], gap[..., 1])
    change = trace.velocity[:, 1:] - trace.velocity[:, :1]
    speeds = np.hypot(change[..., 0], change[..., 1])
    if collided:
        return _COLLISION + float(speeds[-1, _distances(trace, len(trace.time) - 1).argmin()])
    reach = (np.hypot(*trace.size[0]) + np.hypot(trace.size[1:, 0], trace.size[1:, 1])) / 2
    most = speeds / (np.maximum(centers - reach, 0.0) + 1) ** 2  # upper bounds from circles around the boxes
    order = np.argsort(-most, axis=None, kind="stable")
    best = 0.0
    for start in range(0, len(order), _NEAR):
        frame, npc = np.unravel_index(order[start : start + _NEAR], most.shape)
        if most[frame[0], npc[0]] <= best:
            break
        exact = speeds[frame, npc] / (_pair_distances(trace, frame, npc + 1) + 1) ** 2
        best = max(best, float(exact.max()))
    return best


def _distances(trace: Trace, frame: int) -> Floats:
    """Compute the distances between the ego's box and every NPC's box in a frame [m], shape (n_npcs,)."""
    npcs = np.arange(1, len(trace.size))
    return _pair_distances(trace, np.full(len(npcs), frame), npcs)


def _pair_distances(trace: Trace, frame: NDArray[np.intp], vehicle: NDArray[np.intp]) -> Floats:
    return distances_from_first(trace.position, trace.heading, trace.size, frame, vehicle)


def _fitness(individual: _Individual) -> float:
    return individual.fitness if individual.fitness is not None else 0.0
