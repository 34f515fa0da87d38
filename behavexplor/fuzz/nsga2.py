"""NSGA-II on the violation degrees of all specs, by pymoo.

Source: Deb et al., "A fast and elitist multiobjective genetic algorithm: NSGA-II", IEEE Transactions on Evolutionary
Computation 6(2), 2002, in the implementation of pymoo (Blank and Deb, IEEE Access 8, 2020).
"""

from collections import deque
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.scenario import LogicalScenario
from behavexplor.data.trace import Trace
from behavexplor.data.validation import between, validated
from behavexplor.errors import missing_library
from behavexplor.fuzz.search import INITIAL, MAX_POPULATION, Candidate
from behavexplor.fuzz.vector_search import Asker, objectives
from behavexplor.judge.specs import Verdict

OFFSPRING = "offspring"  # origin of candidates


@validated
class NSGA2Options:
    """Options of `NSGA2`. The defaults are pymoo's, except for the population, which is smaller."""

    population: Annotated[int, between(4, MAX_POPULATION)] = 20  # number of individuals in a generation
    crossover_probability: Annotated[float, between(0, 1)] = 0.9  # probability of simulated binary crossover
    crossover_eta: Annotated[float, between(0)] = 15.0  # distribution index; greater ones keep offspring near parents
    mutation_eta: Annotated[float, between(0)] = 20.0  # distribution index of polynomial mutation


class _BredGeneration:
    """Individuals of one generation of pymoo. It is complete once all of them have objectives."""

    def __init__(self, population: Any, origin: str) -> None:
        self.population, self.origin = population, origin
        self.vectors: Floats = population.get("X").astype(np.float64)
        self.values: dict[int, Floats] = {}  # objectives by index

    @property
    def complete(self) -> bool:
        return len(self.values) == len(self.vectors)


class NSGA2:
    """NSGA-II: multi-objective genetic search on the violation degrees of all specs (needs pymoo).

    A generation is bred from the population at the time when its first individual is asked for. With one candidate in
    flight, the previous generation is complete by then; with more, generations overlap.
    """

    Options: ClassVar[type] = NSGA2Options

    def __init__(self, logical: LogicalScenario, seed: int, options: NSGA2Options) -> None:
        self._asker = Asker(logical, seed)
        self._algorithm = _algorithm(self._asker.encoding.size, options)
        self._queue: deque[tuple[_BredGeneration, int]] = deque()
        self._in_flight: dict[int, tuple[_BredGeneration, int]] = {}
        self._generations = 0

    @property
    def foreseen(self) -> int:
        """Number of individuals of the generation that are left to ask for."""
        return len(self._queue)

    def ask(self) -> Candidate:
        """Return the next individual that is not executed yet."""
        rng = self._asker.draws()
        if not self._queue:
            self._plan(rng)
        generation, index = self._queue.popleft()
        candidate = self._asker.candidate(generation.vectors[index], rng, generation.origin)
        self._in_flight[candidate.number] = generation, index
        return candidate

    def _plan(self, rng: np.random.Generator) -> None:
        algorithm = self._algorithm
        algorithm.random_state = rng
        bred = algorithm.infill()
        if bred is None:  # pymoo found no offspring that is new to the population
            bred = algorithm.initialization.do(algorithm.problem, algorithm.pop_size, random_state=rng)
        generation = _BredGeneration(bred, OFFSPRING if self._generations else INITIAL)
        self._queue.extend((generation, index) for index in range(len(generation.vectors)))

    def tell(self, candidate: Candidate, trace: Trace, verdict: Verdict) -> Mapping[str, Any]:  # noqa: ARG002
        """Set and return an individual's `objectives`, one for each spec. End its generation if it was the last one."""
        generation, index = self._in_flight.pop(candidate.number)
        generation.vectors[index] = self._asker.told(candidate)
        generation.values[index] = objectives(verdict)
        if generation.complete:
            self._end(generation)
        return {"objectives": generation.values[index].tolist()}

    def _end(self, generation: _BredGeneration) -> None:
        """Select the survivors among the population and a complete generation."""
        from pymoo.core.evaluator import Evaluator  # noqa: PLC0415
        from pymoo.problems.static import StaticProblem  # noqa: PLC0415

        values = np.array([generation.values[index] for index in range(len(generation.vectors))])
        # known from the first verdict on: users have specs of their own
        self._algorithm.problem.n_obj = values.shape[1]
        generation.population.set("X", generation.vectors)
        Evaluator().eval(StaticProblem(self._algorithm.problem, F=values), generation.population)
        self._algorithm.advance(infills=generation.population)
        self._generations += 1

    def status(self) -> Mapping[str, float]:
        """Return the number of complete generations."""
        return {"generations": self._generations}


def _algorithm(size: int, options: NSGA2Options) -> Any:
    """Create pymoo's algorithm on points of [0, 1]^size. An `InputError` says that pymoo is not installed."""
    try:
        from pymoo.algorithms.moo.nsga2 import NSGA2 as Algorithm  # noqa: PLC0415, N811 - slow to import
        from pymoo.core.problem import Problem  # noqa: PLC0415
        from pymoo.core.termination import NoTermination  # noqa: PLC0415
        from pymoo.operators.crossover.sbx import SBX  # noqa: PLC0415
        from pymoo.operators.mutation.pm import PM  # noqa: PLC0415
    except ImportError as error:
        raise missing_library("The search method 'nsga2'", "pymoo", "search") from error
    algorithm = Algorithm(
        pop_size=options.population,
        crossover=SBX(prob=options.crossover_probability, eta=options.crossover_eta),
        mutation=PM(eta=options.mutation_eta),
    )
    algorithm.setup(Problem(n_var=size, n_obj=1, xl=0.0, xu=1.0), termination=NoTermination(), seed=0)
    return algorithm
