"""Puts the measured figures of speed into the pages and the figure: python docs/performance.py.

The figures are those of `python -m benchmarks --json docs/data/performance.json`. A table stands between the lines
`<!-- figures: PART -->` and `<!-- end -->`, where PART is a part of the benchmarks, or `goals`.
"""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.__main__ import table

DOCS = Path(__file__).parent
FIGURES = DOCS / "data" / "performance.json"
PAGES = (DOCS / "performance.md", DOCS / "highway-env.md")
PLACE = re.compile(r"(?<=<!-- figures: )(\w+) -->\n.*?(?=<!-- end -->)", re.DOTALL)
# The heading of each column, and the key of its figures.
COLUMNS: Mapping[str, Mapping[str, str]] = {
    "execution": {
        "scenario": "env",
        "driver": "ads",
        "batch": "batch",
        "ms per execution": "ms per execution",
        "ms per simulated second": "ms per simulated second",
        "times objects": "x objects",
        "times gymnasium": "x gymnasium",
    },
    "workers": {"driver": "ads", "workers": "workers", "executions per second": "executions per second, wall"},
    "analysis": {
        "executions": "executions",
        "ms per execution since the row before": "ms per execution since the last row",
        "memory of the process [MiB]": "memory [MiB]",
    },
    "startup": {
        "command": "command",
        "seconds": "seconds",
        "executions of highway-env in that time": "executions of highway-env",
    },
    "stages": {
        "driver": "driver",
        "workers": "workers",
        **{name: name for name in ("starting", "asking", "executing", "waiting", "judging", "mining", "storing")},
        "CPU of its own process": "CPU of its own process",
    },
    "highway": {
        "environment": "environment",
        "highway-env [ms]": "highway-env ms",
        "times as fast: batch 1": "x batch 1",
        "batch 16": "x batch 16",
        "batch 256": "x batch 256",
        "EnvPool, batch 256": "x EnvPool 256",
    },
}
CRUISER = "benchmarks.execution:Cruiser"
NAMES = {CRUISER: "ten lines of Python", "untrained.zip": "a PPO zip of SB3 (64 x 64, by torch)"}


GOALS = "goals"
FIRST = "intersection-straight"

Measured = Mapping[str, list[dict[str, Any]]]


def goals(measured: Measured) -> list[dict[str, Any]]:
    """What was to be reached in the first scenario, and what was."""
    rows = {(row["ads"], row["batch"]): row for row in measured["execution"] if row["env"] == FIRST}
    policy, constant = f"learned:{FIRST}", rows["constant", 256]
    with_predict = rows["highway-env: objects and predict of SB3", 1]["ms per simulated second"]
    speeds = {(row["ads"], row["workers"]): row["executions per second, wall"] for row in measured["workers"]}
    return [
        {"goal": goal, "reached": reached}
        for goal, reached in {
            "constant actions 1000 times objects, batch 256": constant["x objects"],
            "constant actions 2500 times gymnasium, batch 256": constant["x gymnasium"],
            "a trivial Python `predict` 400 times objects, batch 256": rows[CRUISER, 256]["x objects"],
            "a shipped policy 400 times objects, batch 32": rows[policy, 32]["x objects"],
            "the same 400 times objects with `predict` of SB3": with_predict
            / rows[policy, 32]["ms per simulated second"],
            "the rule planner 40 times objects, batch 32": rows["rule", 32]["x objects"],
            "two workers 1.7 times one, the rule planner": speeds["rule", 2] / speeds["rule", 1],
            "two workers 1.7 times one, the policy": speeds[policy, 2] / speeds[policy, 1],
            "for comparison, plain arithmetic": speeds["plain arithmetic", 2] / speeds["plain arithmetic", 1],
        }.items()
    ]


def filled(page: str, measured: Measured) -> str:
    """The page with the tables of the measured parts in their places."""
    return PLACE.sub(lambda found: f"{found[1]} -->\n\n{table(_rows(found[1], measured))}\n\n", page)


def _rows(part: str, measured: Measured) -> list[dict[str, Any]]:
    """The rows of a table, with a dash where nothing was measured."""
    if part == GOALS:
        return goals(measured)
    columns = COLUMNS[part]
    return [
        {heading: NAMES.get(value := row.get(key, "-"), value) for heading, key in columns.items()}
        for row in measured[part]
    ]


if __name__ == "__main__":
    figures = json.loads(FIGURES.read_text())
    for path in PAGES:
        path.write_text(filled(path.read_text(), figures))
