"""Campaigns that are cut off at the same time, because the paper gives all methods the same time."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from behavexplor.bench.experiment import Experiment
from behavexplor.bench.summaries import Summary
from behavexplor.bench.table import place_cells


@dataclass(frozen=True)
class EqualTime:
    """The campaigns of an experiment, cut off at the same time.

    Attributes:
        summaries: summaries of what the campaigns found until then.
        notes: sentences that say which time it is.
    """

    summaries: tuple[Summary, ...]
    notes: tuple[str, ...]


def in_equal_time(experiment: Experiment, summaries: Sequence[Summary]) -> EqualTime | None:
    """Return the campaigns of an experiment in equal time; None if a time was not measured.

    The time is that of the paper's budget: the simulated time of the executions, and the time for everything else. In
    each environment, all campaigns are cut off at the time that the shortest one took.
    """
    if any(math.isnan(summary.time) for summary in summaries):
        return None
    cut, limits = [], []
    for env, ads in experiment.places:
        here = [summary for summary in summaries if (summary.env, summary.ads) == (env, ads)]
        if here:
            limit = min(summary.time for summary in here)
            cut += [summary.within(limit) for summary in here]
            limits.append(f"{' with '.join(place_cells(experiment, env, ads))} {limit / 3600:.2f} h")
    notes = (
        f"The time of the shortest campaign: {', '.join(limits)}. It is the simulated time of the executions, "
        "and the measured time for everything else, spread evenly over the executions.",
    )
    return EqualTime(tuple(cut), notes)
