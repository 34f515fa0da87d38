"""SAMOTA: many-objective search on surrogate models, alternating between global and local search.

Source: Haq et al., "Efficient Online Testing for DNN-Enabled Systems using Surrogate-Assisted and Many-Objective
Optimization", ICSE 2022. Docstrings and comments that begin with "SAMOTA" name the step of the publication that the
code follows. In this order: the surrogate models, who survives, and the search.
"""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Final, Literal

import numpy as np
from threadpoolctl import threadpool_limits

from behavexplor.data.array_types import Floats, Ints
from behavexplor.data.scenario import LogicalScenario
from behavexplor.data.trace import Trace
from behavexplor.data.validation import between, validated
from behavexplor.fuzz.search import INITIAL, MAX_POPULATION, Candidate
from behavexplor.fuzz.vector_search import Asker, objectives
from behavexplor.judge.specs import Verdict

_HELD_OUT = 0.2  # share of the rows that are held out to weight the models
_FEWEST = 10  # least number of rows at which some are held out
_LEAST_LENGTH = 0.1  # least length scale of a kernel, for points that are all alike
_RIDGE = 1e-2  # added to the diagonal of the kernel matrix


def _polynomial(squared: Floats, products: Floats, length: float) -> Floats:  # noqa: ARG001 - a kernel's signature
    return np.asarray((products / length**2 + 1) ** 2)


def _gaussian(squared: Floats, products: Floats, length: float) -> Floats:  # noqa: ARG001
    return np.asarray(np.exp(-squared / (2 * length**2)))


def _matern(squared: Floats, products: Floats, length: float) -> Floats:  # noqa: ARG001
    scaled = np.sqrt(3 * squared) / length
    return np.asarray((1 + scaled) * np.exp(-scaled))


Kernel = Callable[[Floats, Floats, float], Floats]  # from squared distances, products and a length scale
POLYNOMIAL, RBF, GAUSSIAN_PROCESS = _polynomial, _gaussian, _matern
KERNELS: tuple[Kernel, ...] = (POLYNOMIAL, RBF, GAUSSIAN_PROCESS)


@dataclass(frozen=True)
class Ensemble:
    """Several models of k objectives, fitted to the same n points, which predict them without an execution.

    Points are `Encoding.features`, which have one scale by construction. All models are kernel machines, which
    scikit-learn fits. Their predictions, a kernel times coefficients, are computed here for all models at once:
    separate calls for a handful of points would spend most of their time checking the input.
    """

    kernels: tuple[Kernel, ...]
    points: Floats  # training points, shape (n, features)
    length: float  # length scale of the kernels
    coefficients: Floats  # coefficients of the kernels at the points, shape (models, n, k)
    means: Floats  # means of the objectives, which are subtracted before the fit, shape (k,)
    weights: Floats  # weights of the models, which sum to 1 for each objective, shape (models, k)

    def outputs(self, points: Floats) -> Floats:
        """Compute each model's predictions at points of shape (p, features). Returns shape (models, p, k)."""
        squared, products = _products(points, self.points)
        values = np.stack([kernel(squared, products, self.length) for kernel in self.kernels])
        return np.asarray(values @ self.coefficients + self.means)

    def predict(self, points: Floats) -> tuple[Floats, Floats]:
        """Predict objectives, and the greatest disagreement of the models, at points of shape (p, features).

        These are the weighted mean and the widest difference of the models' predictions, each of shape (p, k).
        """
        outputs = self.outputs(points)
        return np.einsum("mpk,mk->pk", outputs, self.weights), outputs.max(0) - outputs.min(0)


def _products(points: Floats, others: Floats) -> tuple[Floats, Floats]:
    """Compute the squared distances and scalar products of all pairs, each of shape (points, others)."""
    products = points @ others.T
    squared = (points**2).sum(1)[:, None] + (others**2).sum(1) - 2 * products
    return np.maximum(squared, 0.0), products


