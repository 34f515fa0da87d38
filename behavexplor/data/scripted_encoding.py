"""Encoding of scripted scenarios as vectors of fixed length. Every vector is a valid scenario."""

from collections.abc import Callable, Iterator
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.array_types import Floats
from behavexplor.data.roadmap import Route
from behavexplor.data.scripted import NPC, ScriptedScenario, Waypoint
from behavexplor.data.scripted_ranges import ScriptedRanges
from behavexplor.errors import InputError

TYPE, ROUTE, START = 0, 1, 2  # genes of an NPC: type, route and start; the other positions and the speeds follow
_UNUSED = 0.5  # gene of a waypoint that the route does not have
_DIGITS = 6  # decimals of decoded positions [m] and speeds [m/s], so that copies of a scenario are equal to it
_STEPS = 64  # positions tried along a lane for a vehicle that cannot start at its own position
_ATTEMPTS = 1000


class ScriptedEncoding:
    """Encoding of a logical scenario's concrete scenarios as points of [0, 1]^n.

    Each parameter is a gene, and uniform genes give the distribution of the sampler. An NPC is a block of genes:

    - its type and its route, each an equal part of [0, 1];
    - the position of every waypoint, as a share of the part of its range that lies behind the previous waypoint;
    - the speed at every waypoint but the last, as a share of the speed range.

    If NPCs would start in each other's way, the point is repaired deterministically: one NPC after the other takes the
    nearest free position along its lane, or else along the first lane of the next route.

    Attributes:
        logical: the encoded logical scenario.
        n_blocks: number of blocks in a vector.
        n_genes: number of genes in a block.

    Raises:
        InputError: if the logical scenario has no NPCs.
    """

    def __init__(self, logical: ScriptedRanges) -> None:
        if logical.n_npcs < 1:
            raise InputError(f"{logical.name}: a scenario has no NPCs, so there is nothing to search; raise n_npcs")
        self.logical = logical
        self._routes = logical.roadmap.npc_routes
        self._n_waypoints = max(len(logical.position_ranges(route)) for route in self._routes)
        self.n_blocks = logical.n_npcs
        self.n_genes = START + 2 * self._n_waypoints - 1

    @property
    def size(self) -> int:
        """Length n of a vector."""
        return self.n_blocks * self.n_genes

    @cached_property
    def speed_genes(self) -> NDArray[np.intp]:
        """Indices of an NPC's speed genes within its block, shape (waypoints - 1,)."""
        return np.arange(START + self._n_waypoints, self.n_genes)

    def draw_gene(self, rng: np.random.Generator) -> int:
        """Draw the gene of the route, or with equal probability that of one of the speeds."""
        return ROUTE if rng.random() < 0.5 else int(rng.choice(self.speed_genes))

    def decode(self, vector: Floats) -> ScriptedScenario:
        """Decode a vector to a scenario.

        Args:
            vector: genes, shape (n,). Values beyond [0, 1] are clipped.

        Returns:
            A scenario that is valid in `logical`.

        Raises:
            InputError: if the vector has a wrong shape or is not finite, or there is no place for all vehicles.
        """
        vector = np.asarray(vector, dtype=np.float64)
        if vector.shape != (self.size,) or not np.isfinite(vector).all():
            raise InputError(f"vector: expected {self.size} finite numbers, got shape {vector.shape}")
        npcs: list[NPC] = []
        for genes in np.clip(vector, 0.0, 1.0).reshape(self.n_blocks, self.n_genes):
            npcs.append(self._placed(genes, npcs))
        return ScriptedScenario(self.logical.name, tuple(npcs))

    def encode(self, scenario: ScriptedScenario) -> Floats:
        """Encode a scenario as a vector. `decode` restores it to six decimals.

        The genes of type and route are the middles of their parts of [0, 1].

        Args:
            scenario: a scenario that is valid in `logical` and has an NPC for each block.

        Returns:
            Genes, shape (n,).

        Raises:
            InputError: if the scenario has fewer NPCs.
        """
        if len(scenario.npcs) != self.n_blocks:
            raise InputError(f"npcs: expected {self.n_blocks}, got {len(scenario.npcs)}")
        return np.concatenate([self._block(npc) for npc in scenario.npcs])

    def features(self, vectors: Floats) -> Floats:
        """Convert vectors to features for distances and regression.

        Types and routes are one-hot: any two different types, or routes, are at distance 1.

        Args:
            vectors: genes, shape (k, n).

        Returns:
            Features, shape (k, n_blocks * (types + routes + n_genes - 2)).
        """
        blocks = vectors.reshape(len(vectors), self.n_blocks, self.n_genes)
        parts = [
            np.eye(count)[_parts(blocks[..., gene], count)] / np.sqrt(2)
            for gene, count in ((TYPE, len(self.logical.vehicle_types)), (ROUTE, len(self._routes)))
        ]
        return np.concatenate([*parts, blocks[..., START:]], axis=2).reshape(len(vectors), -1)

    def _placed(self, genes: Floats, others: list[NPC]) -> NPC:
        """Decode an NPC from a block of genes, moved to the nearest position at which it can start beside `others`."""
        route = int(_parts(genes[ROUTE], len(self._routes)))
        for i in range(len(self._routes)):
            for start in _outwards(float(genes[START])):
                npc = self._npc(genes, self._routes[(route + i) % len(self._routes)], start)
                if self.logical.spawn_conflict(npc, others) is None:
                    return npc
        raise InputError(f"{self.logical.name}: no place for {self.n_blocks} NPCs; use fewer")

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
    """Return the index of the part that contains each gene, among `count` equal parts of [0, 1]."""
    return np.minimum((np.clip(genes, 0.0, 1.0) * count).astype(np.intp), count - 1)


