"""Measure speed and print tables: `python -m benchmarks [execution] [workers] [analysis] [startup] [stages] ...`.

All parts, and plain highway-env, are measured in one run on one machine. Compare the ratios, not the milliseconds,
because machines differ and may be busy. Times are CPU times of one process, unless they are labeled as wall times.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from behavexplor import FUNCTIONAL_SCENARIOS
from benchmarks.analysis import analysis_rows
from benchmarks.execution import Pace, counting_rows, lock_step_rows, main_systems, stock_rows, worker_rows
from benchmarks.highway import highway_rows
from benchmarks.scale import scale_rows
from benchmarks.stages import stage_rows
from benchmarks.startup import startup_rows

Row = dict[str, Any]

FIRST = "intersection-straight"


def execution(count: int) -> list[Row]:
    """Speed of the drivers in comparison with plain highway-env."""
    pace = Pace(FIRST)
    with tempfile.TemporaryDirectory() as folder:
        stock = stock_rows(FIRST, max(count // 64, 4), pace)
        rows = stock + lock_step_rows(FIRST, main_systems(FIRST, Path(folder)), count, pace)
        for env in FUNCTIONAL_SCENARIOS:
            if env != FIRST:
                rows += lock_step_rows(env, [f"learned:{env}", "rule"], count, pace, batches=(32,))
    for row in rows:
        for name, reference in (("objects", stock[0]), ("gymnasium", stock[2])):
            row[f"x {name}"] = _cost(reference) / _cost(row)
    return rows


def _cost(row: Row) -> float:
    """Return the CPU time of a simulated second, in terms of the machine's pace at that time."""
    return float(row["ms per simulated second"] / row["pace"])


def workers(count: int) -> list[Row]:
    """Wall time with one and two worker processes, and of plain arithmetic."""
    policy = worker_rows(FIRST, f"learned:{FIRST}", 4 * count, (1, 2))
    return arithmetic_rows() + worker_rows(FIRST, "rule", count, (1, 2)) + policy


def arithmetic_rows() -> list[Row]:
    """Return rows on how much a loop of plain arithmetic gains from a second process."""
    from concurrent.futures import ProcessPoolExecutor  # noqa: PLC0415 - only here

    rows = []
    for number in (1, 2):
        with ProcessPoolExecutor(number) as pool:
            list(pool.map(_add_up, [1000] * number))
            start = time.perf_counter()
            list(pool.map(_add_up, [3_000_000] * 8))
            wall = time.perf_counter() - start
        rows.append({"env": "", "ads": "plain arithmetic", "workers": number, "executions per second, wall": 8 / wall})
    return rows


def _add_up(count: int) -> int:
    return sum(i * i % 7 for i in range(count))


def analysis(count: int) -> list[Row]:
    """Cost of everything but execution as a campaign grows."""
    sizes = tuple(size for size in (100, 1000, 2000, 5000, 10_000) if size <= 20 * count)
    return analysis_rows(FIRST, "behavexplor", sizes)


def startup(count: int) -> list[Row]:
    """Waiting times of a user."""
    return startup_rows(750 if count >= 256 else 50)


def stages(count: int) -> list[Row]:
    """Where the time of campaigns goes [s]."""
    return stage_rows(750 if count >= 256 else 50)


def highway(count: int) -> list[Row]:
    """highway-env's own environments: CPU time of a decision, resets included."""
    return highway_rows(count / 256)


def scale(count: int) -> list[Row]:
    """What limits a campaign with many workers: CPU time of its own process [ms per execution], executions a second."""
    return scale_rows(200 + 4 * count)


def counting(count: int) -> list[Row]:
    """Evaluation: episodes per CPU second, judged by their traces and counted."""
    return counting_rows(count)


PARTS: dict[str, Callable[[int], list[Row]]] = {
    "execution": execution,
    "workers": workers,
    "analysis": analysis,
    "startup": startup,
    "stages": stages,
    "highway": highway,
    "scale": scale,
    "counting": counting,
}


def main() -> None:
    """Measure, print the tables, and write the rows to a file if requested."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("parts", nargs="*", choices=[[], *PARTS], help="parts to measure (default: all)")
    parser.add_argument("--scenarios", type=int, default=512, help="number of scenarios for each row")
    parser.add_argument("--json", type=Path, help="file to write the rows to")
    arguments = parser.parse_args()
    measured = {}
    for part in arguments.parts or PARTS:
        measured[part] = PARTS[part](arguments.scenarios)
        print(f"\n{PARTS[part].__doc__}\n{table(measured[part])}", flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps(measured, indent=1) + "\n")


def table(rows: list[Row]) -> str:
    """Return rows as a Markdown table."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    lines = [names, ["---"] * len(names), *([_shown(row.get(name, "")) for name in names] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _shown(value: Any) -> str:
    if not isinstance(value, float):
        return str(value)
    return f"{value:.3g}" if value < 999.5 else f"{value:.0f}"


if __name__ == "__main__":
    main()
