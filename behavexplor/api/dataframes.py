"""Records and paired statistics as pandas DataFrames with plain columns."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from behavexplor.bench.statistics import holm
from behavexplor.campaign.record import Record
from behavexplor.errors import missing_library
from behavexplor.judge.classes import words_of
from behavexplor.repair.pairs import Pairs

if TYPE_CHECKING:
    import pandas as pd


def frame_of(records: Iterable[Record]) -> "pd.DataFrame":
    """Return records as a DataFrame.

    The index is the number of the execution. The columns are the fields of a `behavexplor.campaign.record.Record`, with
    these differences: `failed` and `at_fault` are added, `spec` is the most severe violated spec, `class` stands for
    `violation_class`, `words` is the class as a sentence, `degree_<spec>` and `search_<figure>` have a column each, and
    so do `error_kind` and `error_message`. The scenario is left out: `behavexplor.Run.scenario` returns it.

    Raises:
        InputError: if pandas is not installed.
    """
    rows = [_row(record) for record in records]
    columns = list(dict.fromkeys(name for row in rows for name in row)) or list(_row(_EMPTY))
    return _frame(rows, columns, "id")


def frame_of_pairs(pairs: Sequence[Pairs]) -> "pd.DataFrame":
    """Return paired statistics as a DataFrame.

    The index is the outcome. The columns are `first` and `second`, the rates of the drivers; `fixed`, `broken`, `both`
    and `neither`, the numbers of scenarios in which only the first driver, only the second one, both or neither showed
    the outcome; `change` with its interval `low` and `high`, the second rate minus the first one; and `p`, the p-value
    of McNemar's exact test, adjusted by Holm's method.

    Raises:
        InputError: if pandas is not installed.
    """
    adjusted = holm([one.p for one in pairs])
    rows = [_pairs_row(one, p) for one, p in zip(pairs, adjusted, strict=True)]
    return _frame(rows, list(rows[0]), "outcome")


def _frame(rows: Sequence[Mapping[str, Any]], columns: Sequence[str], index: str) -> "pd.DataFrame":
    """Return rows as a DataFrame."""
    try:
        import pandas as pd  # noqa: PLC0415 - optional
    except ModuleNotFoundError as error:
        raise missing_library("A DataFrame", error.name, "pandas") from None
    return pd.DataFrame(rows, columns=columns).set_index(index)


def _pairs_row(one: Pairs, p: float) -> dict[str, Any]:
    first, second = one.rates
    change, low, high = one.difference
    return {
        "outcome": one.outcome,
        "first": first,
        "second": second,
        "fixed": len(one.only_first),
        "broken": len(one.only_second),
        "both": one.both,
        "neither": one.neither,
        "change": change,
        "low": low,
        "high": high,
        "p": p,
    }


def _row(record: Record) -> dict[str, Any]:
    error = record.error or {}
    return {
        "id": record.id,
        "failed": record.failed,
        "spec": record.violated[0] if record.violated else None,
        "class": record.violation_class,
        "words": None if record.violation_class is None else words_of(record.violation_class),
        "at_fault": record.at_fault,
        "fault": record.fault,
        "violated": record.violated,
        "end": record.end,
        "duration": record.duration,
        "degree": record.degree,
        **{f"degree_{name}": degree for name, degree in record.degrees.items()},
        "novelty": record.novelty,
        "novel": record.novel,
        "origin": record.origin,
        "parent": record.parent,
        "error_kind": error.get("kind"),
        "error_message": error.get("message"),
        **{f"search_{name}": value for name, value in record.search.items()},
    }


_EMPTY = Record(id=0, end="", violated=(), scenario={})
