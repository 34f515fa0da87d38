"""A campaign's run folder: one SQLite file with every execution, the configuration, and the failures to replay.

What `commit` has returned from is on disk, against a power cut too. The file can be read while a campaign
writes it, by any SQLite reader: `pandas.read_sql("SELECT * FROM executions", sqlite3.connect(path))`.
"""

import json
import os
import sqlite3
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Self

from behavexplor.config import CONFIG
from behavexplor.errors import InputError
from behavexplor.scenario import Scenario
from behavexplor.trace import Trace

try:
    import fcntl
except ImportError:  # Windows has no such locks
    fcntl = None  # type: ignore[assignment]

FORMAT = 1
DATABASE, FAILURES, LOCK = "campaign.db", "failures", "campaign.lock"
_COLUMNS = "id, record, trace, elapsed, checksum"

_SCHEMA = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT;
CREATE TABLE executions (
    id INTEGER PRIMARY KEY,
    record TEXT NOT NULL,  -- JSON: what `behavexplor records` prints
    trace BLOB NOT NULL,  -- npz: behavexplor.trace.Trace
    elapsed REAL NOT NULL,  -- running time of the campaign when the execution was told [s]
    checksum INTEGER NOT NULL,  -- CRC-32 of id, record and trace
    violated TEXT AS (json_extract(record, '$.violated')),
    degree REAL AS (json_extract(record, '$.degree')),
    novelty REAL AS (json_extract(record, '$.novelty')),
    "end" TEXT AS (json_extract(record, '$.end'))
) STRICT;
"""


@dataclass(frozen=True)
class Execution:
    """One stored execution.

    Attributes:
        record: its figures as JSON values; `id` counts from 0 in the order in which they were asked for.
        trace: as bytes, see `behavexplor.trace.Trace.from_bytes`.
        elapsed: running time of the campaign up to it [s].
    """

    record: dict[str, Any]
    trace: bytes
    elapsed: float

    @property
    def id(self) -> int:
        """Its number."""
        return int(self.record["id"])

    @property
    def scenario(self) -> Scenario:
        """What was executed."""
        return Scenario.from_dict(self.record["scenario"])

    def load_trace(self) -> Trace:
        """What happened."""
        return Trace.from_bytes(self.trace)


class Store:
    """The executions of one run folder.

    Use `create`, `reopen` or `read`. Rows that were added count only once they are committed.
    """

    def __init__(self, folder: Path, connection: sqlite3.Connection, lock: IO[str] | None = None) -> None:
        self.folder = folder
        self._connection = connection
        self._lock = lock  # of the one who writes
        self._pending: list[Execution] = []

    @classmethod
    def create(cls, folder: Path, config: str) -> Self:
        """Begin a run in an empty or new folder.

        Args:
            folder: is made if it does not exist.
            config: the campaign's configuration as YAML.

        Raises:
            InputError: if the folder cannot be written, or holds something already.
        """
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if any(folder.iterdir()):
                raise InputError(
                    f"{folder} is not empty: resume the run in it (--resume {folder}) or choose another --out"
                )
            write_durably(folder / CONFIG, config)
            (folder / FAILURES).mkdir()
            store = cls(folder, _connect(folder, "rwc"), _lock(folder))
        except OSError as error:
            raise InputError(f"The run folder {folder} cannot be written: {error.strerror}") from None
        store._connection.executescript(_SCHEMA)
        store._connection.execute("INSERT INTO meta VALUES ('format', ?)", (str(FORMAT),))
        store._connection.commit()
        return store

    @classmethod
    def reopen(cls, folder: Path) -> Self:
        """Go on with a run.

        Raises:
            InputError: if the folder holds no run that this version can go on with.
        """
        if not (folder / DATABASE).is_file():
            raise InputError(f"{folder} is not a run folder: it has no {DATABASE}")
        try:
            lock = _lock(folder)
        except OSError as error:
            raise InputError(f"The run folder {folder} cannot be written: {error.strerror}") from None
        return cls._open(folder, "rw", lock)

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Look at a run, also while a campaign writes it.

        Raises:
            InputError: if the folder holds no run that this version can read.
        """
        return cls._open(folder, "ro" if os.access(folder, os.W_OK) else "ro&immutable=1")

    @classmethod
    def _open(cls, folder: Path, mode: str, lock: IO[str] | None = None) -> Self:
        if not (folder / DATABASE).is_file():
            raise InputError(f"{folder} is not a run folder: it has no {DATABASE}")
        try:
            connection = _connect(folder, mode)
            row = connection.execute("SELECT value FROM meta WHERE key = 'format'").fetchone()
        except sqlite3.Error as error:
            raise InputError(f"{folder / DATABASE} cannot be read: {error}") from None
        if row is None or row[0] != str(FORMAT):
            found = "none" if row is None else row[0]
            raise InputError(f"{folder / DATABASE} has format {found}; this version reads format {FORMAT}")
        return cls(folder, connection, lock)

    def write_config(self, config: str) -> None:
        """Replace the configuration: a resumed campaign may have a larger budget."""
        write_durably(self.folder / CONFIG, config)

    def __len__(self) -> int:
        """How many executions are committed."""
        count: int = self._connection.execute("SELECT count(*) FROM executions").fetchone()[0]
        return count

    def add(self, execution: Execution) -> None:
        """Take an execution in; it counts from the next `commit`."""
        self._pending.append(execution)

    @property
    def pending(self) -> int:
        """How many were added since the last `commit`."""
        return len(self._pending)

    def commit(self) -> list[Execution]:
        """Bring what was added to disk, each failure also as a file of its own.

        Returns:
            What is on disk now and was not before.
        """
        rows = []
        for execution in self._pending:
            record = json.dumps(execution.record, allow_nan=False)
            rows.append(
                (
                    execution.id,
                    record,
                    execution.trace,
                    execution.elapsed,
                    _checksum(execution.id, record, execution.trace),
                )
            )
            if execution.record["violated"]:
                write_durably(self.failure_path(execution.id), json.dumps(execution.record, indent=1) + "\n")
        with self._connection:
            self._connection.executemany(
                "INSERT INTO executions (id, record, trace, elapsed, checksum) VALUES (?, ?, ?, ?, ?)", rows
            )
        committed, self._pending = self._pending, []
        return committed

    def failure_path(self, number: int) -> Path:
        """The file of a failed execution."""
        return self.folder / FAILURES / f"{number:06d}.json"

    def executions(self) -> Iterator[Execution]:
        """All committed executions in order.

        Raises:
            InputError: if one is damaged; those before it have been given.
        """
        try:
            for row in self._connection.execute(f"SELECT {_COLUMNS} FROM executions ORDER BY id"):  # noqa: S608
                yield self._execution(row)
        except sqlite3.DatabaseError as error:
            raise InputError(f"{self.folder / DATABASE} is damaged: {error}") from None

    def execution(self, number: int) -> Execution:
        """One execution.

        Raises:
            InputError: if there is none of that number, or it is damaged.
        """
        query = f"SELECT {_COLUMNS} FROM executions WHERE id = ?"  # noqa: S608 - constants
        row = self._connection.execute(query, (number,)).fetchone() if abs(number) < 2**63 else None
        if row is None:
            raise InputError(f"{self.folder} has no execution {number}: it has {len(self)}, numbered from 0")
        return self._execution(row)

    def _execution(self, row: tuple[int, str, bytes, float, int]) -> Execution:
        number, record, trace, elapsed, checksum = row
        if _checksum(number, record, trace) != checksum:
            raise InputError(f"Execution {number} in {self.folder / DATABASE} is damaged: its checksum is wrong")
        return Execution(json.loads(record), trace, elapsed)

    def close(self) -> None:
        """Release the file; what was written is then a single one, which needs no writing to be read."""
        if self._lock is not None:
            with suppress(sqlite3.Error):  # somebody reads it right now
                self._connection.execute("PRAGMA journal_mode = DELETE")
            self._lock.close()
        self._connection.close()


def _connect(folder: Path, mode: str) -> sqlite3.Connection:
    uri = f"{(folder / DATABASE).resolve().as_uri()}?mode={mode}"
    connection = sqlite3.connect(uri, uri=True, timeout=30)
    if not mode.startswith("ro"):
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = FULL")
    return connection


def _lock(folder: Path) -> IO[str]:
    """Keep other campaigns out of a run folder until the file that is returned is closed.

    Raises:
        InputError: if another campaign is in it.
    """
    file = (folder / LOCK).open("w")
    if fcntl is not None:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            raise InputError(f"{folder} is being written by another campaign: wait for its end, or stop it") from None
    return file


def _checksum(number: int, record: str, trace: bytes) -> int:
    return zlib.crc32(trace, zlib.crc32(f"{number}\n{record}".encode()))


def write_durably(path: Path, text: str) -> None:
    """Write a whole file or none: a crash leaves no half of one."""
    partial = path.with_name(path.name + ".part")
    with partial.open("w") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)
