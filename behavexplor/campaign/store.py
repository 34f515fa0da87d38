"""The run folder of a campaign: an SQLite file with every execution, the configuration, and a file for each failure.

Committed executions survive a power cut. Any SQLite reader can read the file while a campaign writes it:
`pandas.read_sql("SELECT * FROM executions", sqlite3.connect(path))`. A damaged folder is read as far as possible, and
lost executions are repeated when the campaign is resumed.
"""

import json
import re
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import IO, Any, Final, Self

from behavexplor.campaign import database_rows
from behavexplor.campaign.database_file import connect, lock_folder
from behavexplor.campaign.folder_format import CONFIG, DATABASE, DATABASE_FORMAT, FAILURES, LOCK, Losses, failure_path
from behavexplor.campaign.progress import known_stages
from behavexplor.campaign.record import Record, json_object
from behavexplor.data.durable import check_no_file, make_folder, write_durably, write_whole
from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import Trace
from behavexplor.data.untrusted import parse_json
from behavexplor.errors import InputError

_STAGES: Final = "stages"  # name of the note with the time in each stage
_END: Final = "end"  # name of the note that says why the search ended early
_UNFINISHED = {LOCK, f"{CONFIG}.part"}  # files that a run may leave if it is killed before it has begun


@dataclass(frozen=True)
class Execution:
    """One stored execution."""

    record: Record
    trace: bytes  # trace as bytes, see `behavexplor.data.trace.Trace.from_bytes`
    elapsed: float  # running time of the campaign up to the execution [s]
    # the members of the record as texts, if they have been encoded already; encoding takes a while
    encoded: Sequence[str] | None = field(default=None, compare=False)

    @property
    def id(self) -> int:
        """Number of the execution."""
        return self.record.id

    @property
    def members(self) -> Sequence[str]:
        """The members of the record's JSON object, each as a text `"name": value`."""
        return self.encoded or self.record.members

    @property
    def scenario(self) -> Scenario:
        """The executed scenario."""
        return self.record.load_scenario()

    def load_trace(self) -> Trace:
        """Return the trace."""
        return Trace.from_bytes(self.trace)


