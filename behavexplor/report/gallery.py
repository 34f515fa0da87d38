"""The gallery: a card for each class of violations, with replays as int16 differences, deflated, in base64."""

import base64
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from behavexplor.campaign.record import Record
from behavexplor.data.array_types import Floats, Ints
from behavexplor.data.trace import ARRIVED, Trace
from behavexplor.judge.events import R1, violation_event
from behavexplor.report.marks import decisions, violation_place
from behavexplor.report.reading import ReportedRun
from behavexplor.triage.findings import Finding, fault_words, tally

PASSED: Final = "passed"  # replaces the class of executions without a violation
_NEAREST: Final = 3  # number of these executions on their card, those nearest to a violation


@dataclass(frozen=True)
class Card:
    """The card of a class."""

    class_id: str  # identifier of the class, or `PASSED`
    spec: str  # violated spec, or `PASSED`
    words: str  # the class as a sentence
    count: int  # number of executions
    first: int  # first of these executions
    look_at: int  # first execution that triage reproduced exactly; if there is none, the first execution
    facts: tuple[tuple[str, str], ...] = ()  # names and values of further facts
    replays: tuple[int | str, ...] = ()  # executions with their replays in the page, or what `minimal_name` returns
    minimal: int | None = None  # execution that is also shown in its simplest scenario; None if none is


def minimal_name(number: int) -> str:
    """Return the name of the replay of a minimized failure."""
    return f"{number}-minimized"


def cards(run: ReportedRun, limit: int) -> tuple[Card, ...]:
    """Return the cards of a run: its classes, the largest first, then the executions that passed most narrowly.

    Together, they have up to `limit` replays and the minimal ones. Each class gets one before any class gets two.
    """
    classes = run.classes
    found = [_card(class_id, findings, run.examined) for class_id, findings in classes.items()]
    queues: list[list[int | str]] = [
        [card.look_at, *(f.id for f in findings if f.id != card.look_at)]
        for card, findings in zip(found, classes.values(), strict=True)
    ]
    nearest = _nearest(run)
    if nearest is not None:
        found.append(nearest)
        queues.append(list(nearest.replays))
    turns = sorted((turn, i) for i, queue in enumerate(queues) for turn in range(len(queue)))
    chosen: list[list[int | str]] = [[] for _ in found]
    for turn, i in turns[:limit]:
        chosen[i].append(queues[i][turn])
    full = [replace(card, replays=tuple(numbers)) for card, numbers in zip(found, chosen, strict=True)]
    return tuple(_with_minimal(card, run) for card in full)


def _with_minimal(card: Card, run: ReportedRun) -> Card:
    """Return a card that also shows one of its failures in the simplest scenario, if there is one."""
    alike = (one for one in run.minimized.values() if one.class_id == card.class_id and one.reproduced)
    if (minimal := next(alike, None)) is None:
        return card
    sizes = zip(("parts", "free values"), minimal.found, minimal.minimal, strict=True)
    simpler = ", ".join(f"{name} {before} \N{RIGHTWARDS ARROW} {after}" for name, before, after in sizes)
    facts = (*card.facts, ("simplest scenario", f"of execution {minimal.id}: {simpler}"))
    return replace(card, facts=facts, replays=(*card.replays, minimal_name(minimal.id)), minimal=minimal.id)


def _card(class_id: str, findings: list[Finding], examined: frozenset[int]) -> Card:
    first = findings[0]
    known = [finding for finding in findings if finding.id in examined]
    shown = next((finding for finding in known if finding.same_trace), first)
    facts = {
        "fault": tally(fault_words(finding.fault) for finding in known if finding.fault),
        "cause": tally(finding.cause for finding in known),
        "signature": tally(finding.signature for finding in known),
        "last chance": tally(finding.last_chance.words for finding in known if finding.last_chance),
        "avoidable by": tally(finding.avoidance for finding in known),
        "not reproduced": str(sum(not finding.same_verdict for finding in known) or ""),
    }
    listed = tuple((name, text) for name, text in facts.items() if text)
    return Card(class_id, first.spec, shown.words, len(findings), first.id, shown.id, listed)


def _nearest(run: ReportedRun) -> Card | None:
    passed = [entry for entry in run.entries if not entry.violated]
    if not passed:
        return None
    order = sorted(passed, key=lambda entry: (np.isnan(entry.degree), entry.degree, entry.id))
    numbers = tuple(entry.id for entry in order[:_NEAREST])
    words = "No requirement violated; these executions came nearest to a violation"
    return Card(PASSED, PASSED, words, len(passed), passed[0].id, numbers[0], replays=numbers)


def replay_values(trace: Trace, record: Record, states: Sequence[tuple[str, int]]) -> dict[str, Any]:
    """Return a replay as JSON values. `states` is the abstract trace, see `Behaviors.stretches`.

    Raises:
        InputError: if the record holds no valid scenario.
    """
    event = violation_event(trace, record.violated)
    packed = pack(trace, event.frame if event else len(trace.time) - 1)
    scenario = record.load_scenario()
    npcs = scenario.npcs
    mark = None if event is None else violation_place(trace, event)
    return {
        **packed.values(),
        **_own_way(trace),
        "size": [[round(float(value), 2) for value in size] for size in trace.size],
        "types": [npc.type for npc in npcs],
        "routes": [npc.route for npc in npcs],
        "end": trace.end,
        "violated": list(record.violated),
        "mark": mark and [round(value, 2) for value in mark],
        "moment": packed.frames - 1 if event is None else int(np.searchsorted(packed.kept, event.frame)),
        "partner": event.partner if event and event.spec == R1 else 0,
        "states": list(states),
        "decisions": [(int(np.searchsorted(packed.kept, at)), name) for at, name in decisions(trace, scenario)],
    }


