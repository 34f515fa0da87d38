"""Many-objective selection: the best of each objective first, then by fronts, then by crowding distance.

Source: Panichella et al., "Reformulating branch coverage as a many-objective optimization problem", ICST 2015
(preference sorting); Deb et al., NSGA-II, 2002 (fronts by domination, crowding distance). All objectives are minimized.
"""

import numpy as np

from behavexplor.data.array_types import Floats, Ints


def survivors(values: Floats, count: int) -> Ints:
    """Return the `count` fittest of n individuals, the fittest first.

    Args:
        values: objectives of the individuals, shape (n, k).
        count: number of survivors, at most n.

    Returns:
        Indices of the survivors, shape (count,).
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
