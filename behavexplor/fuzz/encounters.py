"""Encounters: a search of this project's own that aims vehicles at the ego and tunes near misses of every class.

Two ideas carry it. Vehicles are aimed at drives of the ego that were recorded before (`behavexplor.fuzz.aiming`), so
most of them matter to the ego. And an archive has a niche for each class of violations, where the nearest misses of
this class are kept (`near_misses`). The search works on niches that are near to a violation and were little tried, and
turns away from those that have failed. So it looks for further classes instead of repeating one.

It uses routes, traces and verdicts, and neither the driving system's log nor its internals.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.array_types import Floats
from behavexplor.data.conventions import EPISODE_TIME, STANDING_SPEED, STANDSTILL_TIME
from behavexplor.data.geometry import distances_from_first, distances_from_segments, point_segment_distances
from behavexplor.data.scenario import LogicalScenario, Scenario
from behavexplor.data.scripted import NPC, ScriptedScenario, Waypoint
from behavexplor.data.scripted_logical import ScriptedLogicalScenario, require_scripted
from behavexplor.data.trace import Trace
from behavexplor.data.validation import between, validated
from behavexplor.fuzz.aiming import Aiming, AimingOptions, Drive
from behavexplor.fuzz.search import UNIFORM, Candidate, SearchExhausted, draws
from behavexplor.judge.classes import ViolationClass, event_class
from behavexplor.judge.events import R1, R2, R3, REQUIREMENTS, ViolationEvent, violation_event
from behavexplor.judge.fault import NPC_CAUSED, contact_fault
from behavexplor.judge.situation import DRIFT, HALF_LANE, motion_of, route_offsets
from behavexplor.judge.specs import Verdict

SHORT_STAND: Final = 2.0  # a shorter stand is not a near miss [s]
LINE_WEIGHT: Final = 10.0  # a meter to a line counts as this many meters to a vehicle: an ego is always near lines
FAR: Final = 200.0  # distance from the destination at which a return to the lane has a degree of 1 [m]
LEAST: Final = 0.01  # least degree of a near miss, so that 0 means a violation
_CLOSEST_FRAMES: Final = 8  # frames with the nearest centers, in which the distance between the boxes is computed
_SCALE: Final = 3.0  # a degree of this size halves the weight of a niche
_ATTEMPTS: Final = 1000
EMPTY_ROAD, AIMED, TUNED, REDRAWN = "empty-road", "aimed", "tuned", "redrawn"  # origins of candidates


class NearMiss(NamedTuple):
    """A violation, or one that almost happened."""

    spec: str  # the spec's short name: "R1", "R2", "R3", or a user's
    niche: str  # id of the class that the violation has or would have; for a collision, with the NPC's motion
    degree: float  # distance from the violation; 0 for a violation
    partner: int  # index of the NPC that took part or was nearest; -1 without NPCs


def near_misses(trace: Trace, verdict: Verdict, drive: Drive, reach: float) -> list[NearMiss]:
    """Return the violation of a failed execution, or the near misses of one that passed.

    A collision that an NPC caused teaches nothing about the ego, so it is left out. An execution in which the driving
    system failed is left out, too. `drive` is the ego's drive in the trace. A near miss is within `reach` [m].
    """
    if not verdict.failed:
        return [
            *_near_vehicles(trace, drive, reach),
            *_near_lines(trace, drive),
            *_near_ends(trace, drive),
            *_near_specs(trace, verdict),
        ]
    event = violation_event(trace, verdict.violated)
    if event is None or (event.spec == R1 and contact_fault(trace) in NPC_CAUSED):
        return []
    return [_miss(trace, event, 0.0)]


def _near_vehicles(trace: Trace, drive: Drive, reach: float) -> Iterator[NearMiss]:
    """Yield the closest approach of each NPC, unless the ego stood, or kept its lane and the NPC was behind it."""
    frames = drive.frame
    centers = trace.position[frames, 1:] - trace.position[frames, :1]
    gaps = np.hypot(centers[..., 0], centers[..., 1])
    for npc in range(1, len(trace.size)):
        closest = np.sort(np.argsort(gaps[:, npc - 1], kind="stable")[:_CLOSEST_FRAMES])
        at = frames[closest]
        distance = distances_from_first(trace.position, trace.heading, trace.size, at, np.full(len(at), npc))
        nearest = int(distance.argmin())
        if distance[nearest] > reach or drive.speed[closest[nearest]] < STANDING_SPEED:
            continue
        event = ViolationEvent(R1, int(at[nearest]), npc)
        kind = event_class(trace, event)
        if not kind.conflict.startswith("from-behind") or kind.maneuver.startswith("changing"):
            yield _miss(trace, event, LEAST + float(distance[nearest]), kind)


def _near_lines(trace: Trace, drive: Drive) -> Iterator[NearMiss]:
    """Yield the ego's least distance from an illegal line on each side, in its lane and while it changes lanes."""
    lines = trace.illegal_lines
    if not len(lines):
        return
    gap = point_segment_distances(drive.pose[:, :2], lines)
    to_right = _is_right_of(drive.pose, lines)
    for phase in (np.abs(drive.drift) <= DRIFT, drive.drift > DRIFT, drive.drift < -DRIFT):
        for side in (to_right, ~to_right):
            considered = np.where(phase[:, None] & side, gap, np.inf)
            row, line = np.unravel_index(int(considered.argmin()), gap.shape)
            if np.isinf(considered[row, line]):
                continue
            frame = drive.frame[[row]]
            ego = trace.position[frame, 0], trace.heading[frame, 0], trace.size[0]
            distance = float(distances_from_segments(*ego, lines, np.array([line]))[0])
            yield _miss(trace, ViolationEvent(R2, int(frame[0]), int(line)), LEAST + LINE_WEIGHT * distance)


