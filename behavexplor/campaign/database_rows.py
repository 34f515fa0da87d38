"""The rows in the SQLite database of a run folder, and how a damaged database is read and rebuilt.

Every row has two checksums, so that a record can be checked without its trace.
"""

import os
import sqlite3
import zlib
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import Any

from behavexplor.campaign.database_file import AUXILIARY, UNREADABLE, connect, wal_of
from behavexplor.campaign.folder_format import DATABASE_FORMAT, SCHEMA

_LEAST_ROW = 64  # least size of a row [bytes]
_ROWS_AT_ONCE = 500
_DAMAGED = (*UNREADABLE, sqlite3.SQLITE_ERROR)  # codes of a damaged file; the last is that of invalid JSON

_BEGINNING = f"BEGIN IMMEDIATE; {SCHEMA} INSERT INTO meta VALUES ('format', '{DATABASE_FORMAT}'); COMMIT;"  # noqa: S608
_WHOLE = "SELECT id, record, trace, elapsed, checksum, record_checksum FROM executions"
_BRIEF = "SELECT id, record, NULL, elapsed, checksum, record_checksum FROM executions"
_INSERT = (
    "INSERT OR REPLACE INTO executions (id, record, trace, elapsed, checksum, record_checksum) "
    "VALUES (?, ?, ?, ?, ?, ?)"
)


@dataclass(frozen=True)
class Row:
    """A row of the database: one stored execution."""

    id: int  # number of the execution
    record: bytes  # record as JSON
    trace: bytes  # trace as bytes; empty if it was not read
    elapsed: float  # running time of the campaign up to the execution [s]


class DamagedError(Exception):
    """A row cannot be read, or differs from what was written."""


def begin(connection: sqlite3.Connection) -> None:
    """Create the tables in one transaction."""
    connection.executescript(_BEGINNING)


def is_empty(connection: sqlite3.Connection) -> bool:
    """Return whether a database has no tables, because its creation was interrupted.

    Raises:
        sqlite3.Error: if the database cannot be read.
    """
    return bool(connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()[0] == 0)


def read_format(connection: sqlite3.Connection) -> str:
    """Return the format that a database declares; "none" if it declares none.

    Raises:
        sqlite3.Error: if the database cannot be read.
    """
    kinds = "SELECT count(*) FROM sqlite_schema WHERE type = 'table' AND name IN ('meta', 'executions')"
    if connection.execute(kinds).fetchone()[0] != 2:
        return "none"
    row = connection.execute("SELECT value FROM meta WHERE key = 'format'").fetchone()
    return row[0].decode(errors="replace") if row and isinstance(row[0], bytes) else "none"


def written_format(path: Path) -> str | None:
    """Return the format that a file declares, without changing the file; None if it declares none or is unreadable."""
    try:
        with closing(connect(path, "ro")) as connection:
            found = read_format(connection)
    except sqlite3.Error:
        return None
    return None if found == "none" else found


def insert(connection: sqlite3.Connection, rows: list[Row], notes: Mapping[str, str] = MappingProxyType({})) -> None:
    """Write rows, and notes as texts by name, in one transaction. Those of the same number or name are replaced."""
    with connection:
        connection.executemany("INSERT OR REPLACE INTO meta VALUES (?, ?)", notes.items())
        connection.executemany(
            _INSERT,
            [
                (row.id, row.record.decode(), row.trace, row.elapsed, _checksum(row), _record_checksum(row))
                for row in rows
            ],
        )


def read_note(connection: sqlite3.Connection, name: str) -> bytes:
    """Return a note that `insert` wrote; nothing if there is none or it cannot be read."""
    try:
        row = connection.execute("SELECT value FROM meta WHERE key = ?", (name,)).fetchone()
    except sqlite3.DatabaseError:
        return b""
    return row[0] if row and isinstance(row[0], bytes) else b""


