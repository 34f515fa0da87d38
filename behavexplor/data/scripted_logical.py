"""Logical scenarios of scripted vehicles: ranges of scenarios on a map, with their mutations, encoding and parts.

The encoding turns scenarios into vectors of fixed length, and every vector is a valid scenario. Source: paper section
2.2, for the parameters that are searched (the NPCs' routes and waypoints); Algorithm 2, for the mutations.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.array_types import Floats
from behavexplor.data.conventions import EGO_SIZE, VEHICLE_SIZES
from behavexplor.data.scenario import Mutations, Noise, Part, Parts, Value
from behavexplor.data.scripted import NPC, ScriptedRanges, ScriptedScenario, Waypoint, WaypointRange
from behavexplor.data.trace import Trace
from behavexplor.errors import InputError

TYPE, ROUTE, START = 0, 1, 2  # genes of an NPC: type, route and start; the other positions and the speeds follow
_UNUSED = 0.5  # gene of a waypoint that the route does not have
_DIGITS = 6  # decimals of decoded positions [m] and speeds [m/s], so that copies of a scenario are equal to it
_STEPS = 64  # positions tried along a lane for a vehicle that cannot start at its own position
_ATTEMPTS = 1000
WAYPOINTS: Final = "waypoints"
ROUTES: Final = "routes"


class ScriptedLogicalScenario(ScriptedRanges):
    """The parameters of a functional scenario and their ranges; see `behavexplor.data.scenario.LogicalScenario`."""

    has_original = False  # highway-env has no scripted vehicles
    removable = True  # a scenario may have fewer vehicles
    mutations = Mutations(WAYPOINTS, ROUTES)  # the paper's

    @cached_property
    def encoding(self) -> "ScriptedEncoding":
        """The encoding of scenarios as vectors."""
        return ScriptedEncoding(self)

    @property
    def config(self) -> Mapping[str, Any]:
        """Nothing: the scripts hold in every configuration."""
        return {}

    def to_json(self) -> str:
        """Return nothing: the name of the environment says all."""
        return ""

    @property
    def line_kinds(self) -> tuple[str, ...]:
        """The kinds of the illegal lines in a trace."""
        return tuple(self.roadmap.line_kinds)

    def adopted(self, scenario: ScriptedScenario) -> ScriptedScenario:
        """Return the scenario of another driver, which is the same for every driver."""
        self.check(scenario)
        return scenario

    def mutate_little(self, scenario: ScriptedScenario, rng: np.random.Generator, noise: Noise) -> ScriptedScenario:
        """Return a mutant by Gaussian noise on the waypoints of some NPCs, whose routes and types stay unchanged."""
        return mutated(scenario, self, rng, noise.keep_probability, lambda npc: shift_waypoints(npc, self, rng, noise))

    def mutate_much(
        self, scenario: ScriptedScenario, rng: np.random.Generator, keep_probability: float
    ) -> ScriptedScenario:
        """Return a mutant by a new type, a new route and new uniform waypoints for some NPCs."""
        return mutated(scenario, self, rng, keep_probability, lambda _: self.sample_npc(rng))

    def first_frame(self, scenario: ScriptedScenario, end: str) -> Trace:
        """Return the trace of an episode that ended before any vehicle moved. `end` is one of the trace's `ENDS`."""
        roadmap = self.roadmap
        poses = np.stack([roadmap.start_pose, *(self._placed(npc)[:3] for npc in scenario.npcs)])
        speeds = np.array([0.0, *(npc.waypoints[0].speed for npc in scenario.npcs)])
        heading = poses[:, 2]
        return Trace(
            time=np.zeros(1),
            position=poses[None, :, :2],
            heading=heading[None],
            velocity=speeds[None, :, None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1),
            size=np.array([EGO_SIZE, *(VEHICLE_SIZES[npc.type] for npc in scenario.npcs)]),
            actions=np.zeros((0, 1)),
            action_frame=np.zeros(0, dtype=np.int64),
            route=roadmap.ego_line,
            destination=roadmap.destination_point,
            illegal_lines=roadmap.illegal_lines,
            end=end,
        )

    def describe(self, scenario: ScriptedScenario) -> str:
        """Return a short description: the number of NPCs and their routes."""
        routes = [npc.route for npc in scenario.npcs]
        listed = ", ".join(f"{routes.count(route)} on {route}" for route in dict.fromkeys(routes))
        return f"{len(routes)} NPCs: {listed}" if routes else "no NPCs"

    def parts(self, scenario: ScriptedScenario) -> Parts:
        """Return the vehicles of a scenario as parts; see `part_of`."""
        return tuple(part_of(npc, self) for npc in scenario.npcs)

    def with_parts(self, scenario: ScriptedScenario, parts: Parts) -> ScriptedScenario:
        """Return a scenario with other vehicles."""
        changed = replace(scenario, npcs=tuple(vehicle_of(part, self) for part in parts))
        self.check(changed)
        return changed


