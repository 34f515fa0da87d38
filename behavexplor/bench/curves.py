"""Discovery curves: numbers of failures, of their classes and of weaknesses, over the number of executions."""

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from behavexplor.bench.comparisons import compared_figures
from behavexplor.bench.experiment import Experiment
from behavexplor.bench.statistics import Estimate
from behavexplor.bench.summaries import Summary
from behavexplor.bench.table import mean, of_group

POINTS: Final = 50  # approximate number of points of a curve

_COLUMNS: Final = ("figure", "env", "ads", "method", "executions", "n", "mean", "low", "high")


@dataclass(frozen=True)
class Curve:
    """The mean over campaigns of a count of findings, by number of executions."""

    figure: str  # counted findings, such as "failures at fault"; see `behavexplor.bench.comparisons.compared_figures`
    env: str  # environment
    ads: str  # driving system under test
    method: str  # name of the search method in the experiment
    executions: tuple[int, ...]  # numbers of executions, increasing up to the budget
    found: tuple[Estimate, ...]  # estimates of the count, one for each number of executions


def curves(experiment: Experiment, summaries: Sequence[Summary]) -> list[Curve]:
    """Return all curves of an experiment, for the figures in which its methods are compared."""
    step = max(1, math.ceil(experiment.budget / POINTS))
    at = tuple(sorted({*range(step, experiment.budget, step), experiment.budget}))
    groups = dict.fromkeys((summary.env, summary.ads, summary.method) for summary in summaries)
    early = {  # what each campaign had found after each number of executions
        group: [[one.first(min(count, one.executions)) for one in of_group(summaries, group)] for count in at]
        for group in groups
    }
    return [
        Curve(name, *group, at, tuple(mean(found, figure) for found in early[group]))
        for _, name, figure in compared_figures(summaries)
        for group in groups
    ]


def curves_csv(found: Sequence[Curve]) -> str:
    """Return the curves as CSV, with a row for each point."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for curve in found:
        for count, point in zip(curve.executions, curve.found, strict=True):
            ends = ("" if math.isnan(end) else round(end, 6) for end in (point.low, point.high))
            writer.writerow(
                (curve.figure, curve.env, curve.ads, curve.method, count, point.n, round(point.mean, 6), *ends)
            )
    return text.getvalue()


def curves_svg(found: Sequence[Curve]) -> str | None:
    """Return the curves as an SVG figure with a panel for each environment and ADS; None without matplotlib."""
    try:
        import matplotlib as mpl  # noqa: PLC0415 - heavy and optional
        from matplotlib.figure import Figure  # noqa: PLC0415
    except ModuleNotFoundError:
        return None
    places = list(dict.fromkeys((curve.env, curve.ads) for curve in found))
    figures = list(dict.fromkeys(curve.figure for curve in found))
    several_ads = len(places) > len({env for env, _ in places})
    text = io.StringIO()
    settings: Any = {"svg.hashsalt": "behavexplor", "svg.fonttype": "none", "axes.spines.top": False}
    with mpl.rc_context({**settings, "axes.spines.right": False}):
        sheet = Figure(figsize=(4.2 * len(places), 3.2 * len(figures)), layout="constrained")
        panels = sheet.subplots(len(figures), len(places), squeeze=False)
        for row, figure in enumerate(figures):
            for column, (env, ads) in enumerate(places):
                panel = panels[row][column]
                for curve in found:
                    if (curve.figure, curve.env, curve.ads) == (figure, env, ads):
                        _draw(panel, curve)
                panel.set(title=f"{env}, {ads}" if several_ads else env, xlabel="executions", ylabel=figure)
        panels[0][0].legend(frameon=False, fontsize="small")
        sheet.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    return text.getvalue()


def _draw(panel: Any, curve: Curve) -> None:
    """Draw a curve with its confidence interval."""
    means = [point.mean for point in curve.found]
    (line,) = panel.plot(curve.executions, means, label=curve.method)
    low, high = ([getattr(point, end) for point in curve.found] for end in ("low", "high"))
    panel.fill_between(curve.executions, low, high, color=line.get_color(), alpha=0.15, lw=0)
