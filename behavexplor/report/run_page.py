"""The report on one or several runs, as one self-contained HTML file."""

from collections.abc import Callable, Mapping, Sequence
from typing import Final

from behavexplor.errors import InputError
from behavexplor.judge.specs import SPECS
from behavexplor.report.gallery import PASSED
from behavexplor.report.reading import ReportedRun
from behavexplor.report.rendering import rendered
from behavexplor.report.sections import curves, section

MOST_REPLAYS: Final = 2000  # of each run
Paired = tuple[Sequence[str], Sequence[Sequence[str]]]

_NOT_EXAMINED: Final = "not examined"


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
    "failures at fault": lambda run: str(len(run.at_fault())),
    "classes of failures at fault": lambda run: str(len({finding.class_id for finding in run.at_fault()})),
    "collisions at fault": lambda run: str(run.faults()[0]) if run.examined else _NOT_EXAMINED,
    "did not reproduce": lambda run: str(run.flaky()) if run.examined else _NOT_EXAMINED,
    "new behavior": lambda run: f"{run.novel / len(run.entries):.1%}",
}


def page(runs: Sequence[ReportedRun], replays: int, paired: Paired = ((), ())) -> str:
    """Return the report on runs as a page in ASCII. Equal run folders give equal pages.

    Args:
        runs: runs, at least one.
        replays: greatest number of replays of each run.
        paired: headings and rows of a table on the same scenarios in both runs, see `behavexplor.repair.pairs`.

    Raises:
        InputError: if a run is damaged, or the number of replays is out of range.
    """
    if not 0 <= replays <= MOST_REPLAYS:
        raise InputError(f"The number of replays must lie between 0 and {MOST_REPLAYS}, not be {replays}")
    sections = [section(number, run, replays) for number, run in enumerate(runs, 1)]
    several = len(runs) > 1
    return rendered(
        "page.html.jinja",
        ("theme.js", "page.js"),
        sections=sections,
        comparison=comparison(runs) if several else (),
        overlaid=curves(runs) if several else (),
        class_rows=class_rows(runs) if several else (),
        paired=paired,
        values={"runs": [part.values for part in sections]},
        PASSED=PASSED,
    )


def comparison(runs: Sequence[ReportedRun]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Return the rows of the comparison: the name of a figure, then its value for each run."""
    return tuple((name, tuple(figure(run) for run in runs)) for name, figure in _FIGURES.items())


def class_rows(runs: Sequence[ReportedRun]) -> tuple[tuple[str, tuple[int, ...]], ...]:
    """Return the count of each class in each run, the classes found in most runs first."""
    counts = [{name: len(findings) for name, findings in run.classes.items()} for run in runs]
    names = {name for count in counts for name in count}
    rows = [(name, tuple(count.get(name, 0) for count in counts)) for name in names]
    return tuple(sorted(rows, key=lambda row: (-sum(n > 0 for n in row[1]), -sum(row[1]), row[0])))
