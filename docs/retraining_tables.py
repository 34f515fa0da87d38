"""Puts the measured retrainings into the tables of docs/pool.md: python docs/retraining_tables.py.

The lines in docs/data/retraining.jsonl are those that docs/retraining.py makes. A table stands between the lines
`<!-- retraining: NAME -->` and `<!-- end -->`, where NAME is one of `TABLES`.
"""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import mean
from typing import Any

from behavexplor.bench.statistics import a12, mann_whitney
from benchmarks.__main__ import table

DOCS = Path(__file__).parent
LINES = DOCS / "data" / "retraining.jsonl"
PAGE = DOCS / "pool.md"
PLACE = re.compile(r"(?<=<!-- retraining: )([\w-]+) -->\n.*?(?=<!-- end -->)", re.DOTALL)
FRESH = 2000  # number of uniformly drawn scenarios in which each policy is measured
GIVEN = "given"  # stands for the policy before it is trained further
POOLS = ("none", "own", "both")
RATE, LAST = "failures at fault [%]", "after the last round [%]"

Line = Mapping[str, Any]  # see `Line` in docs/retraining.py
Row = dict[str, Any]


def figures(line: Line, old: set[int]) -> dict[str, float]:
    """Return the figures of a line. `old` holds the failures of the policy as it was given."""
    return {
        RATE: 100 * len(line["failures"]) / FRESH,
        LAST: 100 * len(line["last"]) / FRESH,
        "fixed": len(old - set(line["failures"])),
        "broken": len(set(line["failures"]) - old),
        "found": line["found"],
        "classes": line["classes"],
        "held-out failures left": line["held_out"],
    }


def groups(lines: Sequence[Line]) -> dict[tuple[str, str], dict[str, list[float]]]:
    """Return the figures by name, of all retrainings of each policy with each pool."""
    before = {line["subject"]: set(line["failures"]) for line in lines if line["pool"] == GIVEN}
    found = {
        (name, pool): [figures(line, old) for line in lines if (line["subject"], line["pool"]) == (name, pool)]
        for name, old in before.items()
        for pool in (GIVEN, *POOLS)
    }
    return {key: {name: [one[name] for one in group] for name in group[0]} for key, group in found.items() if group}


def rates(lines: Sequence[Line]) -> list[Row]:
    """Rates of failures in the fresh scenarios: means over the seeds, with the least and the greatest value."""
    return _spreads(lines, (RATE, LAST, "fixed", "broken"))


def searches(lines: Sequence[Line]) -> list[Row]:
    """What campaigns find in the policies: means over the seeds, with the least and the greatest value."""
    return _spreads(lines, ("found", "classes", "held-out failures left"))


def contrasts(lines: Sequence[Line]) -> list[Row]:
    """Comparisons of two pools: the ratio of the mean rates, and A12 and p of each figure."""
    by_pool, rows = groups(lines), []
    for name in dict.fromkeys(name for name, _ in by_pool):
        for first, second in (("own", "none"), ("both", "none"), ("both", "own")):
            one, other = by_pool[name, first], by_pool[name, second]
            row = {"policy": name, "pools": f"{first}, {second}", "ratio": f"{mean(one[RATE]) / mean(other[RATE]):.2f}"}
            names = (RATE, LAST, "broken", "found", "classes")
            rows.append(row | {key.removesuffix(" [%]"): _effect(one[key], other[key]) for key in names})
    return rows


TABLES: Mapping[str, Callable[[Sequence[Line]], list[Row]]] = {
    "rates": rates,
    "searches": searches,
    "contrasts": contrasts,
}


def filled(page: str, lines: Sequence[Line]) -> str:
    """The page with the tables in their places."""
    return PLACE.sub(lambda found: f"{found[1]} -->\n\n{table(TABLES[found[1]](lines))}\n\n", page)


def _spreads(lines: Sequence[Line], names: Sequence[str]) -> list[Row]:
    return [
        {"policy": name, "pool": pool} | {key: _spread(group[key]) for key in names}
        for (name, pool), group in groups(lines).items()
    ]


def _spread(values: Sequence[float]) -> str:
    low, high = min(values), max(values)
    return f"{mean(values):.3g}" if low == high else f"{mean(values):.3g} ({low:.3g} to {high:.3g})"


def _effect(first: Sequence[float], second: Sequence[float]) -> str:
    return f"{a12(first, second):.2f}, p {mann_whitney(first, second):.2g}"


if __name__ == "__main__":
    measured = [json.loads(line) for line in LINES.read_text().splitlines()]
    PAGE.write_text(filled(PAGE.read_text(), measured))