def _outwards(share: float) -> Iterator[float]:
    """Yield shares of a lane: the given one, then others at a growing distance from it."""
    yield share
    for step in range(1, _STEPS + 1):
        for other in (share + step / _STEPS, share - step / _STEPS):
            if 0.0 <= other <= 1.0:
                yield other


def mutate_waypoints(
    scenario: ScriptedScenario,
    logical: ScriptedRanges,
    rng: np.random.Generator,
    *,
    keep_probability: float,
    sigma_position: float,
    sigma_speed: float,
    point_keep_probability: float = 0.0,
) -> ScriptedScenario:
    """Mutate a scenario by Gaussian noise on the waypoints of some NPCs. Routes and types stay unchanged.

    Args:
        scenario: the parent, valid in `logical`.
        logical: logical scenario with the lanes, the speed range and the spawn rules.
        rng: random generator.
        keep_probability: epsilon, the probability that an NPC stays unchanged.
        sigma_position: standard deviation of the noise on positions [m].
        sigma_speed: standard deviation of the noise on speeds [m/s].
        point_keep_probability: probability that a waypoint of a chosen NPC stays unchanged.

    Raises:
        InputError: if no mutant was found.
    """

    def shifted(npc: NPC) -> NPC:
        return shift_waypoints(npc, logical, rng, (sigma_position, sigma_speed), point_keep_probability)

    return _mutate(scenario, logical, rng, keep_probability, shifted)


def mutate_routes(
    scenario: ScriptedScenario, logical: ScriptedRanges, rng: np.random.Generator, *, keep_probability: float
) -> ScriptedScenario:
    """Mutate a scenario by a new type, a new route and new uniform waypoints for some NPCs.

    Args:
        scenario: the parent, valid in `logical`.
        logical: logical scenario from which the new NPCs are sampled.
        rng: random generator.
        keep_probability: epsilon, the probability that an NPC stays unchanged.

    Raises:
        InputError: if no mutant was found.
    """

    def replaced(_: NPC) -> NPC:
        return logical.sample_npc(rng)

    return _mutate(scenario, logical, rng, keep_probability, replaced)


def shift_waypoints(
    npc: NPC, logical: ScriptedRanges, rng: np.random.Generator, sigma: tuple[float, float], keep_probability: float
) -> NPC:
    """Return an NPC with Gaussian noise on its waypoints, regardless of other vehicles.

    A waypoint stays in its lane. Waypoints on one lane that overtook each other are sorted. Speeds stay in their range,
    and the last one stays 0.

    Args:
        npc: an NPC that is valid in `logical`.
        logical: logical scenario with the lanes and the speed range.
        rng: random generator.
        sigma: standard deviations of the noise on positions [m] and on speeds [m/s].
        keep_probability: probability that a waypoint gets no noise.
    """
    low, high = logical.position_ranges(logical.roadmap.routes[npc.route]).T
    values = np.array([(waypoint.position, waypoint.speed) for waypoint in npc.waypoints])
    noise = rng.normal(0.0, sigma, values.shape)
    noisy = values + noise * (rng.random((len(values), 1)) >= keep_probability)
    position = np.sort(_clipped(noisy[:, 0], low, high))
    position = np.maximum.accumulate(_clipped(position, low, high))
    speed = _clipped(noisy[:, 1], *logical.speed_range)
    speed[-1] = 0.0
    return NPC(npc.type, npc.route, tuple(map(Waypoint, position.tolist(), speed.tolist())))


def _clipped(values: Floats, low: Floats | float, high: Floats | float) -> Floats:
    """Return what `np.clip` returns, which takes ten times as long for a few numbers."""
    return np.minimum(np.maximum(values, low), high)


def _mutate(
    scenario: ScriptedScenario,
    logical: ScriptedRanges,
    rng: np.random.Generator,
    keep_probability: float,
    change: Callable[[NPC], NPC],
) -> ScriptedScenario:
    """Change each NPC with probability 1 - epsilon, and place it beside the other NPCs by the spawn rules."""
    for _ in range(_ATTEMPTS):
        npcs = list(scenario.npcs)
        for i in np.flatnonzero(rng.random(len(npcs)) > keep_probability):
            others = npcs[:i] + npcs[i + 1 :]
            npcs[i] = logical.place(partial(change, npcs[i]), others)
        mutant = ScriptedScenario(scenario.functional, tuple(npcs))
        if mutant != scenario:
            return mutant
    raise InputError(f"None of {_ATTEMPTS} mutations changed a scenario with {len(scenario.npcs)} NPCs")
