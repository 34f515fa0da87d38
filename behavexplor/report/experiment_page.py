"""The page of an experiment: intervals, curves and tables of its methods, as one self-contained HTML file."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from behavexplor.bench.comparisons import Curve
from behavexplor.bench.experiment import Experiment
from behavexplor.bench.statistics import Estimate
from behavexplor.bench.summaries import Summary, summary_rows
from behavexplor.bench.table import Table, marked, shown
from behavexplor.report.charts import WIDTH, Chart, Scale, Series, chart, ticks
from behavexplor.report.rendering import rendered

LEFT, RIGHT, TOP, BOTTOM, LINE = 118.0, 10.0, 6.0, 18.0, 15.0  # of a chart of intervals, in units of its view box
_TOO_WIDE: Final = ("classes", "signatures")  # columns left out of the table of campaigns


@dataclass(frozen=True)
class Bar:
    """A mean with its interval, as a line of a chart."""

    name: str  # name of the method
    y: float  # vertical position of the line
    x: float  # position of the mean
    low: float  # position of the lower end of the interval
    high: float  # position of the upper end of the interval
    text: str  # mean and interval as text
    dots: tuple[float, ...]  # positions of the single campaigns


@dataclass(frozen=True)
class Bars:
    """A chart of intervals, a line for each method."""

    title: str  # title of the chart
    bars: tuple[Bar, ...]  # lines of the chart, from top to bottom
    x_ticks: tuple[tuple[float, str], ...]  # positions and labels of the ticks
    height: float  # height of the chart


def experiment_page(
    experiment: Experiment, summaries: Sequence[Summary], tables: Sequence[Table], curves: Sequence[Curve]
) -> str:
    """Return the page in ASCII. Equal experiments give equal pages.

    `summaries`: of the finished campaigns; `tables`, `curves`: theirs, from `bench.tables` and `bench.comparisons`.
    """
    return rendered(
        "experiment.html.jinja",
        ("theme.js",),
        experiment=experiment,
        total=len(experiment.runs()),
        finished=len(summaries),
        figures=_figures(experiment, curves),
        tables=[_table(table) for table in tables],
        campaigns=_campaigns(experiment, summaries),
        parameters=experiment.to_yaml(),
    )


def _figures(experiment: Experiment, curves: Sequence[Curve]) -> list[dict[str, object]]:
    """Return the charts of each figure: for each environment and ADS a chart of intervals and a chart of curves."""
    styles = {name: i for i, name in enumerate(experiment.methods)}
    panels: dict[str, dict[str, list[Curve]]] = {}
    for curve in curves:
        place = f"{curve.env}, {curve.ads}" if experiment.has_several_ads else curve.env
        panels.setdefault(curve.figure, {}).setdefault(place, []).append(curve)
    figures: list[dict[str, object]] = []
    for name, groups in panels.items():
        marks = _marks([curve for group in groups.values() for curve in group])
        intervals = [bars(place, group, marks) for place, group in groups.items()]
        charts = [drawn for place, group in groups.items() if (drawn := _lines(place, group, styles))]
        figures.append({"name": name, "bars": intervals, "charts": charts})
    return figures


def _marks(curves: Sequence[Curve]) -> list[float]:
    """Return the marks of an axis on which the final counts of all these curves have room."""
    values = [value for curve in curves for value in (*_interval(curve.found[-1]), *curve.ends)]
    return ticks(min(0.0, *values), max(1.0, *values))


def bars(title: str, curves: Sequence[Curve], marks: Sequence[float]) -> Bars:
    """Return the chart of each method's final count, with its interval and the single campaigns, on a marked axis."""
    across = Scale(marks[0], marks[-1], LEFT, WIDTH - RIGHT)
    made = []
    for i, curve in enumerate(curves):
        final = curve.found[-1]
        low, high = _interval(final)
        interval = "" if math.isnan(final.low) else f" [{low:.1f}, {high:.1f}]"
        dots = tuple(across(end) for end in sorted(set(curve.ends)))
        y, text = TOP + LINE * (i + 0.5), f"{final.mean:.1f}{interval}"
        made.append(Bar(curve.method, y, across(final.mean), across(low), across(high), text, dots))
    height = TOP + LINE * len(curves) + BOTTOM
    return Bars(title, tuple(made), tuple((across(mark), f"{mark:g}") for mark in marks), height)


def _interval(count: Estimate) -> tuple[float, float]:
    return (count.mean, count.mean) if math.isnan(count.low) else (count.low, count.high)


def _lines(title: str, curves: Sequence[Curve], styles: Mapping[str, int]) -> Chart | None:
    """Return the chart of the means over the executions."""
    series = [
        Series(
            curve.method,
            np.array([0.0, *curve.executions]),
            np.array([0.0, *(point.mean for point in curve.found)]),
            style=styles[curve.method],
        )
        for curve in curves
    ]
    return chart(title, series)


def _table(table: Table) -> dict[str, object]:
    """Return a table for the template, with a flag for each cell that is the best of its block."""
    columns = [i for i, column in enumerate(table.columns) if not column.only_csv]
    best = marked(table)
    last = set(np.cumsum(table.blocks).tolist())
    rows = [
        {"cells": [(shown(row[i], table.columns[i]), (number, i) in best) for i in columns], "ends": number + 1 in last}
        for number, row in enumerate(table.rows)
    ]
    heads = [table.columns[i].name for i in columns]
    words = [bool(table.rows) and isinstance(table.rows[0][i], str) for i in columns]
    return {
        "name": table.name,
        "title": table.title,
        "heads": list(zip(heads, words, strict=True)),
        "rows": rows,
        "notes": table.notes,
    }


def _campaigns(experiment: Experiment, summaries: Sequence[Summary]) -> list[dict[str, str]]:
    """Return the rows of the table of campaigns, each with its run folder."""
    folders = {(run.env, run.ads, run.method, run.seed): run.folder.as_posix() for run in experiment.runs()}
    rows = []
    for summary, row in zip(summaries, summary_rows(summaries), strict=True):
        kept = {name: str(value) for name, value in row.items() if name not in _TOO_WIDE}
        rows.append({**kept, "run folder": folders[summary.env, summary.ads, summary.method, summary.seed]})
    return rows
