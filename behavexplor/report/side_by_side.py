"""Two drivers side by side in the scenarios that the second one fixes or breaks."""

from collections.abc import Sequence
from dataclasses import dataclass

from behavexplor.repair.pairs import AT_FAULT, COLUMNS, Pairs, rows
from behavexplor.report.reading import ReportedRun

NO_VIOLATION = "no violation"
Row = tuple[int, tuple[str, str]]  # number of a scenario, and what happened with each driver, in words


@dataclass(frozen=True)
class SideBySide:
    """What the page on two drivers begins with."""

    n: int  # number of scenarios
    counts: tuple[int, int]  # failures at fault of each driver
    fixed: tuple[int, ...]  # numbers of the scenarios in which only the first driver fails by its own fault
    broken: tuple[int, ...]  # numbers of the scenarios in which only the second driver does
    lists: tuple[tuple[str, tuple[int, ...], tuple[Row, ...]], ...]  # title, all numbers, and the rows in the page
    columns: tuple[str, ...]  # heads of the table of all outcomes
    rows: tuple[tuple[str, ...], ...]  # its rows

    @property
    def shown(self) -> tuple[int, ...]:
        """Numbers of the scenarios that are played side by side."""
        return tuple(number for _, _, rows in self.lists for number, _ in rows)


def side_by_side(pairs: Sequence[Pairs], runs: Sequence[ReportedRun], limit: int) -> SideBySide:
    """Return what two drivers did in the same scenarios, at most `limit` of which are shown."""
    row = next(one for one in pairs if one.outcome == AT_FAULT)
    words = [{finding.id: finding.words for finding in run.findings} for run in runs[:2]]

    def shown(numbers: Sequence[int]) -> tuple[Row, ...]:
        first, second = words
        chosen = numbers[: limit // 2]
        return tuple((one, (first.get(one, NO_VIOLATION), second.get(one, NO_VIOLATION))) for one in chosen)

    fixed, broken = row.only_first, row.only_second
    return SideBySide(
        n=row.n,
        counts=(len(fixed) + row.both, len(broken) + row.both),
        fixed=fixed,
        broken=broken,
        lists=(("Fixed", fixed, shown(fixed)), ("Broken", broken, shown(broken))),
        columns=COLUMNS,
        rows=tuple(rows(pairs)),
    )