class ExecutionTable:
    """The executions in a database."""

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self._path = path
        self._connection = connection

    def row(self, number: int) -> Row | None:
        """Return a row with its trace; None if there is no such row.

        Raises:
            DamagedError: if the row is damaged.
        """
        try:
            found = self._connection.execute(f"{_WHOLE} WHERE id = ?", (number,)).fetchone()
        except sqlite3.DatabaseError as error:
            raise DamagedError(str(error)) from None
        return None if found is None else _checked(found)

    def rows(self, *, traces: bool) -> Iterator[tuple[int, Row | None]]:
        """Yield all numbers in order, each with its row, or with None for a damaged or missing row.

        If the number of rows is unknown, the last number is that of the first row that is lost at the end. Without
        `traces`, the traces of the rows are empty.
        """
        lost: list[int] = []
        for number, found in self._found(_WHOLE if traces else _BRIEF):
            row = self._row(found)
            if row is None:
                lost.append(number)
                continue
            yield from ((earlier, None) for earlier in lost)
            lost.clear()
            yield number, row
        last = self.last
        yield from ((number, None) for number in lost if number == lost[0] or (last is not None and number <= last))

    @property
    def last(self) -> int | None:
        """Greatest number of a row; -1 without any row, None if it is unknown because of damage."""
        try:
            return int(self._connection.execute("SELECT coalesce(max(id), -1) FROM executions").fetchone()[0])
        except sqlite3.DatabaseError:
            return None

    def _row(self, found: tuple[Any, ...] | None) -> Row | None:
        try:
            return None if found is None else _checked(found)
        except DamagedError:
            return None

    def _found(self, query: str) -> Iterator[tuple[int, tuple[Any, ...] | None]]:
        """Yield each number from 0 with its unchecked row, or with None if the row is missing or unreadable."""
        number = 0
        try:
            for found in self._connection.execute(f"{query} WHERE id >= 0 ORDER BY id"):
                if found[0] < number:  # pages are out of order
                    break
                yield from ((missing, None) for missing in range(number, min(found[0], number + self._most)))
                yield found[0], found
                number = found[0] + 1
            else:
                return
        except sqlite3.DatabaseError:  # a page is damaged
            pass
        yield from self._one_by_one(query, number)  # this finds rows in undamaged pages

    def _one_by_one(self, query: str, first: int) -> Iterator[tuple[int, tuple[Any, ...] | None]]:
        last = self.last
        for number in range(first, self._most if last is None else min(last + 1, first + self._most)):
            try:
                yield number, self._connection.execute(f"{query} WHERE id = ?", (number,)).fetchone()
            except sqlite3.DatabaseError:
                yield number, None

    @property
    def _most(self) -> int:
        """Greatest number of rows that files of this size can hold."""
        files = (self._path, wal_of(self._path))
        return sum(file.stat().st_size for file in files if file.exists()) // _LEAST_ROW


def is_whole(path: Path) -> bool:
    """Return whether the structure of a database is intact. The contents of its rows have checksums of their own.

    Raises:
        sqlite3.Error: if the check fails for a reason other than damage.
    """
    try:
        with closing(connect(path, "rw")) as connection:
            return bool(connection.execute("PRAGMA quick_check(1)").fetchone()[0] == b"ok")
    except sqlite3.DatabaseError as error:
        if error.sqlite_errorcode & 0xFF in _DAMAGED:
            return False
        raise


def rebuild(path: Path) -> tuple[int, Path]:
    """Copy the readable rows of a damaged database into a new one, and keep the damaged file under another name.

    Return the number of rows that could be read, and the new path of the damaged file.

    Raises:
        OSError: if the folder cannot be written.
        sqlite3.Error: if the new database cannot be written.
    """
    new, kept = path.with_name(path.name + ".part"), _free_name(path)
    for leftover in (new, *(new.with_name(new.name + ending) for ending in AUXILIARY)):
        leftover.unlink(missing_ok=True)
    with closing(connect(new, "rwc")) as connection:
        begin(connection)
        saved, rows = 0, _readable(path)
        while some := list(islice(rows, _ROWS_AT_ONCE)):
            insert(connection, some)
            saved += len(some)
        connection.execute("PRAGMA journal_mode = DELETE")
    os.link(path, kept)
    if wal_of(path).exists():
        wal_of(path).replace(wal_of(kept))
    path.with_name(path.name + "-shm").unlink(missing_ok=True)
    new.replace(path)
    return saved, kept


def _readable(path: Path) -> Iterator[Row]:
    """Yield the undamaged rows of a database."""
    try:
        connection = connect(path, "ro")
    except sqlite3.DatabaseError:
        return
    with closing(connection):
        yield from (row for _, row in ExecutionTable(path, connection).rows(traces=True) if row is not None)


def _free_name(path: Path) -> Path:
    """Return an unused path for a damaged file, beside damaged files of earlier times."""
    name, number = path.with_name(f"{path.name}.damaged"), 1
    while os.path.lexists(name) or os.path.lexists(wal_of(name)):
        number += 1
        name = path.with_name(f"{path.name}.damaged{number}")
    return name


def _checked(found: tuple[Any, ...]) -> Row:
    """Return a row after checking its checksums; raise `DamagedError` if one is wrong."""
    number, record, trace, elapsed, checksum, record_checksum = found
    if not isinstance(record, bytes) or not isinstance(trace, bytes | None) or not isinstance(elapsed, float):
        raise DamagedError("a value is of a wrong type")
    row = Row(number, record, trace or b"", elapsed)
    whole = trace is None or _checksum(row) == checksum
    if not whole or record_checksum != _record_checksum(row):
        raise DamagedError("its checksum is wrong")
    return row


def _checksum(row: Row) -> int:
    return zlib.crc32(row.trace, zlib.crc32(b"%d\n%b" % (row.id, row.record)))


def _record_checksum(row: Row) -> int:
    return zlib.crc32(b"%d\n%b\n%b" % (row.id, repr(row.elapsed).encode(), row.record))
