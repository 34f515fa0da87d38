"""The report on runs as one self-contained HTML file, with a section for each run: gallery, curves and behaviors."""

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from behavexplor.behavior.features import TIME_STEP
from behavexplor.behavior.novelty import NOVELTY_THRESHOLD
from behavexplor.campaign.record import Record
from behavexplor.campaign.run_summary import snippet
from behavexplor.campaign.store import Store
from behavexplor.data.array_types import Floats
from behavexplor.data.conventions import VEHICLE_SIZES
from behavexplor.data.durable import write_durably, writing
from behavexplor.data.trace import Trace
from behavexplor.data.untrusted import read_file
from behavexplor.errors import InputError
from behavexplor.judge.specs import SPECS
from behavexplor.repair.pairs import Pairs, side_by_side
from behavexplor.report.behavior_map import LETTERS, Behaviors, find_behaviors
from behavexplor.report.charts import Chart, Series, StagePart, chart, stage_parts
from behavexplor.report.gallery import MAX_FRAMES, PASSED, Card, cards, minimal_name, replay_values
from behavexplor.report.marks import type_color
from behavexplor.report.reading import ReportedRun
from behavexplor.report.rendering import rendered
from behavexplor.report.road_shapes import known_road, road_values
from behavexplor.triage.findings import minimized_trace_path

PAGE: Final = "report.html"
MOST_REPLAYS: Final = 2000  # greatest number of replays of each run
MOST_COMPARED: Final = 750  # greatest number of executions on the map of behaviors
MOST_POSITIONS: Final = 50_000_000  # greatest number of positions, one of each vehicle in each frame, in a run's traces
MOST_STATES: Final = 2_000_000  # greatest length of all behaviors on the map together, in abstract states
MOST_SHOWN: Final = 200_000  # greatest number of positions in one replay

_NOT_EXAMINED: Final = "not examined"
_PASSED_RIBBONS, _CLASS_RIBBONS = 8, 30  # greatest numbers of ribbons of executions that passed, and of classes
_SYMBOLS: Final = {
    "R1": "R1: collision",
    "R2": "R2: illegal line touched",
    "R3": "R3: destination missed",
    PASSED: "no violation",
}


def page(runs: Sequence[ReportedRun], replays: int, pairs: Sequence[Pairs] = ()) -> str:
    """Return the report on runs, at least one, as a page in ASCII. Equal run folders give equal pages.

    `replays` is the greatest number of replays of each run. `pairs` compares the drivers of the first two runs in the
    same scenarios, see `behavexplor.repair.pairs`; the page then begins with what the second driver fixes and breaks.
    It is empty for runs that are not compared.

    Raises:
        InputError: if a run is damaged, or the number of replays is out of range.
    """
    if not 0 <= replays <= MOST_REPLAYS:
        raise InputError(f"The number of replays must lie between 0 and {MOST_REPLAYS}, not be {replays}")
    words = [{finding.id: finding.words for finding in run.findings} for run in runs[:2]]
    compared = side_by_side(pairs, words, replays) if pairs else None
    labels = _labels(runs, are_paired=bool(pairs))
    shown = compared.shown if compared else ()
    sections = [
        section(number, run, label, replays, shown if number <= 2 else ())  # the first two runs are compared
        for number, (run, label) in enumerate(zip(runs, labels, strict=True), 1)
    ]
    several = len(runs) > 1
    return rendered(
        "page.html.jinja",
        ("theme.js", "page.js"),
        sections=sections,
        comparison=comparison(runs) if several else (),
        overlaid=curves(runs, labels) if several and not pairs else (),
        class_rows=class_rows(runs) if several else (),
        pairs=compared,
        values={"runs": [part.values for part in sections]},
        PASSED=PASSED,
    )


def _labels(runs: Sequence[ReportedRun], *, are_paired: bool) -> list[str]:
    """Return what the runs are called in a page: by their drivers if these are compared, or else by their folders."""
    if are_paired:  # two runs in drawn scenarios, then two in searched ones, if any
        patterns = ("A: {}", "B: {}", "A: {}, searched", "B: {}, searched")
        return [pattern.format(run.config.ads) for pattern, run in zip(patterns, runs, strict=False)]
    return [run.name if len(runs) == 1 else f"{i} {run.name}" for i, run in enumerate(runs, 1)]


def written(path: Path, text: str) -> Path:
    """Write a page, and return its path.

    Raises:
        InputError: if it cannot be written.
    """
    with writing(f"The report {path}"):
        write_durably(path, text)
    return path