def require_scripted(logical: object, what: str) -> ScriptedLogicalScenario:
    """Return `logical` itself if its vehicles are scripted. The error message begins with `what`, which needs them.

    Raises:
        InputError: if it is one of a highway-env environment.
    """
    if not isinstance(logical, ScriptedLogicalScenario):
        raise InputError(f"{what} needs one of the environments with scripted vehicles, such as intersection-straight")
    return logical


def shift_waypoints(npc: NPC, logical: ScriptedRanges, rng: np.random.Generator, noise: Noise) -> NPC:
    """Return an NPC with Gaussian noise on its waypoints, regardless of other vehicles.

    A waypoint stays in its lane. Waypoints on one lane that overtook each other are sorted. Speeds stay in their range,
    and the last one stays 0.
    """
    ranges, count = logical.ranges[npc.route], len(npc.waypoints)  # the last range allows the speed 0 only
    change = rng.normal(0.0, (noise.sigma_position, noise.sigma_speed), (count, 2))
    change *= rng.random((count, 1)) >= noise.point_keep_probability
    positions, speeds = [], []
    for waypoint, allowed, (along, faster) in zip(npc.waypoints, ranges, change.tolist(), strict=True):
        positions.append(min(max(waypoint.position + along, allowed.start), allowed.end))
        speeds.append(min(max(waypoint.speed + faster, allowed.slowest), allowed.fastest))
    waypoints, last = [], 0.0
    for position, speed, allowed in zip(sorted(positions), speeds, ranges, strict=True):
        last = max(last, min(max(position, allowed.start), allowed.end))
        waypoints.append(Waypoint(last, speed))
    return NPC(npc.type, npc.route, tuple(waypoints))


def mutated(
    scenario: ScriptedScenario,
    logical: ScriptedRanges,
    rng: np.random.Generator,
    keep_probability: float,
    change: Callable[[NPC], NPC],
) -> ScriptedScenario:
    """Change each NPC with probability 1 - `keep_probability`, and place it beside the other NPCs by the spawn rules.

    The paper calls the probability to keep an NPC epsilon. A mutant differs from its parent.

    Raises:
        InputError: if no mutant was found.
    """
    for _ in range(_ATTEMPTS):
        npcs = list(scenario.npcs)
        for i in np.flatnonzero(rng.random(len(npcs)) > keep_probability):
            others = npcs[:i] + npcs[i + 1 :]
            npcs[i] = logical.place(partial(change, npcs[i]), others)
        mutant = ScriptedScenario(scenario.functional, tuple(npcs))
        if mutant != scenario:
            return mutant
    raise InputError(f"None of {_ATTEMPTS} mutations changed a scenario with {len(scenario.npcs)} NPCs")