def fit_ensemble(points: Floats, values: Floats, rng: np.random.Generator) -> Ensemble:
    """Fit a quadratic polynomial, an RBF regressor and a Gaussian process, weighted by their errors on held-out rows.

    `points` have the shape (n, features), n >= 2; `values` are the objectives at them, shape (n, k). `rng` draws the
    held-out rows.
    """
    n = len(points)
    weights = np.full((len(KERNELS), values.shape[1]), 1 / len(KERNELS))
    if n >= _FEWEST:
        order = rng.permutation(n)
        test, train = order[: int(_HELD_OUT * n)], order[int(_HELD_OUT * n) :]
        outputs = _fit(points[train], values[train], KERNELS, weights).outputs(points[test])
        inverse = 1 / (np.sqrt(((outputs - values[test]) ** 2).mean(1)) + 1e-9)
        weights = inverse / inverse.sum(0)
    return _fit(points, values, KERNELS, weights)


def fit_rbf(points: Floats, values: Floats) -> Ensemble:
    """Fit a single RBF regressor. The arguments are those of `fit_ensemble`."""
    return _fit(points, values, (RBF,), np.ones((1, values.shape[1])))


def _fit(points: Floats, values: Floats, kernels: tuple[Kernel, ...], weights: Floats) -> Ensemble:
    """Fit models whose length scale is the median distance of the points, so that no length has to be searched for."""
    squared, _ = _products(points, points)
    length = max(float(np.sqrt(np.median(squared[np.triu_indices(len(points), 1)]))), _LEAST_LENGTH)
    means = values.mean(0)
    coefficients = [_coefficients(kernel, length, points, values - means) for kernel in kernels]
    return Ensemble(kernels, points, length, np.stack(coefficients), means, weights)


def _coefficients(kernel: Kernel, length: float, points: Floats, values: Floats) -> Floats:
    """Fit the coefficients of a kernel by scikit-learn's model, shape (n, k)."""
    from sklearn.gaussian_process import GaussianProcessRegressor  # noqa: PLC0415 - slow to import
    from sklearn.gaussian_process.kernels import Matern  # noqa: PLC0415
    from sklearn.kernel_ridge import KernelRidge  # noqa: PLC0415

    if kernel is GAUSSIAN_PROCESS:
        process = GaussianProcessRegressor(Matern(length, nu=1.5), alpha=_RIDGE, optimizer=None).fit(points, values)
        return np.asarray(process.alpha_).reshape(values.shape)
    if kernel is POLYNOMIAL:
        model = KernelRidge(kernel="poly", degree=2, gamma=1 / length**2, coef0=1.0, alpha=_RIDGE)
    else:
        model = KernelRidge(kernel="rbf", gamma=1 / (2 * length**2), alpha=_RIDGE)
    return np.asarray(model.fit(points, values).dual_coef_)


def survivors(values: Floats, count: int) -> Ints:
    """Return the indices of the `count` fittest of n individuals, the fittest first, shape (count,).

    The best of each objective come first, then the others by fronts, then by crowding distance. `values`, shape (n, k),
    are the objectives, which are minimized; `count` is at most n. Sources: Panichella et al., "Reformulating branch
    coverage as a many-objective optimization problem", ICST 2015 (preference sorting); Deb et al., NSGA-II, 2002.
    """
    ranks = preference_ranks(values)
    crowding = np.zeros(len(values))
    for rank in range(ranks.max() + 1):
        front = np.flatnonzero(ranks == rank)
        crowding[front] = crowding_distances(values[front])
    return np.lexsort((-crowding, ranks))[:count]


def preference_ranks(values: Floats) -> Ints:
    """Compute the front of each individual, shape (n,).

    The best individual in any objective has front 0. All other individuals are sorted by domination.
    """
    ranks = np.full(len(values), -1, dtype=np.intp)
    ranks[values.argmin(0)] = 0
    no_worse = (values[:, None] <= values[None]).all(2)
    dominates = np.asarray(no_worse & (values[:, None] < values[None]).any(2))
    rank = 1
    while (open_ := ranks < 0).any():
        ranks[open_ & ~dominates[open_].any(0)] = rank
        rank += 1
    return ranks


def crowding_distances(values: Floats) -> Floats:
    """Compute the distance between the neighbors of each individual in a front, infinite at its ends; shape (n,)."""
    distances = np.zeros(len(values))
    for column in values.T:
        order = np.argsort(column, kind="stable")
        span = column[order[-1]] - column[order[0]]
        distances[order[[0, -1]]] = np.inf
        if span > 0:
            distances[order[1:-1]] += (column[order[2:]] - column[order[:-2]]) / span
    return distances


