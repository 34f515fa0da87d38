"""Scenarios as vectors of fixed length, every point of which is a scenario that can be run.

The methods that recombine, interpolate or learn need numbers in place of NPCs: all of them use this one encoding.
"""

from collections.abc import Iterator
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.logical import LogicalScenario
from behavexplor.data.roadmap import Route
from behavexplor.data.scenario import NPC, Scenario, Waypoint
from behavexplor.errors import InputError

Floats = NDArray[np.float64]

TYPE, ROUTE, START = 0, 1, 2  # genes of an NPC: its type, its route, where it starts; further positions follow
_UNUSED = 0.5  # gene of a waypoint that the route does not have
_DIGITS = 6  # of decoded positions [m] and speeds [m/s], so that copies of a scenario are equal to it
_STEPS = 64  # places tried along a lane for a vehicle that cannot start where its genes say


class Encoding:
    """The scenarios of a logical scenario as points of [0, 1]^n, each parameter a gene, uniform as the sampler's.

    An NPC is a block of genes: its type and its route, each an equal part of [0, 1]; for every waypoint its
    position as a share of what is left of its range behind the waypoint before it; for every waypoint but the last
    its speed as a share of the speed range. A point whose NPCs would start in each other's way is repaired,
    always in the same way: NPC after NPC takes the nearest free place along its lane, or else along the next
    route's.

    Attributes:
        logical: what is encoded.
        n_npcs: blocks of a vector.
        n_genes: genes of a block.

    Raises:
        InputError: if there are no NPCs.
    """

    def __init__(self, logical: LogicalScenario) -> None:
        if logical.n_npcs < 1:
            raise InputError(f"{logical.name}: a scenario has no NPCs, so there is nothing to search")
        self.logical = logical
        self._routes = logical.roadmap.npc_routes
        self._n_waypoints = max(len(logical.position_ranges(route)) for route in self._routes)
        self.n_npcs = logical.n_npcs
        self.n_genes = START + 2 * self._n_waypoints - 1

    @property
    def size(self) -> int:
        """Length n of a vector."""
        return self.n_npcs * self.n_genes

    @cached_property
    def speed_genes(self) -> NDArray[np.intp]:
        """Indices of an NPC's speeds within its block, shape (waypoints - 1,)."""
        return np.arange(START + self._n_waypoints, self.n_genes)

    def decode(self, vector: Floats) -> Scenario:
        """The scenario at a point.

        Args:
            vector: shape (n,); values beyond [0, 1] count as 0 and 1.

        Returns:
            A scenario that is valid in `logical`.

        Raises:
            InputError: if the vector has another shape or is not finite, or there is no place for all vehicles.
        """
        vector = np.asarray(vector, dtype=np.float64)
        if vector.shape != (self.size,) or not np.isfinite(vector).all():
            raise InputError(f"vector: expected {self.size} finite numbers, got shape {vector.shape}")
        npcs: list[NPC] = []
        for genes in np.clip(vector, 0.0, 1.0).reshape(self.n_npcs, self.n_genes):
            npcs.append(self._placed(genes, npcs))
        return Scenario(self.logical.name, tuple(npcs))

    def encode(self, scenario: Scenario) -> Floats:
        """The point of a scenario, the middle one of its type and route; `decode` restores it to its six digits.

        Args:
            scenario: valid in `logical`, with as many NPCs as that has.

        Returns:
            Shape (n,).

        Raises:
            InputError: if the scenario has fewer NPCs.
        """
        if len(scenario.npcs) != self.n_npcs:
            raise InputError(f"npcs: expected {self.n_npcs}, got {len(scenario.npcs)}")
        return np.concatenate([self._block(npc) for npc in scenario.npcs])

    def features(self, vectors: Floats) -> Floats:
        """Points for distances and regression: types and routes that differ are at distance 1, whichever they are.

        Args:
            vectors: shape (k, n).

        Returns:
            Shape (k, n_npcs * (types + routes + n_genes - 2)).
        """
        blocks = vectors.reshape(len(vectors), self.n_npcs, self.n_genes)
        parts = [
            np.eye(count)[_parts(blocks[..., gene], count)] / np.sqrt(2)
            for gene, count in ((TYPE, len(self.logical.vehicle_types)), (ROUTE, len(self._routes)))
        ]
        return np.concatenate([*parts, blocks[..., START:]], axis=2).reshape(len(vectors), -1)

    def _placed(self, genes: Floats, others: list[NPC]) -> NPC:
        """The NPC of a block of genes, or of the nearest ones with which it can start beside the others."""
        route = int(_parts(genes[ROUTE], len(self._routes)))
        for i in range(len(self._routes)):
            for start in _outwards(float(genes[START])):
                npc = self._npc(genes, self._routes[(route + i) % len(self._routes)], start)
                if self.logical.spawn_conflict(npc, others) is None:
                    return npc
        raise InputError(f"{self.logical.name}: no place for {self.n_npcs} NPCs; use fewer")

    def _npc(self, genes: Floats, route: Route, start: float) -> NPC:
        kinds = self.logical.vehicle_types
        ranges = self.logical.position_ranges(route)
        shares = [start, *genes[START + 1 : START + len(ranges)].tolist()]
        slowest, fastest = self.logical.speed_range
        speeds = slowest + genes[self.speed_genes[: len(ranges) - 1]] * (fastest - slowest)
        positions = [0.0]
        for (first, high), share in zip(ranges.tolist(), shares, strict=True):
            low = max(first, positions[-1])
            positions.append(min(max(round(low + share * (high - low), _DIGITS), low), high))
        speeds = np.clip(speeds.round(_DIGITS), slowest, fastest)
        waypoints = map(Waypoint, positions[1:], [*speeds.tolist(), 0.0])
        return NPC(kinds[int(_parts(genes[TYPE], len(kinds)))], route.name, tuple(waypoints))

    def _block(self, npc: NPC) -> Floats:
        kinds, names = self.logical.vehicle_types, [route.name for route in self._routes]
        route = self._routes[names.index(npc.route)]
        genes = np.full(self.n_genes, _UNUSED)
        genes[TYPE] = (kinds.index(npc.type) + 0.5) / len(kinds)
        genes[ROUTE] = (names.index(npc.route) + 0.5) / len(names)
        slowest, fastest = self.logical.speed_range
        previous = 0.0
        ranges = self.logical.position_ranges(route).tolist()
        for i, ((first, high), waypoint) in enumerate(zip(ranges, npc.waypoints, strict=True)):
            low = max(first, previous)
            previous = waypoint.position
            genes[START + i] = (previous - low) / (high - low) if high > low else _UNUSED
            if i < len(npc.waypoints) - 1:
                genes[self.speed_genes[i]] = (waypoint.speed - slowest) / (fastest - slowest)
        return genes


def _parts(genes: Floats, count: int) -> NDArray[np.intp]:
    """Which of `count` equal parts of [0, 1] each gene lies in."""
    return np.minimum((np.clip(genes, 0.0, 1.0) * count).astype(np.intp), count - 1)


def _outwards(share: float) -> Iterator[float]:
    """Shares of a lane: the given one, then others ever farther from it."""
    yield share
    for step in range(1, _STEPS + 1):
        for other in (share + step / _STEPS, share - step / _STEPS):
            if 0.0 <= other <= 1.0:
                yield other
