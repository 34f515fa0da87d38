"""Paired statistics of two drivers: what each of them did in the same scenarios."""

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, Self

import scipy

from behavexplor.bench.statistics import holm
from behavexplor.campaign.record import Record
from behavexplor.errors import InputError
from behavexplor.judge.rates import NON_INFERIOR, PairedSequence
from behavexplor.judge.specs import SPECS

CONFIDENCE: Final = 0.95
CHANGE: Final = "change (95 %)"
COLUMNS: Final = ("", "A", "B", "fixed", "broken", "both", CHANGE, "p")
LEGEND: Final = "fixed: only A; broken: only B; p: McNemar's exact test, adjusted by Holm's method"
FAILED, AT_FAULT = "any failure", "failure at fault"
NO_VIOLATION = "no violation"
Row = tuple[int, tuple[str, str]]  # number of a scenario, and what happened with each driver, in words


@dataclass(frozen=True)
class Pairs:
    """How often two drivers showed one outcome in the same scenarios."""

    outcome: str  # name of the outcome
    # numbers of the scenarios in which only the first driver showed it: what the second one fixed
    only_first: tuple[int, ...]
    only_second: tuple[int, ...]  # numbers of the scenarios in which only the second driver showed it: what it broke
    both: int  # number of scenarios in which both showed it
    neither: int  # number of scenarios in which neither showed it

    @property
    def n(self) -> int:
        """Number of scenarios."""
        return len(self.only_first) + len(self.only_second) + self.both + self.neither

    @property
    def rates(self) -> tuple[float, float]:
        """Shares of the scenarios in which the first and the second driver showed the outcome."""
        return (len(self.only_first) + self.both) / self.n, (len(self.only_second) + self.both) / self.n

    @property
    def p(self) -> float:
        """P-value of McNemar's exact test: whether both drivers show the outcome equally often."""
        fixed, broken = len(self.only_first), len(self.only_second)
        return float(scipy.stats.binomtest(fixed, fixed + broken, 0.5).pvalue) if fixed + broken else 1.0

    @property
    def difference(self) -> tuple[float, float, float]:
        """Rate of the second driver minus that of the first, and its interval at `CONFIDENCE`.

        The interval is Wald's after half a scenario has been added to each of the four cells (Agresti and Min, "Simple
        improved confidence intervals for comparing matched proportions", Statistics in Medicine 2005).
        """
        n, fixed, broken = self.n + 2, len(self.only_first) + 0.5, len(self.only_second) + 0.5
        middle = (broken - fixed) / n
        deviation = math.sqrt(max(fixed + broken - (broken - fixed) ** 2 / n, 0.0)) / n
        half = float(scipy.stats.norm.ppf(0.5 + CONFIDENCE / 2)) * deviation
        first, second = self.rates
        return second - first, max(middle - half, -1.0), min(middle + half, 1.0)


class MarginDecision(NamedTuple):
    """The verdict on the second driver: non-inferior to the first one by a margin, inferior, or undecided."""

    margin: float
    found: str  # `NON_INFERIOR`, `INFERIOR`, or "" if it is not decided
    after: int  # number of scenarios after which it was decided, or of all

    @classmethod
    def of(cls, pairs: Sequence[Pairs], margin: float) -> Self:
        """Decide about the failures at fault."""
        row = next(row for row in pairs if row.outcome == AT_FAULT)
        fixed, broken = set(row.only_first), set(row.only_second)
        sequence = PairedSequence(margin)
        for number in range(row.n):  # a scenario in which both fail counts as one in which neither does
            if sequence.add(old_failed=number in fixed, new_failed=number in broken):
                break
        return cls(margin, sequence.verdict, sequence.n)

    @property
    def words(self) -> str:
        """The verdict as a sentence."""
        margin = f"{100 * self.margin:g} % of the scenarios"
        if not self.found:
            return f"Not decided in {self.after} scenarios whether B is worse than A in {margin}: give more --scenarios"
        name, bound = ("Non-inferior", "less") if self.found == NON_INFERIOR else ("Inferior", "more")
        head = f"{name}: B is worse than A in {bound} than {margin}"
        return f"{head} (failures at fault; decided after {self.after} scenarios; 95 %, valid at any time)"


def paired(first: Iterable[Record], second: Iterable[Record], asked: Collection[str]) -> list[Pairs]:
    """Compare two drivers' records one by one: any failure, failures at fault, and violations of each spec.

    Of the built-in specs, `asked` names those that mean something in the environment.

    Raises:
        InputError: if the scenarios are not the same.
    """
    records = list(zip(first, second, strict=True))
    for one, other in records:
        if one.load_scenario().scene != other.load_scenario().scene:  # what is the same for every driver
            raise InputError(f"Execution {one.id} is another scenario in the other run, so they cannot be compared")
    ours = [spec.name for spec in SPECS]
    judged = dict.fromkeys(name for pair in records for one in pair for name in (*one.degrees, *one.violated))
    names = [*(name for name in ours if name in asked), *(name for name in judged if name not in ours)]
    outcomes: dict[str, Callable[[Record], bool]] = {
        FAILED: lambda record: record.failed,
        AT_FAULT: lambda record: record.at_fault,
    }
    outcomes |= {name: _violation_of(name) for name in names}
    return [_pairs(outcome, records, shown) for outcome, shown in outcomes.items()]


def rows(pairs: Sequence[Pairs]) -> list[tuple[str, ...]]:
    """Return the rows of a table with the columns `COLUMNS`. The p-values are adjusted by Holm's method."""
    made = []
    for one, p in zip(pairs, holm([one.p for one in pairs]), strict=True):
        rates = [f"{rate:.1%}" for rate in one.rates]
        counts = map(str, (len(one.only_first), len(one.only_second), one.both))
        change, low, high = (f"{value:+.1%}" for value in one.difference)
        made.append((one.outcome, *rates, *counts, f"{change} ({low} to {high})", f"{p:.2g}"))
    return made


def _pairs(outcome: str, records: Sequence[tuple[Record, Record]], shown: Callable[[Record], bool]) -> Pairs:
    found = [(one.id, shown(one), shown(other)) for one, other in records]
    return Pairs(
        outcome,
        only_first=tuple(number for number, a, b in found if a and not b),
        only_second=tuple(number for number, a, b in found if b and not a),
        both=sum(a and b for _, a, b in found),
        neither=sum(not a and not b for _, a, b in found),
    )


def _violation_of(name: str) -> Callable[[Record], bool]:
    return lambda record: name in record.violated


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


def side_by_side(pairs: Sequence[Pairs], words: Sequence[Mapping[int, str]], limit: int) -> SideBySide:
    """Return what two drivers did in the same scenarios.

    Args:
        pairs: the outcomes.
        words: what happened in the failures of each driver, by their numbers.
        limit: greatest number of scenarios that are shown.
    """
    row = next(one for one in pairs if one.outcome == AT_FAULT)

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