PROMISING, UNCERTAIN, LOCAL = "promising", "uncertain", "local"  # origins of candidates
_MOST_SKIPPED: Final = 100  # proposals in a row that were executed already, after which one is redrawn


@validated
class SAMOTAOptions:
    """Options of `SAMOTA`. The defaults are the published values where the publication states them.

    The preset `samota-seeded` has a variant whose searches begin with the best executions, failures included.
    """

    # number of initial scenarios, and of predicted individuals in a generation of a global search
    population: Annotated[int, between(2, MAX_POPULATION)] = 6
    # number of points drawn for each initial scenario. The farthest from all earlier ones is taken.
    adaptive_samples: Annotated[int, between(1)] = 10
    # first generation of a search: "random" individuals, or the "best" executed scenarios (in a local search the
    # executed scenarios of the cluster)
    start: Literal["random", "best"] = "random"
    repeats: Literal["skip", "redraw"] = "skip"  # "skip" a scenario that was executed, or "redraw" one of its NPCs
    generations: Annotated[int, between(1)] = 200  # number of generations of predicted individuals in a global search
    # greatest number of executions that a global surrogate learns from; half of them are the best ones. It bounds the
    # cost of an execution, which grows with the cube of this number.
    database_limit: Annotated[int, between(10, 10_000)] = 300
    # share of the executions, the best of each objective, from which a local search starts
    local_share: Annotated[float, between(0.001, 1)] = 0.2
    # greatest number of executions from which a local search starts
    local_limit: Annotated[int, between(10, 10_000)] = 100
    # least number of executions in a cluster of a local search
    cluster_size: Annotated[int, between(2, MAX_POPULATION)] = 5
    # number of predicted individuals in a generation of a local search
    local_population: Annotated[int, between(2, MAX_POPULATION)] = 6
    local_generations: Annotated[int, between(1)] = 200  # number of generations in a local search
    tournament: Annotated[int, between(1, MAX_POPULATION)] = 10  # individuals, whose fittest is a parent; 1: any one
    crossover: Literal["one-point", "npcs"] = "one-point"  # of two vectors at one point; "npcs" exchanges whole NPCs
    # probability that two parents are crossed at a point, or that an NPC comes from the second parent
    crossover_probability: Annotated[float, between(0.001, 1)] = 0.75
    mutation: Literal["uniform", "gaussian"] = "uniform"  # "uniform" draws genes anew, "gaussian" adds noise
    mutation_probability: Annotated[float, between(0.001, 1)] | None = None  # of a gene; None for 1 / n, with n genes
    mutation_sigma: Annotated[float, between(0.001, 1)] = 0.2  # standard deviation of noise, as a share of the range


class _Extremes:
    """The points with the least values seen so far, one point for each of k objectives."""

    def __init__(self, k: int, n: int) -> None:
        self.points: Floats = np.zeros((k, n))
        self._least = np.full(k, np.inf)

    def update(self, points: Floats, values: Floats) -> None:
        """Take points into account, shape (p, n), by their values, shape (p, k)."""
        better = values.min(0) < self._least
        self.points[better] = points[values.argmin(0)[better]]
        self._least = np.minimum(self._least, values.min(0))