class ScriptedEncoding:
    """Encoding of scripted scenarios as points of [0, 1]^n; see `behavexplor.data.scenario.Encoding`.

    Each parameter is a gene, and uniform genes give the distribution of the sampler. An NPC is a block of genes:

    - its type and its route, each an equal section of [0, 1];
    - the position of every waypoint, as a share of the part of its range that lies behind the previous waypoint;
    - the speed at every waypoint but the last, as a share of the speed range.

    If NPCs would start in each other's way, the point is repaired deterministically: one NPC after the other takes the
    nearest free position along its lane, or else along the first lane of the next route.

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
        """Decode genes, shape (n,), to a valid scenario. Values beyond [0, 1] are clipped.

        Raises:
            InputError: if the vector has a wrong shape or is not finite, or there is no place for all vehicles.
        """
        vector = np.asarray(vector, dtype=np.float64)
        if vector.shape != (self.size,) or not np.isfinite(vector).all():
            raise InputError(f"vector: expected {self.size} finite numbers, got shape {vector.shape}")
        npcs: list[NPC] = []
        for genes in np.clip(vector, 0.0, 1.0).reshape(self.n_blocks, self.n_genes).tolist():
            npcs.append(self._npc(genes, npcs))
        return ScriptedScenario(self.logical.name, tuple(npcs))

    def encode(self, scenario: ScriptedScenario) -> Floats:
        """Encode a valid scenario as genes, shape (n,). `decode` restores it to six decimals.

        The genes of type and route are the middles of their sections of [0, 1].

        Raises:
            InputError: if the scenario has not exactly one NPC for each block.
        """
        if len(scenario.npcs) != self.n_blocks:
            raise InputError(f"npcs: expected {self.n_blocks}, got {len(scenario.npcs)}")
        return np.array([gene for npc in scenario.npcs for gene in self._block(npc)])

    def features(self, vectors: Floats) -> Floats:
        """Convert vectors of genes, shape (k, n), to features for distances and regression, shape (k, features).

        Types and routes are one-hot: any two different types, or routes, are at distance 1. So there are n_blocks *
        (types + routes + n_genes - 2) features.
        """
        blocks = vectors.reshape(len(vectors), self.n_blocks, self.n_genes)
        chosen = [
            np.eye(count)[_sections(blocks[..., gene], count)] / np.sqrt(2)
            for gene, count in ((TYPE, len(self.logical.vehicle_types)), (ROUTE, len(self._routes)))
        ]
        return np.concatenate([*chosen, blocks[..., START:]], axis=2).reshape(len(vectors), -1)

    def _npc(self, genes: list[float], others: list[NPC]) -> NPC:
        """Decode an NPC from a block of genes, moved to the nearest position at which it can start beside `others`."""
        first = _section(genes[ROUTE], len(self._routes))
        routes = (*self._routes[first:], *self._routes[:first])
        starting = (self._starting(genes, route.name, start) for route in routes for start in _outwards(genes[START]))
        npc = self.logical.first_to_fit(starting, others)
        if npc is None:
            raise InputError(f"{self.logical.name}: no place for {self.n_blocks} NPCs; use fewer")
        waypoints, ranges = list(npc.waypoints), self.logical.ranges[npc.route]
        speeds = [*genes[START + self._n_waypoints :], 0.0]  # as shares of the speed ranges
        for allowed, share, speed in zip(ranges[1:], genes[START + 1 :], speeds[1:], strict=False):  # used genes only
            waypoints.append(_waypoint(allowed, waypoints[-1].position, share, speed))
        return NPC(npc.type, npc.route, tuple(waypoints))

    def _starting(self, genes: list[float], route: str, start: float) -> NPC:
        """Decode an NPC with its first waypoint only."""
        kinds, speeds = self.logical.vehicle_types, [*genes[START + self._n_waypoints :], 0.0]
        waypoint = _waypoint(self.logical.ranges[route][0], 0.0, start, speeds[0])
        return NPC(kinds[_section(genes[TYPE], len(kinds))], route, (waypoint,))

    def _block(self, npc: NPC) -> list[float]:
        kinds, names = self.logical.vehicle_types, [route.name for route in self._routes]
        genes = [_UNUSED] * self.n_genes
        genes[TYPE] = (kinds.index(npc.type) + 0.5) / len(kinds)
        genes[ROUTE] = (names.index(npc.route) + 0.5) / len(names)
        previous = 0.0
        for i, (allowed, waypoint) in enumerate(zip(self.logical.ranges[npc.route], npc.waypoints, strict=True)):
            low = max(allowed.start, previous)
            previous = waypoint.position
            genes[START + i] = (previous - low) / (allowed.end - low) if allowed.end > low else _UNUSED
            if i < len(npc.waypoints) - 1:
                share = (waypoint.speed - allowed.slowest) / (allowed.fastest - allowed.slowest)
                genes[START + self._n_waypoints + i] = share
        return genes


def _sections(genes: Floats, count: int) -> NDArray[np.intp]:
    """Return the index of the section that contains each gene, among `count` equal sections of [0, 1]."""
    return np.minimum((np.clip(genes, 0.0, 1.0) * count).astype(np.intp), count - 1)


def _section(gene: float, count: int) -> int:
    """Return the index of the section that contains a gene in [0, 1], see `_sections`."""
    return min(int(gene * count), count - 1)


def _waypoint(allowed: WaypointRange, previous: float, share: float, speed_share: float) -> Waypoint:
    """Return the waypoint at shares of its range behind the previous position, and of its speed range."""
    low = max(allowed.start, previous)
    position = round(low + share * (allowed.end - low), _DIGITS)
    speed = allowed.slowest + speed_share * (allowed.fastest - allowed.slowest)
    rounded = round(speed * 10**_DIGITS) / 10**_DIGITS  # as numpy rounds
    return Waypoint(min(max(position, low), allowed.end), min(max(rounded, allowed.slowest), allowed.fastest))


def _outwards(share: float) -> Iterator[float]:
    """Yield shares of a lane: the given one, then others at a growing distance from it."""
    yield share
    for step in range(1, _STEPS + 1):
        for other in (share + step / _STEPS, share - step / _STEPS):
            if 0.0 <= other <= 1.0:
                yield other


def part_of(npc: NPC, ranges: ScriptedRanges) -> Part:
    """Return a vehicle as a part: its type, the positions of all waypoints, and the speeds of all but the last one.

    A plain vehicle is a sedan that drives at the speed limit from the middle of its first lane to the end of its route.
    The speed of a waypoint is plain if it is that of the waypoint before. Its position is plain if it is in the middle
    of the lane, or at the waypoint before if that is farther on. Plain values are left out: they are None in the part.
    """
    positions, speeds = [], []
    before = Waypoint(0.0, ranges.speed_range[1])
    for waypoint, plain in zip(npc.waypoints, _middles(npc.route, ranges), strict=True):
        positions.append(_unless(waypoint.position, max(plain, before.position)))
        speeds.append(_unless(waypoint.speed, before.speed))
        before = waypoint
    kind = None if npc.type == ranges.vehicle_types[0] else npc.type
    return Part(npc.route, (kind, *positions, *speeds[:-1]))


def vehicle_of(part: Part, ranges: ScriptedRanges) -> NPC:
    """Return the vehicle of a part. This is the inverse of `part_of`.

    Raises:
        InputError: if the route is unknown, or the values are not those of a vehicle on this route.
    """
    middles = _middles(part.label, ranges)
    if len(part.values) != 2 * len(middles):
        raise InputError(f"{part.label}: a vehicle on this route has {2 * len(middles)} values")
    kind, *numbers = part.values
    waypoints: list[Waypoint] = []
    at, speed = 0.0, ranges.speed_range[1]
    for plain, position, pace in zip(middles, numbers[: len(middles)], [*numbers[len(middles) :], 0.0], strict=True):
        at = _number(position, max(plain, at))
        speed = _number(pace, speed)
        waypoints.append(Waypoint(at, speed))
    return NPC(ranges.vehicle_types[0] if kind is None else str(kind), part.label, tuple(waypoints))


def _middles(route: str, ranges: ScriptedRanges) -> Sequence[float]:
    """Return the plain position of each waypoint on a route, regardless of the waypoints before it."""
    if route not in ranges.roadmap.routes:
        raise InputError(f"route: there is no route {route!r}")
    bounds = ranges.position_ranges(ranges.roadmap.routes[route])
    return [*bounds[:-1].mean(axis=1).tolist(), float(bounds[-1, 1])]


def _unless(value: float, plain: float) -> float | None:
    return None if value == plain else value


def _number(value: Value, plain: float) -> float:
    return plain if value is None else float(value)
