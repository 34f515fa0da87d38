"""Cost of everything but execution as a campaign grows: time for search, judging and novelty, and memory."""

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

POOL = 1000  # number of traces, which are told repeatedly: they do not guide the search, but cost as much time


def analysis_rows(env: str, method: str, sizes: tuple[int, ...]) -> list[Row]:
    """Return the CPU time per execution [ms] and the memory of the process [MiB] at several numbers of executions.

    The traces are real: the rule planner drives uniformly drawn scenarios. They are told repeatedly, so that the rate
    of new behavior does not fall. This is the most expensive case for a campaign.

    Args:
        env: environment.
        method: search method.
        sizes: numbers of executions at which a row is made.
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