def _own_way(trace: Trace) -> dict[str, Any]:
    """Return the route and the destination of an execution in a highway-env environment, where each has its own."""
    if not trace.signals:
        return {}
    route = trace.route[:: max(1, len(trace.route) // 120)].round(2).tolist()
    return {"route": route, "destination": route[-1] if ARRIVED in trace.signals else None}


FRAME_TIME: Final = 0.1  # time between two frames of a replay [s]
MAX_FRAMES: Final = 900  # greatest number of frames of a replay; a longer one has frames farther apart
LENGTH_UNIT: Final = 0.01  # unit of positions [m]; larger where a replay spans more than 650 m
TURN: Final = 2 * np.pi / 65536  # unit of headings [rad]
SPEED_UNIT: Final = 0.01  # unit of speeds [m/s]
TIME_UNIT: Final = 0.01  # unit of times [s]
_SPAN: Final = 65_000  # usable range of an int16


@dataclass(frozen=True)
class Packed:
    """The motion of all vehicles, packed for the page's script.

    The data are a matrix of int16. Its rows are the time, the ego's speed, then x, y and heading of each vehicle. Each
    row holds the first value, then the differences, modulo 2^16. All low bytes come before all high bytes.
    """

    frames: int  # number of frames
    kept: Ints  # indices of these frames in the trace, shape (frames,)
    vehicles: int  # number of vehicles, the ego first
    middle: tuple[float, float]  # middle of all positions [m], the origin of x and y
    unit: float  # unit of x and y [m]
    data: str  # base64 of the deflated matrix
    spans: list[tuple[int, int]]  # first and last frame in which each vehicle is present

    def values(self) -> dict[str, Any]:
        """Return the fields for the page's script, as JSON values."""
        return {
            "frames": self.frames,
            "vehicles": self.vehicles,
            "middle": list(self.middle),
            "unit": self.unit,
            "data": self.data,
            "spans": self.spans,
        }


def pack(trace: Trace, frame: int) -> Packed:
    """Pack a trace. `frame` is the index of a frame that must be kept, even if others are left out."""
    kept = _kept(trace, frame)
    position = _held(trace)[kept]
    low, high = position.min((0, 1)), position.max((0, 1))
    middle = np.rint((low + high) / 2)
    unit = max(LENGTH_UNIT, float(np.ceil((high - low).max() / _SPAN * 1000) / 1000))
    places = np.rint((position - middle) / unit)
    headings = np.rint(np.unwrap(trace.heading[kept], axis=0) / TURN)
    speed = np.rint(np.hypot(*trace.velocity[kept, 0].T) / SPEED_UNIT)
    motion = np.stack([places[..., 0], places[..., 1], headings], axis=-1)  # (frames, vehicles, 3)
    rows = [np.rint(trace.time[kept] / TIME_UNIT), speed, *motion.reshape(len(kept), -1).T]
    origin = (float(middle[0]), float(middle[1]))
    return Packed(len(kept), kept, len(trace.size), origin, unit, _deflated(rows), _spans(trace, kept))


def _spans(trace: Trace, kept: Ints) -> list[tuple[int, int]]:
    """Return the first and the last of the kept frames in which each vehicle is present; (1, 0) if it is in none."""
    if not trace.present.size:
        return [(0, len(kept) - 1)] * len(trace.size)
    spans = []
    for seen in trace.present[kept].T:
        frames = np.flatnonzero(seen)
        spans.append((int(frames[0]), int(frames[-1])) if len(frames) else (1, 0))
    return spans


def _held(trace: Trace) -> Floats:
    """Return the positions. An absent vehicle is where it appears next, or else where it was last."""
    if not trace.present.size:
        return trace.position
    position = trace.position.copy()
    every = np.arange(len(trace.time))
    for vehicle, seen in enumerate(trace.present.T):
        frames = np.flatnonzero(seen)
        nearest = frames[np.clip(np.searchsorted(frames, every), 0, len(frames) - 1)]
        position[:, vehicle] = trace.position[nearest, vehicle]
    return position


def _kept(trace: Trace, frame: int) -> Ints:
    """Return frames about `FRAME_TIME` apart, with the given frame and the last one."""
    count = min(MAX_FRAMES, int(trace.duration / FRAME_TIME + 1e-6) + 1)
    times = np.linspace(0, (count - 1) * FRAME_TIME if count < MAX_FRAMES else trace.duration, count)
    even = np.searchsorted(trace.time, times - 1e-9)
    return np.unique(np.concatenate([even, [frame, len(trace.time) - 1]])).astype(np.int64)


def _deflated(rows: list[Floats]) -> str:
    steps: Ints = np.diff(np.stack(rows), axis=1, prepend=0).astype(np.int64)
    words = (steps & 0xFFFF).astype("<u2").ravel()
    planes = words.view(np.uint8).reshape(-1, 2).T  # high bytes are mostly equal, so they deflate better separately
    return base64.b64encode(zlib.compress(planes.tobytes(), 9)).decode("ascii")
