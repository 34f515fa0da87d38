"""Evolutionary search for near misses with niching: what was seen often counts as less dangerous.

The score of an execution is its least time to collision. It gets worse with the logarithm of how often its kind of
situation was seen, as fitness sharing does it with the number of neighbors. So failures that are known already make
room for those that are not. Some scenarios stay uniform: where a few kinds are all that there are, chance finds them as
fast.

Sources: Goldberg and Richardson, "Genetic algorithms with sharing for multimodal function optimization", ICGA 1987, for
niches; Hayward, "Near-miss determination through use of a scale of danger", Highway Research Record 384, 1972, for the
time to collision.
"""

import math
from collections import Counter
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Final, NamedTuple

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.scenario import LogicalScenario
from behavexplor.data.trace import Trace
from behavexplor.data.validation import between, validated
from behavexplor.fuzz.search import MAX_POPULATION, UNIFORM, Candidate
from behavexplor.fuzz.vector_search import Asker
from behavexplor.judge.closest_approach import Nearness
from behavexplor.judge.specs import Verdict

CHILD: Final = "child"  # origin of candidates
_LEAST: Final = 0.2  # score of the nearest miss; that of a failure is 0 [s]
_SIGMAS: Final = (0.01, 0.3)  # least and greatest deviation of the noise, as shares of a gene's range
_FEW: Final = 0.2  # share of the genes that change if not all of them do
_ATTEMPTS: Final = 100


@validated
class NichingOptions:
    """Options of `Niching`."""

    population: Annotated[int, between(1, MAX_POPULATION)] = 20  # number of executions that may become parents
    initial: Annotated[int, between(1)] = 20  # number of uniform scenarios executed before the first child
    uniform: Annotated[float, between(0, 1)] = 0.2  # least share of uniform scenarios after these
    penalty: Annotated[float, between(0)] = 0.5  # added to the score when its niche is seen e times as often [s]


class _Parent(NamedTuple):
    number: int  # of its candidate
    vector: Floats  # shape (n,)
    score: float  # without the penalty [s]
    niche: object


class Niching:
    """Ours: evolution toward near misses, whose score gets worse the more often their kind of situation was seen."""

    Options: ClassVar[type] = NichingOptions
    uses_nearness: ClassVar[bool] = True

    def __init__(self, logical: LogicalScenario, seed: int, options: NichingOptions) -> None:
        self._options = options
        self._asker = Asker(logical, seed)
        self._seen: Counter[object] = Counter()  # executions by niche
        self._parents: list[_Parent] = []
        self._drawn, self._drawn_failed = 0, 0  # executed uniform scenarios, and how many of them failed

    def ask(self) -> Candidate:
        """Return uniform scenarios at first, then children and a share of uniform ones."""
        rng = self._asker.draws()
        is_early = self._asker.asked < self._options.initial or not self._parents
        if is_early or rng.random() < self._uniform_share():
            return self._asker.candidate(self._asker.uniform(rng)[0], rng, UNIFORM)
        parent = self._parents[int(rng.integers(len(self._parents)))]
        return self._asker.candidate(self._child(parent.vector, rng), rng, CHILD, parent.number)

    def _uniform_share(self) -> float:
        """Return the share of uniform scenarios after the first ones, at least the failure rate of uniform ones."""
        return max(self._options.uniform, self._drawn_failed / max(self._drawn, 1))

    def _child(self, parent: Floats, rng: np.random.Generator) -> Floats:
        """Return a child that is not a copy of its parent, shape (n,): with noise on all genes or a few."""
        features = self._asker.encoding.features
        for _ in range(_ATTEMPTS):
            sigma = math.exp(rng.uniform(*np.log(_SIGMAS)))
            share = 1.0 if rng.random() < 0.5 else _FEW
            noise = (rng.random(len(parent)) < share) * rng.normal(0.0, sigma, len(parent))
            child: Floats = np.abs((parent + noise + 1.0) % 2.0 - 1.0)  # reflected at 0 and 1
            if (features(child[None]) != features(parent[None])).any():
                break
        return child

    def tell(self, candidate: Candidate, trace: Trace, verdict: Verdict) -> Mapping[str, Any]:
        """Count the niche of an execution, and keep the best parents. Return the `time_left` until a collision [s]."""
        time_left, niche = Nearness.of(trace, verdict)
        score = 0.0 if verdict.violated else _LEAST + time_left
        self._seen[niche] += 1
        self._parents.append(_Parent(candidate.number, self._asker.told(candidate), score, niche))
        self._parents = sorted(self._parents, key=self._penalized)[: self._options.population]
        if candidate.origin == UNIFORM:
            self._drawn += 1
            self._drawn_failed += bool(verdict.violated)
        return {"time_left": time_left}

    def _penalized(self, parent: _Parent) -> float:
        return parent.score + self._options.penalty * math.log(self._seen[parent.niche])

    def status(self) -> Mapping[str, float]:
        """Return the number of niches."""
        return {"niches": len(self._seen)}