@dataclass(frozen=True)
class Ribbon:
    """The behavior of one execution as a strip."""

    id: int  # number of the execution
    class_id: str  # class of its card, or `PASSED` without a violation
    # begin and length of each stretch of one abstract state, in percent of the longest ribbon, and the state
    strip: tuple[tuple[float, float, int], ...]
    text: str  # the abstract trace as text
    linked: bool  # whether the replay is in the page


@dataclass(frozen=True)
class MapPoint:
    """One execution on the map of behaviors."""

    id: int  # number of the execution
    x: float  # horizontal position, in [0, 100]
    y: float  # vertical position, in [0, 100]
    spec: str  # first violated spec, or `PASSED`
    class_id: str  # class of the failure, or `PASSED`
    linked: bool  # whether the replay is in the page


@dataclass(frozen=True)
class Section:
    """The content of a section about one run."""

    number: int  # number of the run in the page, counted from 1
    run: ReportedRun  # the run
    label: str  # what it is called in the page
    limit: int  # greatest number of replays
    cards: tuple[Card, ...]  # cards of the gallery
    charts: tuple[Chart, ...]  # curves over the executions
    found: Behaviors  # behaviors
    ribbons: tuple[Ribbon, ...]  # behaviors of some executions as ribbons
    longest: float  # duration of the longest ribbon [s]
    places: tuple[MapPoint, ...]  # executions on the map of behaviors
    has_road: bool  # whether the road of the environment is known
    left_out: bool  # whether executions are left out because they are too long, or have too many vehicles
    values: Mapping[str, Any]  # data for the page's script

    @property
    def embedded(self) -> int:
        """Number of replays in the page."""
        return len(self.values["replays"])

    @property
    def types(self) -> list[tuple[str, int]]:
        """Vehicle types in the replays, with the numbers of their colors."""
        names = {name for replay in self.values["replays"].values() for name in replay["types"]}
        known = [(name, type_color(name)) for name in VEHICLE_SIZES if name in names]
        return known + ([("other", type_color("other"))] if names - VEHICLE_SIZES.keys() else [])

    @property
    def symbols(self) -> list[tuple[str, str]]:
        """Specs on the map, with their labels."""
        present = {place.spec for place in self.places}
        known = [(spec, name) for spec, name in _SYMBOLS.items() if spec in present]
        return known + ([("other", "other failure")] if present - _SYMBOLS.keys() else [])

    @property
    def stages(self) -> tuple[StagePart, ...]:
        """Where the time of the run went; empty if it is not known."""
        return stage_parts(self.run.stages)

    @property
    def snippet(self) -> str:
        """Lines of Python that drive the first failure again."""
        return snippet(self.run.name, self.run.findings[0].id)

    @property
    def parameters(self) -> list[tuple[str, str]]:
        """Names and values of the campaign's configuration."""
        return [(name, _value_text(value)) for name, value in asdict(self.run.config).items()]


