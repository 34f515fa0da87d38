"""What everything but execution costs as a campaign grows: search, judging and novelty, and memory."""

import resource
import time
from itertools import cycle
from typing import Any

import numpy as np

from behavexplor.behavior.novelty import NoveltyArchive
from behavexplor.campaign.campaign import search_method
from behavexplor.campaign.config import CampaignConfig
from behavexplor.execution.simulation import Simulation
from behavexplor.judge.specs import SPECS, judge

Row = dict[str, Any]

POOL = 1000  # traces that are told again and again: the search is not steered, but has as much to do


def analysis_rows(env: str, method: str, sizes: tuple[int, ...]) -> list[Row]:
    """CPU milliseconds for each execution around some numbers of executions, and the process's memory there.

    The traces are real, of scenarios drawn uniformly and driven by the rule planner. A campaign that finds behavior
    new as often as on its first day has the most to do: here every trace counts as new as it was once.
    """
    simulation = Simulation(env, "rule:hardened")
    generator = np.random.default_rng(0)
    scenarios = [simulation.logical.sample(generator) for _ in range(POOL)]
    traces = cycle([trace for _, trace in sorted(simulation.run_all(scenarios), key=lambda pair: pair[0])])
    search = search_method(CampaignConfig(env=env, method=method), simulation.logical)
    archive = NoveltyArchive()
    rows, used, before = [], 0.0, 0
    for number in range(1, max(sizes) + 1):
        trace = next(traces)
        start = time.process_time()
        candidate = search.ask()
        verdict = judge(trace, SPECS)
        archive.observe(trace)
        search.tell(candidate, trace, verdict)
        used += time.process_time() - start
        if number in sizes:
            rows.append(
                {
                    "method": method,
                    "executions": number,
                    "ms per execution since the last row": 1000 * used / (number - before),
                    "memory [MiB]": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
                }
            )
            used, before = 0.0, number
    return rows