class SAMOTA:
    """SAMOTA: many-objective search on surrogate models of the violation degrees (ICSE 2022).

    Global and local searches alternate. A search is planned when its first candidate is asked for, from all executions
    told so far. With one candidate in flight, these are the executions of all earlier candidates.
    """

    Options: ClassVar[type] = SAMOTAOptions

    def __init__(self, logical: LogicalScenario, seed: int, options: SAMOTAOptions) -> None:
        self._options = options
        self._asker = Asker(logical, seed)
        self._queue: deque[tuple[Floats, str]] = deque()
        self._vectors: list[Floats] = []  # SAMOTA, database: the executed points
        self._values: list[Floats] = []  # SAMOTA, database: their objectives
        self._uncovered: Ints = np.zeros(0, dtype=np.intp)  # objectives that no execution has brought to 0
        self._searches = 0

    def ask(self) -> Candidate:
        """Return an initial scenario, or the next scenario of a search."""
        rng = self._asker.draws()
        vector, origin = self._next(rng)
        if self._options.repeats == "skip":  # SAMOTA: what was executed before is not executed again
            for _ in range(_MOST_SKIPPED):
                if not self._asker.has_asked(vector):
                    break
                vector, origin = self._next(rng)
        return self._asker.candidate(vector, rng, origin)

    def _next(self, rng: np.random.Generator) -> tuple[Floats, str]:
        """Return the next proposal, a point with its origin."""
        if not self._queue:
            with threadpool_limits(limits=1):  # the last bits of a model must not depend on the number of threads
                self._queue.extend(self._plan(rng))
        return self._queue.popleft()

    def tell(self, candidate: Candidate, trace: Trace, verdict: Verdict) -> Mapping[str, Any]:  # noqa: ARG002
        """Add an execution to the database, and return its `objectives`, one for each spec."""
        values = objectives(verdict)
        if not self._values:
            self._uncovered = np.arange(len(values))
        self._vectors.append(self._asker.told(candidate))
        self._values.append(values)
        self._uncovered = self._uncovered[values[self._uncovered] > 0]
        if not len(self._uncovered):
            self._uncovered = np.arange(len(values))  # SAMOTA: once all are covered, all are searched again
        return {"objectives": values.tolist()}

    def _plan(self, rng: np.random.Generator) -> list[tuple[Floats, str]]:
        """SAMOTA: plan the next executions, by global and local search in turn."""
        if len(self._vectors) < self._options.population:
            return [(self._asker.farthest(rng, self._options.adaptive_samples, 1)[0], INITIAL)]
        self._searches += 1
        vectors, values = np.array(self._vectors), np.array(self._values)[:, self._uncovered]
        return self._global(vectors, values, rng) if self._searches % 2 else self._local(vectors, values, rng)

    def _global(self, vectors: Floats, values: Floats, rng: np.random.Generator) -> list[tuple[Floats, str]]:
        """SAMOTA, global search: find the predicted best and the most uncertain point for each uncovered objective."""
        rows = self._training_rows(values, rng)
        features = self._asker.encoding.features
        ensemble = fit_ensemble(features(vectors[rows]), values[rows], rng)
        best, doubtful = (_Extremes(values.shape[1], vectors.shape[1]) for _ in range(2))
        if self._options.start == "best":
            population = vectors[survivors(values, min(self._options.population, len(values)))]
            predicted, _ = ensemble.predict(features(population))
        else:
            population = self._asker.uniform(rng, self._options.population)
            predicted, unsure = ensemble.predict(features(population))
            best.update(population, predicted)
            doubtful.update(population, -unsure)
            fittest = survivors(predicted, len(population))
            population, predicted = population[fittest], predicted[fittest]
        for _ in range(self._options.generations):
            children = self._children(population, self._options.population, rng)
            expected, unsure = ensemble.predict(features(children))
            best.update(children, expected)
            doubtful.update(children, -unsure)
            population, predicted = np.concatenate([population, children]), np.concatenate([predicted, expected])
            fittest = survivors(predicted, self._options.population)
            population, predicted = population[fittest], predicted[fittest]
        proposed = [(vector, PROMISING) for vector in best.points]
        return _distinct(proposed + [(vector, UNCERTAIN) for vector in doubtful.points])

    def _training_rows(self, values: Floats, rng: np.random.Generator) -> Ints:
        """Choose the executions to learn from: all of them, or up to the limit the best ones and random other ones."""
        limit = self._options.database_limit
        if len(values) <= limit:
            return np.arange(len(values))
        order = np.argsort(values.min(1), kind="stable")
        rest = order[limit // 2 :]
        return np.concatenate([order[: limit // 2], rng.choice(rest, limit - limit // 2, replace=False)])

    def _local(self, vectors: Floats, values: Floats, rng: np.random.Generator) -> list[tuple[Floats, str]]:
        """SAMOTA, local search: find the predicted best in each cluster of each objective's best executions."""
        from sklearn.cluster import HDBSCAN  # noqa: PLC0415 - slow to import, needed only once a campaign runs

        options = self._options
        found = []
        for column in values.T:
            count = min(max(int(options.local_share * len(column)), options.cluster_size), options.local_limit)
            top = np.argsort(column, kind="stable")[:count]
            points = self._asker.encoding.features(vectors[top])
            labels = np.zeros(len(top), dtype=np.intp)
            if len(top) > options.cluster_size:
                labels = HDBSCAN(min_cluster_size=options.cluster_size, copy=True).fit_predict(points)
            if (labels < 0).all():  # without any cluster, all points form one
                labels[:] = 0
            for label in range(labels.max() + 1):
                members = labels == label
                model = fit_rbf(points[members], column[top][members, None])
                found.append((self._minimum(vectors[top][members], model, rng), LOCAL))
        return _distinct(found)

    def _minimum(self, members: Floats, model: Ensemble, rng: np.random.Generator) -> Floats:
        """Find the point of least predicted value in the box around the members by a genetic algorithm; shape (n,)."""
        low, high = members.min(0), members.max(0)
        features = self._asker.encoding.features
        population, count = members, self._options.local_population
        if self._options.start == "random":
            population = low + self._asker.uniform(rng, count) * (high - low)
        expected = model.predict(features(population))[0][:, 0]
        if self._options.start == "random":
            fittest = np.argsort(expected, kind="stable")
            population, expected = population[fittest], expected[fittest]
        for _ in range(self._options.local_generations):
            children = self._children(population, count, rng, low, high)
            population = np.concatenate([population, children])
            expected = np.concatenate([expected, model.predict(features(children))[0][:, 0]])
            fittest = np.argsort(expected, kind="stable")[:count]
            population, expected = population[fittest], expected[fittest]
        return np.asarray(population[0])

    def _children(
        self,
        parents: Floats,
        count: int,
        rng: np.random.Generator,
        low: Floats | float = 0.0,
        high: Floats | float = 1.0,
    ) -> Floats:
        """Breed points, shape (count, n), by selection, crossover and mutation of parents.

        `parents`, shape (p, n), are sorted, the fittest first. `low` and `high` bound genes: numbers, or shape (n,).
        """
        bred = self._crossed_npcs if self._options.crossover == "npcs" else self._crossed_at_a_point
        children = bred(parents, count, rng)
        probability = self._options.mutation_probability or 1 / children.shape[1]
        mutated = rng.random(children.shape) < probability
        if self._options.mutation == "gaussian":
            noise = rng.normal(0.0, self._options.mutation_sigma, children.shape)
            return np.asarray(np.clip(children + noise * mutated, low, high))
        return np.where(mutated, low + rng.random(children.shape) * (high - low), children)

    def _selected(self, parents: Floats, count: int, rng: np.random.Generator) -> Floats:
        """Select two lists of parents, each parent the fittest of a tournament; shape (2, count, n)."""
        return np.asarray(parents[rng.integers(len(parents), size=(2, count, self._options.tournament)).min(2)])

    def _crossed_npcs(self, parents: Floats, count: int, rng: np.random.Generator) -> Floats:
        """Exchange NPCs between two parents; shape (count, n)."""
        first, second = self._selected(parents, count, rng)
        other = rng.random((count, self._asker.encoding.n_blocks)) < self._options.crossover_probability
        return np.asarray(np.where(np.repeat(other, self._asker.encoding.n_genes, axis=1), second, first))

    def _crossed_at_a_point(self, parents: Floats, count: int, rng: np.random.Generator) -> Floats:
        """SAMOTA, one-point crossover: two parents have two children, which swap what lies behind a point."""
        pairs, n = (count + 1) // 2, parents.shape[1]
        first, second = self._selected(parents, pairs, rng)
        swapped = np.arange(n) >= rng.integers(1, n, size=(pairs, 1))
        swapped &= rng.random((pairs, 1)) < self._options.crossover_probability
        children = np.concatenate([np.where(swapped, second, first), np.where(swapped, first, second)])
        return np.asarray(children[:count])

    def status(self) -> Mapping[str, float]:
        """Return the number of planned searches, and of uncovered objectives."""
        return {"searches": self._searches, "uncovered": len(self._uncovered)}


def _distinct(found: list[tuple[Floats, str]]) -> list[tuple[Floats, str]]:
    """Remove repeated points. The last of each keeps its place, with the origin of the first."""
    return list({vector.tobytes(): (vector, origin) for vector, origin in reversed(found)}.values())[::-1]