def _value_text(value: Any) -> str:
    """Return a value of a configuration as a reader would write it."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {_value_text(one)}" for key, one in value.items()) or "none"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return ", ".join(map(_value_text, value)) or "none"
    return "none" if value in (None, "") else str(value)


def section(number: int, run: ReportedRun, label: str, limit: int, wanted_first: Sequence[int] = ()) -> Section:
    """Return the section about a run, with the replays of the executions `wanted_first`, and up to `limit` others.

    `number` counts the runs in the page from 1; `label` names the run in charts.

    Raises:
        InputError: if the run is damaged.
    """
    gallery = cards(run, limit)
    replayed = {*wanted_first, *(name for card in gallery for name in card.replays if isinstance(name, int))}
    classes = [card for card in gallery if card.class_id != PASSED]
    strips = [(card.look_at, card.class_id) for card in classes][:_CLASS_RIBBONS]
    new = [entry.id for entry in run.entries if entry.novel and not entry.violated]
    strips += [(name, PASSED) for name in evenly(new, _PASSED_RIBBONS)]
    compared = evenly([entry.id for entry in run.entries], MOST_COMPARED)
    # the most important first, because only as many are read as fit into the page
    by_importance = [*wanted_first, *sorted(replayed), *(name for name, _ in strips), *compared]
    wanted = list(dict.fromkeys(by_importance))
    traces, records = _looked_at(run, wanted, replayed)
    strips = [(name, class_id) for name, class_id in strips if name in traces]
    found = find_behaviors(traces)
    replays = _replays(run, traces, records, found) | _minimal_replays(run, gallery)
    shown = [replace(card, replays=tuple(name for name in card.replays if str(name) in replays)) for card in gallery]
    shape = known_road(run.config.env, run.folder)
    longest = max((len(found.labels[name]) for name, _ in strips), default=0) or 1
    return Section(
        number=number,
        run=run,
        label=label,
        limit=limit,
        cards=tuple(shown),
        charts=curves([run], [label]) + clouds(run),
        found=found,
        ribbons=tuple(_ribbon(found, name, class_id, longest, name in records) for name, class_id in strips),
        longest=longest * TIME_STEP,
        places=_places(run, found, records),
        has_road=bool(shape.surfaces),
        left_out=len(traces) < len(wanted) or shown != list(gallery),
        values={"road": road_values(shape, list(traces.values())), "replays": replays},
    )


def _looked_at(
    run: ReportedRun, wanted: Sequence[int], replayed: Collection[int]
) -> tuple[dict[int, Trace], dict[int, Record]]:
    """Return the traces of the wanted executions, and the records of the replayed ones, by their numbers.

    The wanted are taken in order until `MOST_POSITIONS` or `MOST_STATES` is exceeded, but always the first of them.
    """
    traces: dict[int, Trace] = {}
    records: dict[int, Record] = {}
    positions_left, states_left = MOST_POSITIONS, float(MOST_STATES)
    with closing(Store.read(run.folder)) as store:
        for number in wanted:
            execution = store.execution(number)
            trace = execution.load_trace()
            positions_left -= trace.heading.size
            states_left -= trace.duration / TIME_STEP
            if traces and min(positions_left, states_left) < 0:
                break
            traces[number] = trace
            if number in replayed and _fits(trace):
                records[number] = execution.record
    return dict(sorted(traces.items())), dict(sorted(records.items()))  # the page depends on their order


def evenly(numbers: Sequence[int], count: int) -> list[int]:
    """Return at most `count` of the numbers, evenly spread."""
    if len(numbers) <= count:
        return list(numbers)
    return [numbers[i] for i in np.linspace(0, len(numbers) - 1, count).astype(int)]


def _fits(trace: Trace) -> bool:
    """Return whether the replay of a trace is small enough for the page."""
    return min(len(trace.time), MAX_FRAMES) * len(trace.size) <= MOST_SHOWN


def _replays(
    run: ReportedRun, traces: Mapping[int, Trace], records: Mapping[int, Record], found: Behaviors
) -> dict[str, Any]:
    """Return the replays by the numbers of their executions."""
    replays = {}
    for number, record in records.items():
        try:
            replays[str(number)] = replay_values(traces[number], record, found.stretches(number))
        except InputError as error:
            raise InputError(f"{run.folder}: execution {number} has no valid scenario: {error}") from None
    return replays


def _minimal_replays(run: ReportedRun, gallery: Sequence[Card]) -> dict[str, Any]:
    """Return the replays of minimized failures by their names."""
    replays = {}
    for number in (card.minimal for card in gallery if card.minimal is not None):
        minimal, path = run.minimized[number], minimized_trace_path(run.folder, number)
        try:
            trace = Trace.from_bytes(read_file(path))
            if not _fits(trace):
                continue
            record = Record(id=number, end=trace.end, violated=minimal.violated, scenario=minimal.scenario)
            replays[minimal_name(number)] = replay_values(trace, record, ())
        except (OSError, ValueError) as error:
            raise InputError(f"{path} cannot be read: {error}; delete it and minimize again") from None
    return replays


def _ribbon(found: Behaviors, number: int, class_id: str, longest: int, linked: bool) -> Ribbon:
    strip, begin = [], 0
    for letter, count in found.stretches(number):
        strip.append((round(100 * begin / longest, 2), round(100 * count / longest, 2), LETTERS.index(letter)))
        begin += count
    return Ribbon(number, class_id, tuple(strip), found.text(number), linked)


def _places(run: ReportedRun, found: Behaviors, replayed: Collection[int]) -> tuple[MapPoint, ...]:
    """Return the map, scaled into a square. Failures come last, so that they are drawn on top."""
    kinds = {finding.id: (finding.spec, finding.class_id) for finding in run.findings}
    points = np.array(list(found.places.values()))
    extent = np.ptp(points, axis=0)
    scaled = (points - points.min(0) - extent / 2) / max(float(extent.max()), 1e-9) * 100 + 50
    places = []
    for number, (x, y) in zip(found.places, scaled, strict=True):
        spec, class_id = kinds.get(number, (PASSED, PASSED))
        places.append(MapPoint(number, round(float(x), 1), round(float(y), 1), spec, class_id, number in replayed))
    return tuple(sorted(places, key=lambda place: (place.spec != PASSED, place.id)))


def curves(runs: Sequence[ReportedRun], labels: Sequence[str]) -> tuple[Chart, ...]:
    """Return the curves of failures, classes and new behaviors over the executions, for one run or several."""
    counts: dict[str, list[Series]] = {"Failures": [], "Classes of violations": [], "New behaviors": []}
    for index, (run, label) in enumerate(zip(runs, labels, strict=True)):
        numbers = np.array([entry.id + 1.0 for entry in run.entries])
        for title, steps in zip(counts, _steps(run), strict=True):
            name = title.lower() if len(runs) == 1 else label
            counts[title].append(Series(name, numbers, np.cumsum(steps), style=index))
    charts = (chart(title, series) for title, series in counts.items())
    return tuple(drawn for drawn in charts if drawn is not None)


def _steps(run: ReportedRun) -> tuple[Floats, Floats, Floats]:
    """Return three arrays of 1 and 0 over the executions: failure, first failure of its class, new behavior."""
    firsts = {findings[0].id for findings in run.classes.values()}
    return (
        np.array([float(bool(entry.violated)) for entry in run.entries]),
        np.array([float(entry.id in firsts) for entry in run.entries]),
        np.array([float(entry.novel) for entry in run.entries]),
    )


def clouds(run: ReportedRun) -> tuple[Chart, ...]:
    """Return the charts of novelty and energy over the executions, if the records have them."""
    limit = np.full(len(run.entries), NOVELTY_THRESHOLD)
    novelty = np.array([entry.novelty for entry in run.entries])
    energy = np.array([entry.energy for entry in run.entries])
    numbers = np.array([entry.id + 1.0 for entry in run.entries])
    threshold = [Series("threshold of new behavior", numbers, limit, style=2)] if np.isfinite(novelty).any() else []
    charts = (
        chart("Novelty", _cloud(run, numbers, novelty) + threshold),
        chart("Energy of the parent", _cloud(run, numbers, energy)),
    )
    return tuple(drawn for drawn in charts if drawn is not None)


def _cloud(run: ReportedRun, numbers: Floats, values: Floats) -> list[Series]:
    failed = np.array([bool(entry.violated) for entry in run.entries])
    return [
        Series("no violation", numbers, np.where(failed, np.nan, values), dots=True, style=0),
        Series("failed", numbers, np.where(failed, values, np.nan), dots=True, style=1),
    ]


def _by_requirement(counts: Mapping[str, int]) -> str:
    """Return the numbers of failures of R1, R2 and R3, then those of others by name."""
    own = {spec.name for spec in SPECS}
    return ", ".join(str(count) if name in own else f"{name} {count}" for name, count in counts.items())


_FIGURES: Final[dict[str, Callable[[ReportedRun], str]]] = {  # rows of the comparison
    "environment": lambda run: run.config.env,
    "driving system": lambda run: run.config.ads,
    "method": lambda run: run.config.method,
    "seed": lambda run: str(run.config.seed),
    "executions": lambda run: str(len(run.entries)),
    "failed": lambda run: f"{len(run.findings)} ({len(run.findings) / len(run.entries):.1%})",
    "collision (R1), lines (R2), destination (R3)": lambda run: _by_requirement(run.specs()),
    "classes": lambda run: str(len(run.classes)),
    "first failure": lambda run: str(run.findings[0].id) if run.findings else "none",
    "another vehicle's fault": lambda run: str(run.by_others()),
    "collisions at fault": lambda run: str(run.faults()[0]) if run.examined else _NOT_EXAMINED,
    "did not reproduce": lambda run: str(run.flaky()) if run.examined else _NOT_EXAMINED,
    "new behavior": lambda run: f"{run.novel / len(run.entries):.1%}",
}


def comparison(runs: Sequence[ReportedRun]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Return the rows of the comparison: the name of a figure, then its value for each run."""
    return tuple((name, tuple(figure(run) for run in runs)) for name, figure in _FIGURES.items())


def class_rows(runs: Sequence[ReportedRun]) -> tuple[tuple[str, tuple[int, ...]], ...]:
    """Return the count of each class in each run, the classes found in most runs first."""
    counts = [{name: len(findings) for name, findings in run.classes.items()} for run in runs]
    names = {name for count in counts for name in count}
    rows = [(name, tuple(count.get(name, 0) for count in counts)) for name in names]
    return tuple(sorted(rows, key=lambda row: (-sum(n > 0 for n in row[1]), -sum(row[1]), row[0])))