class Store:
    """The executions of one run folder.

    Use `create`, `reopen` or `read` to make one. Added executions only count once they are committed.
    """

    def __init__(
        self, folder: Path, connection: sqlite3.Connection, lock: IO[str] | None = None, repaired: str | None = None
    ) -> None:
        self.folder = folder
        # sentence on how a damaged database was repaired when the run was reopened; None without damage
        self.repaired = repaired
        self._connection = connection
        self._table = database_rows.ExecutionTable(folder / DATABASE, connection)
        self._lock = lock  # None for readers
        self._pending: list[Execution] = []

    @classmethod
    def create(cls, folder: Path, config: str) -> Self:
        """Begin a run of this configuration (as YAML) in an empty or new folder.

        Raises:
            InputError: if the folder cannot be written, or is not empty.
        """
        check_free(folder)
        return cls._locked(folder, config)

    @classmethod
    def reopen(cls, folder: Path) -> Self:
        """Reopen a run to resume it, even if it was interrupted before its first execution, or is damaged.

        Raises:
            InputError: if the folder holds no run that this version can resume.
        """
        if not (folder / CONFIG).is_file() and not (folder / DATABASE).is_file():
            raise InputError(f"{folder} is not a run folder: it has neither {CONFIG} nor {DATABASE}")
        return cls._locked(folder, None)

    @classmethod
    def _locked(cls, folder: Path, config: str | None) -> Self:
        """Make a folder if necessary, lock it, and open it for writing."""
        try:
            make_folder(folder)
            lock = lock_folder(folder)
        except OSError as error:
            raise _unwritable(folder, error) from None
        try:
            if config is not None:
                write_durably(folder / CONFIG, config)
            make_folder(folder, FAILURES)
            repaired = _repaired(folder)
            return cls(folder, _prepared(folder), lock, repaired)
        except (OSError, sqlite3.Error) as error:
            lock.close()
            raise _unwritable(folder, error) from None
        except InputError:
            lock.close()
            raise

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Open a run for reading, possibly while a campaign writes it.

        Raises:
            InputError: if the folder holds no run that this version can read.
        """
        path = folder / DATABASE
        if not path.is_file():
            raise InputError(f"{folder} is not a run folder: it has no {DATABASE}")
        try:
            connection = connect(path, "ro")
        except sqlite3.Error as error:
            raise InputError(f"{path} cannot be read: {error}") from None
        try:
            _check_readable(path, connection)
            return cls(folder, connection)
        except sqlite3.Error as error:
            connection.close()
            raise InputError(f"{path} cannot be read: {error}") from None
        except InputError:
            connection.close()
            raise

    def write_config(self, config: str) -> None:
        """Replace the configuration, because a resumed campaign may have a larger budget.

        Raises:
            InputError: if the configuration cannot be written.
        """
        try:
            write_durably(self.folder / CONFIG, config)
        except OSError as error:
            raise _unwritable(self.folder, error) from None

    def __len__(self) -> int:
        """Return the number of committed executions."""
        return int(self._ask("SELECT count(*) FROM executions"))

    @property
    def end(self) -> int:
        """Number of the last committed execution plus 1."""
        return int(self._ask("SELECT coalesce(max(id), -1) FROM executions")) + 1

    @property
    def elapsed(self) -> float:
        """Running time of the campaign up to the last committed execution [s]."""
        return float(self._ask("SELECT coalesce(max(elapsed), 0.0) FROM executions"))

    @property
    def stages(self) -> dict[str, float]:
        """Time of the campaign in each stage [s], see `behavexplor.campaign.progress`; empty if it is not known."""
        try:
            return known_stages(parse_json(self.note(_STAGES).decode(), "the time in each stage"))
        except ValueError:
            return {}

    def note(self, name: str) -> bytes:
        """Return a note that `add_note` wrote; nothing if there is none."""
        return database_rows.read_note(self._connection, name)

    def add_note(self, name: str, text: str) -> None:
        """Write a text to disk under a name."""
        database_rows.insert(self._connection, [], {name: text})

    @property
    def ended(self) -> str | None:
        """Why the search ended before its budget was used up; None if it did not."""
        return self.note(_END).decode(errors="replace") or None

    def note_end(self, reason: str) -> None:
        """Write why the search ended before its budget was used up."""
        self.add_note(_END, reason)

    def _ask(self, query: str) -> Any:
        try:
            return self._connection.execute(query).fetchone()[0]
        except sqlite3.DatabaseError as error:
            mend = "`fuzz --resume` saves what is readable and executes the rest again"
            raise InputError(f"{self.folder / DATABASE} is damaged ({error}): {mend}") from None

    def add(self, execution: Execution) -> None:
        """Add an execution, which counts from the next `commit` on."""
        self._pending.append(execution)

    @property
    def pending(self) -> int:
        """Number of executions that were added since the last `commit`."""
        return len(self._pending)

    @property
    def lost(self) -> Path | None:
        """The run folder or its database, if one was deleted or moved, which SQLite does not notice; else None."""
        return next((path for path in (self.folder, self.folder / DATABASE) if not path.exists()), None)

    def commit(self, stages: Mapping[str, float] = MappingProxyType({})) -> list[Execution]:
        """Write the added executions to disk, each failed one also to a file of its own, and return all of them.

        `stages` has the time in each stage so far [s].

        Raises:
            FileNotFoundError: if the folder or its database is `lost`.
        """
        if self.lost is not None:
            raise FileNotFoundError(f"{self.lost} was deleted or moved")
        rows = []
        for execution in self._pending:
            record = json_object(execution.members).encode()
            rows.append(database_rows.Row(execution.id, record, execution.trace, float(execution.elapsed)))
            if execution.record.failed:
                self._write_failure(execution)
        database_rows.insert(self._connection, rows, {_STAGES: json.dumps(dict(stages))} if stages else {})
        committed, self._pending = self._pending, []
        return committed

    def _write_failure(self, execution: Execution) -> None:
        text = json_object(execution.members, indented=True) + "\n"
        # not durably: `recall` writes a lost file again from the database
        write_whole(failure_path(self.folder, execution.id), text)

    def _has_failure_file(self, number: int) -> bool:
        path = failure_path(self.folder, number)
        return path.is_file() and path.stat().st_size > 0

    def executions(self) -> Iterator[Execution]:
        """Yield all committed executions in order.

        Raises:
            InputError: if an execution is damaged, after all earlier ones were yielded.
        """
        for number, row in self._table.rows(traces=True):
            if row is None:
                raise self._damaged(number)
            yield self._checked(row)

    def records(self, losses: Losses | None = None) -> Iterator[Record]:
        """Yield the records of all committed executions in order, without reading traces.

        Damaged records are skipped and noted in `losses`, if these are given.

        Raises:
            InputError: if a record is damaged and `losses` is None.
        """
        for number, row in self._table.rows(traces=False):
            record = None
            with suppress(database_rows.DamagedError):
                record = None if row is None else _record(row)
            if record is not None:
                if losses is not None and record.failed and not self._has_failure_file(number):
                    losses.files.append(number)
                yield record
            elif losses is None:
                raise self._damaged(number)
            else:
                losses.damaged.append(number)
                losses.cut_off = self._table.last is None

    def execution(self, number: int) -> Execution:
        """Return an execution.

        Raises:
            InputError: if there is no execution of that number, or if it is damaged.
        """
        try:
            row = self._table.row(number) if abs(number) < 2**63 else None
        except database_rows.DamagedError:
            raise self._damaged(number) from None
        if row is None:
            has = f"{len(self)}, numbered from 0" if len(self) else "none"
            raise InputError(f"{self.folder} has no execution {number}: it has {has}")
        return self._checked(row)

    def _checked(self, row: database_rows.Row) -> Execution:
        try:
            return _execution(row)
        except database_rows.DamagedError:
            raise self._damaged(row.id) from None

    def recall(self, number: int) -> Execution | None:
        """Return an execution for a resumed campaign; None if it must be executed again.

        If the file of a failure is missing or empty, it is written again.
        """
        try:
            row = self._table.row(number)
            if row is None:
                return None
            execution = _execution(row)
        except database_rows.DamagedError:
            return None
        if execution.record.failed and not self._has_failure_file(number):
            self._write_failure(execution)
        return execution

    def _damaged(self, number: int) -> InputError:
        return InputError(
            f"Execution {number} in {self.folder / DATABASE} is damaged or missing: fuzz --resume executes it again"
        )

    def close(self) -> None:
        """Close the database. After writing, merge it into a single file that can be read from a read-only folder."""
        if self._lock is not None:
            with suppress(sqlite3.Error):  # another process is reading it
                self._connection.execute("PRAGMA journal_mode = DELETE")
            self._lock.close()
        self._connection.close()


def check_free(folder: Path) -> None:
    """Check that a run can begin in a folder, if it exists.

    Raises:
        InputError: if it is not empty or cannot be read, or if it or a folder above it is a file.
    """
    try:
        check_no_file(folder)
        if folder.exists() and {path.name for path in folder.iterdir()} - _UNFINISHED:
            raise InputError(f"{folder} is not empty: resume the run in it, or choose another folder")
    except OSError as error:
        raise _unwritable(folder, error) from None


def _execution(row: database_rows.Row) -> Execution:
    return Execution(_record(row), row.trace, row.elapsed)


def _record(row: database_rows.Row) -> Record:
    """Return the record in a row.

    Raises:
        DamagedError: if the row holds no valid record, or the record of another execution.
    """
    try:
        record = Record.from_json(row.record)
    except ValueError as error:
        raise database_rows.DamagedError(str(error)) from None
    if record.id != row.id:
        raise database_rows.DamagedError("it is the record of another execution")
    return record


def _repaired(folder: Path) -> str | None:
    """Repair the structure of a damaged database. Return a sentence on the repair; None if none was needed."""
    path = folder / DATABASE
    if not path.is_file():
        return None
    if (found := database_rows.written_format(path)) is not None:
        _check_format(path, found)  # must come before any change
    if database_rows.is_whole(path):
        return None
    count, kept = database_rows.rebuild(path)
    return f"{path} was damaged: {count} executions were saved, the rest run again; the damaged file is now {kept.name}"


def _prepared(folder: Path) -> sqlite3.Connection:
    """Open a database for writing. Create its tables if it has none."""
    path = folder / DATABASE
    connection = connect(path, "rwc")
    try:
        if database_rows.is_empty(connection):
            database_rows.begin(connection)
        _check_format(path, database_rows.read_format(connection))
    except BaseException:
        connection.close()
        raise
    return connection


def _check_readable(path: Path, connection: sqlite3.Connection) -> None:
    if database_rows.is_empty(connection):
        raise InputError(f"{path} is empty because the run has not begun: fuzz --resume begins it")
    _check_format(path, database_rows.read_format(connection))


def _check_format(path: Path, found: str) -> None:
    if found == DATABASE_FORMAT:
        return
    is_version = re.fullmatch(r"[1-9]\d{0,8}", found) is not None
    mend = "another version of behavexplor wrote it" if is_version else "it is damaged, or not a campaign's database"
    raise InputError(f"{path} has format {found:.20}, but this version reads {DATABASE_FORMAT}: {mend}")


def _unwritable(folder: Path, error: OSError | sqlite3.Error) -> InputError:
    reason = error.strerror if isinstance(error, OSError) else str(error)
    return InputError(f"The run folder {folder} cannot be written: {reason}")


def last_written(folder: Path) -> float:
    """Return the time at which executions were last written to a run folder [s since 1970]."""
    return max(path.stat().st_mtime for path in folder.glob(f"{DATABASE}*"))
