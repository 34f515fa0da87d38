"""Layout of charts, and of the bar that shows the time in each stage: positions, ticks and labels for SVG on a page."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from behavexplor.campaign.progress import STAGES
from behavexplor.data.array_types import Floats

WIDTH, HEIGHT = 360.0, 190.0  # size of a chart, in units of its view box
LEFT, RIGHT, TOP, BOTTOM = 38.0, 8.0, 8.0, 22.0  # margins
_TABLE_ROWS: Final = 12  # rows of the table under a chart
_MOST_POINTS: Final = 400  # points of a line or cloud


@dataclass(frozen=True)
class Series:
    """Values over the executions of a run."""

    name: str  # name in the legend and the table
    x: Floats  # numbers of executions, shape (n,)
    y: Floats  # values, shape (n,); NaN where there is none
    dots: bool = False  # whether the series is drawn as dots instead of a line
    style: int = 0  # index of a style of the page


@dataclass(frozen=True)
class DrawnSeries:
    """A series as shapes."""

    name: str
    style: int
    path: str  # SVG path of the line; empty for dots
    dots: tuple[tuple[float, float], ...]  # positions of the dots


@dataclass(frozen=True)
class Chart:
    """A chart with its axes."""

    title: str
    series: tuple[DrawnSeries, ...]
    x_ticks: tuple[tuple[float, str], ...]  # positions and labels of the ticks on the x axis
    y_ticks: tuple[tuple[float, str], ...]  # positions and labels of the ticks on the y axis
    rows: tuple[tuple[str, ...], ...]  # rows of the table under the chart: an execution, then a value of each series


def chart(title: str, series: Sequence[Series]) -> Chart | None:
    """Lay out a chart; None if no series has a value."""
    given = [line for line in series if np.isfinite(line.y).any()]
    if not given:
        return None
    x_end = max(1.0, *(float(line.x.max()) for line in given))
    y_end = max(float(np.nanmax(line.y)) for line in given)
    y_start = min(0.0, *(float(np.nanmin(line.y)) for line in given))
    values = np.concatenate([line.y[np.isfinite(line.y)] for line in given])
    are_whole = bool((values == np.rint(values)).all())
    y_marks = ticks(y_start, y_end, whole=are_whole)
    y_start, y_end = min(y_start, y_marks[0]), max(y_end, y_marks[-1])
    x_scale = Scale(0.0, x_end, LEFT, WIDTH - RIGHT)
    y_scale = Scale(y_start, y_end, HEIGHT - BOTTOM, TOP)
    return Chart(
        title,
        tuple(_drawn(line, x_scale, y_scale) for line in given),
        tuple((x_scale(mark), _label(mark)) for mark in ticks(0.0, x_end, whole=True) if mark <= x_end),
        tuple((y_scale(mark), _label(mark)) for mark in y_marks),
        _rows(given),
    )


@dataclass(frozen=True)
class Scale:
    """Linear map from values to positions on a chart, rounded to one decimal place."""

    least: float  # least value
    greatest: float  # greatest value
    first: float  # position of the least value
    last: float  # position of the greatest value

    def __call__(self, value: float) -> float:
        """Return the position of a value."""
        share = (value - self.least) / ((self.greatest - self.least) or 1.0)
        return round(self.first + share * (self.last - self.first), 1)


def ticks(start: float, end: float, most: int = 5, *, whole: bool = False) -> list[float]:
    """Return ticks that span a range of values; their distance is 1, 2 or 5 times a power of ten.

    It is the smallest such distance of which `most` span the range; for `whole` values, it is at least 1.
    """
    span = (end - start) or 1.0
    power = 10.0 ** math.floor(math.log10(span / most))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power * most >= span * (1 - 1e-9))
    step = max(step, 1.0) if whole else step
    first, last = math.floor(start / step + 1e-9), math.ceil(end / step - 1e-9)
    return [round(i * step, 12) for i in range(first, max(last, first + 1) + 1)]


def _label(value: float) -> str:
    return f"{value:g}"


def _drawn(line: Series, x_scale: Scale, y_scale: Scale) -> DrawnSeries:
    """Return a series as dots, or as a line of steps; thinned out to `_MOST_POINTS`."""
    known = np.flatnonzero(np.isfinite(line.y))
    if len(known) > _MOST_POINTS:
        known = known[np.linspace(0, len(known) - 1, _MOST_POINTS).astype(int)]
    points = tuple((x_scale(float(line.x[i])), y_scale(float(line.y[i]))) for i in known)
    if line.dots:
        return DrawnSeries(line.name, line.style, "", points)
    path = f"M{points[0][0]:g} {points[0][1]:g}"
    before = points[0]
    for point in points[1:]:
        changes = point[1] != before[1]
        if changes or point is points[-1]:  # a line of steps: a point without a change is left out
            path += f"H{point[0]:g}" + (f"V{point[1]:g}" if changes else "")
            before = point
    return DrawnSeries(line.name, line.style, path, ())


def _rows(series: Sequence[Series]) -> tuple[tuple[str, ...], ...]:
    """Return the rows of the table, for evenly spread executions, among them the first and the last."""
    numbers = sorted({int(x) for line in series for x in line.x})
    shown = [numbers[i] for i in sorted(set(np.linspace(0, len(numbers) - 1, _TABLE_ROWS).astype(int).tolist()))]
    values = [{int(x): float(y) for x, y in zip(line.x, line.y, strict=True)} for line in series]
    return tuple((str(number), *(_cell(at.get(number, math.nan)) for at in values)) for number in shown)


def _cell(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.4g}"


@dataclass(frozen=True)
class StagePart:
    """The part of a bar that stands for one stage."""

    name: str  # name of the stage
    words: str  # what the campaign does in it
    seconds: float  # time in the stage [s]
    begin: float  # where the part begins, in percent of the bar
    share: float  # length of the part, in percent of the bar
    style: int  # index of a style of the page


def stage_parts(stages: Mapping[str, float]) -> tuple[StagePart, ...]:
    """Return the parts of a bar, in the order of the stages, without those that took no time.

    `stages` has the time in each stage [s]; it is empty if that is not known.
    """
    total = sum(stages.values())
    parts, before = [], 0.0
    for style, (name, words) in enumerate(STAGES.items()):
        seconds = stages.get(name, 0.0)
        if seconds > 0:
            parts.append(
                StagePart(name, words, seconds, round(100 * before / total, 2), round(100 * seconds / total, 2), style)
            )
        before += seconds
    return tuple(parts)