def _is_right_of(pose: Floats, lines: Floats) -> NDArray[np.bool_]:
    """Return whether the nearest point of each line is to the right of each pose, shape (F, L)."""
    start, along = lines[:, 0], lines[:, 1] - lines[:, 0]
    offset = pose[:, None, :2] - start
    share = np.clip((offset * along).sum(-1) / (along**2).sum(-1), 0.0, 1.0)
    x, y = np.moveaxis(start + share[..., None] * along - pose[:, None, :2], -1, 0)
    cos, sin = np.cos(pose[:, 2:]), np.sin(pose[:, 2:])
    return np.asarray(y * cos - x * sin > 0)


def _near_ends(trace: Trace, drive: Drive) -> Iterator[NearMiss]:
    """Yield how the ego almost missed its destination: by a long stand, a long drive or a late return to its lane."""
    steps = np.arange(1, len(drive.time) + 1)
    stand = steps - np.maximum.accumulate(np.where(drive.speed < STANDING_SPEED, 0, steps))
    row = int(stand.argmax())
    seconds = float(drive.time[row] - drive.time[row - stand[row]]) if stand[row] else 0.0
    if seconds > SHORT_STAND:
        event = ViolationEvent(R3, int(drive.frame[row]))
        yield _miss(trace, event, LEAST + max(1 - seconds / STANDSTILL_TIME, 0.0), end="standstill")
    if trace.duration > EPISODE_TIME / 5:
        event = ViolationEvent(R3, int(drive.frame[len(drive.frame) // 2]))
        yield _miss(trace, event, LEAST + max(1 - trace.duration / EPISODE_TIME, 0.0), end="timeout")
    aside = np.flatnonzero(np.abs(route_offsets(trace)) > HALF_LANE)
    if len(aside):
        frame = int(aside[-1])
        left = float(np.hypot(*(trace.position[frame, 0] - trace.destination)))
        yield _miss(trace, ViolationEvent(R3, frame), LEAST + left / FAR, end="passed")


def _near_specs(trace: Trace, verdict: Verdict) -> Iterator[NearMiss]:
    """Yield the degrees of the user's own specs."""
    for name, degree in verdict.degrees.items():
        if name not in REQUIREMENTS:
            yield _miss(trace, ViolationEvent(name, len(trace.time) - 1), LEAST + max(degree, 0.0))


def _miss(
    trace: Trace, event: ViolationEvent, degree: float, kind: ViolationClass | None = None, end: str | None = None
) -> NearMiss:
    """Return the near miss of an event. Its class is `kind` if that is known already, or else that of `event_class`."""
    niche = (kind or event_class(trace, event, end)).id
    if event.spec == R1:
        niche += f"/{motion_of(trace, event.frame, event.partner) or 'moving'}"
    return NearMiss(event.spec, niche, degree, _partner(trace, event))


def _partner(trace: Trace, event: ViolationEvent) -> int:
    """Return the index of the NPC that took part or was nearest; -1 without NPCs."""
    if event.spec == R1:
        return event.partner - 1
    gap = trace.position[event.frame, 1:] - trace.position[event.frame, 0]
    return int(np.hypot(gap[:, 0], gap[:, 1]).argmin()) if len(gap) else -1


@validated
class EncountersOptions:
    """Options of `Encounters`."""

    # number of first candidates. The very first is the empty road. The others are uniform, or have vehicles aimed at
    # the ego's drive on the empty road.
    initial: Annotated[int, between(1)] = 40
    uniform_share: Annotated[float, between(0, 1)] = 0.1  # share of uniform scenarios
    aimed_share: Annotated[float, between(0, 1)] = 0.5  # share of mutants with a vehicle aimed at their parent's drive
    redrawn_share: Annotated[float, between(0, 1)] = 0.1  # share of mutants with one drawn anew; in others one is tuned
    near: Annotated[float, between(0)] = 10.0  # greatest distance of a vehicle that counts as a near miss [m]
    elites: Annotated[int, between(1)] = 4  # number of scenarios that a niche keeps
    failure_cost: Annotated[float, between(0)] = 0.5  # number of tries that a failure counts as
    aiming: AimingOptions = field(default_factory=AimingOptions)


@dataclass(frozen=True)
class Elite:
    """A scenario that came near to a violation."""

    candidate: Candidate
    drive: Drive
    miss: NearMiss


@dataclass
class Niche:
    """The nearest misses of one class of violations."""

    spec: str  # the spec of the class
    elites: list[Elite] = field(default_factory=list)  # the nearest misses, the nearest one first; at least one
    tries: float = 0.0  # number of mutants made from the elites; halved whenever a nearer miss is found
    failures: int = 0  # number of violations of this class

    def weight(self, failure_cost: float) -> float:
        """Return how much the niche deserves another try."""
        cost = 1 + self.tries + failure_cost * self.failures
        return 1 / (cost * (1 + self.elites[0].miss.degree / _SCALE))


class Encounters:
    """Encounters: vehicles aimed at the ego, and an archive of near misses with a niche for every class of failures."""

    Options: ClassVar[type] = EncountersOptions

    def __init__(self, logical: LogicalScenario, seed: int, options: EncountersOptions) -> None:
        self._logical = require_scripted(logical, "The search method 'encounters', which aims vehicles along routes,")
        self._seed, self._options = seed, options
        self._aiming = Aiming(self._logical, options.aiming)
        self._number = 0
        self._asked: set[Scenario] = set()
        self._empty_road: Drive | None = None
        self._niches: dict[str, Niche] = {}

    def ask(self) -> Candidate:
        """Return the empty road first, then scenarios aimed at the drive on it, then mutants of near misses.

        Raises:
            SearchExhausted: if no new scenario was found.
        """
        number = self._number
        rng = draws(self._seed, number)
        for _ in range(_ATTEMPTS):
            niche = self._pick_niche(rng) if number >= self._options.initial else None
            candidate = self._propose(rng, number, niche)
            if candidate.scenario not in self._asked:
                break
        else:
            raise SearchExhausted(f"No new scenario in {_ATTEMPTS} attempts: the search space is exhausted")
        if niche is not None and candidate.origin != UNIFORM:
            niche.tries += 1
        self._asked.add(candidate.scenario)
        self._number += 1
        return candidate

    def _propose(self, rng: np.random.Generator, number: int, niche: Niche | None) -> Candidate:
        if number == 0:
            return Candidate(number, ScriptedScenario(self._logical.name, ()), EMPTY_ROAD, None)
        if self._empty_road is None or rng.random() < self._options.uniform_share:
            return Candidate(number, self._logical.sample(rng), UNIFORM, None)
        if niche is None:
            return Candidate(number, self._aimed_scenario(rng, self._empty_road), AIMED, None)
        rank = int(rng.exponential())  # mostly 0, the nearest miss; now and then a farther one, which differs from it
        elite = niche.elites[min(rank, len(niche.elites) - 1)]
        npcs, origin = self._mutate(rng, elite)
        return Candidate(number, self._filled(rng, npcs), origin, elite.candidate.number)

    def _aimed_scenario(self, rng: np.random.Generator, drive: Drive) -> ScriptedScenario:
        """Return a scenario with some vehicles aimed at a drive and the other vehicles drawn uniformly."""
        npcs: list[NPC] = []
        for _ in range(rng.integers(self._logical.n_npcs) + 1 if self._logical.n_npcs else 0):
            npcs = self._with_aimed(rng, drive, npcs)
        return self._filled(rng, npcs)

    def _with_aimed(self, rng: np.random.Generator, drive: Drive, npcs: list[NPC]) -> list[NPC]:
        npc = self._aiming.aim(rng, drive, npcs)
        return npcs if npc is None else [*npcs, npc]

    def _filled(self, rng: np.random.Generator, npcs: list[NPC]) -> ScriptedScenario:
        """Return a scenario with as many vehicles as are possible; those that are missing are drawn uniformly."""
        for _ in range(self._logical.n_npcs - len(npcs)):
            npcs = [*npcs, self._logical.place(lambda: self._logical.sample_npc(rng), npcs)]
        return ScriptedScenario(self._logical.name, tuple(npcs))

    def _pick_niche(self, rng: np.random.Generator) -> Niche | None:
        """Draw a niche: a spec by the square root of its number of niches, then one of them by its weight."""
        if not self._niches:
            return None
        specs = sorted({niche.spec for niche in self._niches.values()})
        share = np.sqrt([sum(niche.spec == spec for niche in self._niches.values()) for spec in specs])
        spec = specs[rng.choice(len(specs), p=share / share.sum())]
        niches = [niche for niche in self._niches.values() if niche.spec == spec]
        weight = np.array([niche.weight(self._options.failure_cost) for niche in niches])
        return niches[rng.choice(len(niches), p=weight / weight.sum())]

    def _mutate(self, rng: np.random.Generator, elite: Elite) -> tuple[list[NPC], str]:
        """Return the vehicles of a mutant, and its origin. Mostly, the one that nearly met the ego is kept or tuned."""
        scenario: Any = elite.candidate.scenario
        npcs, partner = list(scenario.npcs), elite.miss.partner
        others = [i for i in range(len(npcs)) if i != partner]
        kind = rng.random()
        if kind < self._options.aimed_share or not npcs:
            if npcs and len(npcs) == self._logical.n_npcs:  # one makes room; the partner only if there is no other
                del npcs[others[rng.integers(len(others))] if others else partner]
            return self._with_aimed(rng, elite.drive, npcs), AIMED
        if kind < self._options.aimed_share + self._options.redrawn_share and others:
            del npcs[others[rng.integers(len(others))]]  # its place is filled by a new one
            return npcs, REDRAWN
        tunes_partner = partner >= 0 and rng.random() < 0.8
        i = partner if tunes_partner else int(rng.integers(len(npcs)))
        npc, rest = npcs[i], npcs[:i] + npcs[i + 1 :]
        npcs[i] = self._logical.place(lambda: tuned(npc, self._logical, rng), rest)
        return npcs, TUNED

    def tell(self, candidate: Candidate, trace: Trace, verdict: Verdict) -> Mapping[str, Any]:
        """Keep the violation, or each near miss, in its niche.

        Return how often a niche was `improved`: it got a nearer miss, or its first one.
        """
        drive = Drive.of(trace)
        if candidate.origin == EMPTY_ROAD:
            self._empty_road = drive
        misses = near_misses(trace, verdict, drive, self._options.near)
        return {"improved": sum([self._keep(Elite(candidate, drive, miss)) for miss in misses])}

    def _keep(self, elite: Elite) -> bool:
        """Put an elite into its niche. Return whether it is the nearest one."""
        niche = self._niches.setdefault(elite.miss.niche, Niche(elite.miss.spec))
        improves = not niche.elites or elite.miss.degree < niche.elites[0].miss.degree
        if improves:
            niche.tries /= 2
        niche.failures += elite.miss.degree == 0
        niche.elites.append(elite)
        niche.elites.sort(key=lambda kept: kept.miss.degree)
        del niche.elites[self._options.elites :]
        return improves

    @property
    def niches(self) -> Mapping[str, Niche]:
        """The niches by class of violations."""
        return MappingProxyType(self._niches)

    def status(self) -> Mapping[str, float]:
        """Return the number of niches, and of those in which a violation was found."""
        failed = sum(niche.failures > 0 for niche in self._niches.values())
        return {"niches": len(self._niches), "failed niches": failed}


def tuned(npc: NPC, logical: ScriptedLogicalScenario, rng: np.random.Generator) -> NPC:
    """Return a valid vehicle with other speeds or waypoints, now and then of another type, regardless of others.

    The size of the change is drawn over one and a half orders of magnitude: some niches need coarse changes.
    """
    low, high = logical.position_ranges(logical.roadmap.routes[npc.route]).T
    position, speed = np.array([(waypoint.position, waypoint.speed) for waypoint in npc.waypoints]).T
    scale = 10 ** rng.uniform(-2, -0.5)
    if rng.random() < 0.3:
        speed = speed * math.exp(rng.normal(0, scale))
    else:
        moved, changed = rng.random((2, len(position))) < 0.5
        position = position + moved * rng.normal(0, scale, len(position)) * (high - low)
        speed = np.where(changed, speed * np.exp(rng.normal(0, 2 * scale, len(speed))), speed)
        speed = speed + changed * rng.normal(0, 3 * scale, len(speed))
    kinds = logical.vehicle_types
    kind = kinds[rng.integers(len(kinds))] if rng.random() < 0.1 else npc.type
    position = np.maximum.accumulate(np.clip(np.sort(position), low, high))
    speed = np.clip(speed, *logical.speed_range)
    speed[-1] = 0.0
    return NPC(kind, npc.route, tuple(map(Waypoint, position.tolist(), speed.tolist())))
