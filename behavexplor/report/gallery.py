"""The gallery: a card with replays for each class of violations."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any, Final

import numpy as np

from behavexplor.campaign.record import Record
from behavexplor.data.trace import ARRIVED, Trace
from behavexplor.judge.events import R1, violation_event
from behavexplor.report.marks import violation_place
from behavexplor.report.packing import pack
from behavexplor.report.reading import ReportedRun
from behavexplor.triage.findings import Finding, counted
from behavexplor.triage.minimized import Minimized

PASSED: Final = "passed"  # replaces the class of executions without a violation
_NEAREST: Final = 3  # number of these executions on their card, those nearest to a violation


@dataclass(frozen=True)
class Card:
    """The card of a class.

    Attributes:
        class_id: identifier of the class, or `PASSED`.
        spec: violated spec, or `PASSED`.
        words: the class as a sentence.
        count: number of executions.
        first: first of these executions.
        look_at: first execution that triage reproduced exactly; if there is none, the first execution.
        facts: names and values of further facts.
        replays: executions with their replays in the page, or what `minimal_name` returns.
        is_minimal: whether this card shows a minimized failure.
    """

    class_id: str
    spec: str
    words: str
    count: int
    first: int
    look_at: int
    facts: tuple[tuple[str, str], ...] = ()
    replays: tuple[int | str, ...] = ()
    is_minimal: bool = False


def minimal_name(number: int) -> str:
    """Return the name of the replay of a minimized failure."""
    return f"{number}-minimized"


def cards(run: ReportedRun, limit: int) -> tuple[Card, ...]:
    """Return the cards of a run: its classes, the largest first, then the executions that passed most narrowly.

    Args:
        run: the run.
        limit: greatest number of replays. Each class gets one replay before any class gets two.
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
    shown: list[Card] = []
    for card in full:
        alike = (one for one in run.minimized.values() if one.class_id == card.class_id and one.reproduced)
        shown += [card, *(_minimal_card(card, one) for one in islice(alike, 1))]
    return tuple(shown)


def _minimal_card(card: Card, minimal: Minimized) -> Card:
    """Return the card beside that of a class, with one of its failures in the simplest scenario."""
    sizes = zip(("vehicles", "free values"), minimal.found, minimal.minimal, strict=True)
    facts = tuple((name, f"{before} \N{RIGHTWARDS ARROW} {after}") for name, before, after in sizes)
    return Card(
        class_id=card.class_id,
        spec=card.spec,
        words=f"The failure of execution {minimal.id} in the simplest scenario in which it still happens",
        count=1,
        first=minimal.id,
        look_at=minimal.id,
        facts=facts,
        replays=(minimal_name(minimal.id),),
        is_minimal=True,
    )


def _card(class_id: str, findings: list[Finding], examined: frozenset[int]) -> Card:
    first = findings[0]
    known = [finding for finding in findings if finding.id in examined]
    shown = next((finding for finding in known if finding.same_trace), first)
    facts = {
        "fault": counted(finding.fault for finding in known),
        "cause": counted(finding.cause for finding in known),
        "signature": counted(finding.signature for finding in known),
        "last chance": counted(finding.last_chance.words for finding in known if finding.last_chance),
        "avoidable by": counted(finding.avoidance for finding in known),
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
    """Return a replay as JSON values.

    Args:
        trace: trace of the execution.
        record: record of the execution.
        states: its abstract trace, see `behavexplor.report.behavior_map.Behaviors.stretches`.

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
    }


def _own_way(trace: Trace) -> dict[str, Any]:
    """Return the route and the destination of an execution in a highway-env environment, where each has its own."""
    if not trace.signals:
        return {}
    route = trace.route[:: max(1, len(trace.route) // 120)].round(2).tolist()
    return {"route": route, "destination": route[-1] if ARRIVED in trace.signals else None}
