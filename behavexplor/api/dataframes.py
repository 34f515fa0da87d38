"""Records as a pandas DataFrame with plain columns, one row for each execution."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from behavexplor.campaign.record import Record
from behavexplor.errors import missing_library
from behavexplor.judge.classes import words_of

if TYPE_CHECKING:
    import pandas as pd


def frame_of(records: Iterable[Record]) -> "pd.DataFrame":
    """Return records as a DataFrame.

    The index is the number of the execution. The columns are the fields of a `behavexplor.campaign.record.Record`, with
    these differences: `spec` is the most severe violated spec, `words` is the class as a sentence, `degree_<spec>` and
    `search_<figure>` have a column each, and so do `error_kind` and `error_message`. The scenario is left out:
    `behavexplor.Run.scenario` returns it.

    Raises:
        InputError: if pandas is not installed.
    """
    try:
        import pandas as pd  # noqa: PLC0415 - optional
    except ModuleNotFoundError as error:
        raise missing_library("A DataFrame", error.name, "pandas") from None
    rows = [_row(record) for record in records]
    columns = list(dict.fromkeys(name for row in rows for name in row)) or list(_row(_EMPTY))
    return pd.DataFrame(rows, columns=columns).set_index("id")


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
