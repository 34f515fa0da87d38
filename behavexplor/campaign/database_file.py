"""The file of a database, how it is opened so that a file from elsewhere does nothing of its own, and the run's lock.

SQLite acts on a file before the first statement: it rolls a journal back, and a journal may name a file to delete.
Views, triggers, virtual tables and expressions of a foreign schema are code that runs in the statements of others.
"""

import os
import re
import sqlite3
import sys
from collections.abc import Iterator
from contextlib import closing
from functools import cache
from pathlib import Path
from typing import IO, Final

from behavexplor.campaign.folder_format import LOCK, SCHEMA
from behavexplor.data.durable import check_file
from behavexplor.errors import InputError

try:
    import fcntl
except ImportError:  # Windows has no such locks
    fcntl = None  # type: ignore[assignment]

MAX_VALUE: Final = 100_000_000  # greatest size of a stored value [bytes]; a trace has some thousand
AUXILIARY: Final = ("-wal", "-shm", "-journal")  # endings of the files that SQLite keeps beside a database
UNREADABLE: Final = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)  # codes of errors

_COMMENT: Final = re.compile(r"--[^'\"\n]*\n")  # without quotes, so that it cannot hide the end of a text
_SUPER_JOURNAL: Final = bytes.fromhex("d9d505f920a163d7")  # the last bytes of a journal that names another one
_NAME_TRAILER: Final = 16  # size of what follows that name: its length, its checksum and these bytes [bytes]

_Entry = tuple[str, str, str, str]  # type, name, table and definition of something in a schema


def connect(path: Path, mode: str) -> sqlite3.Connection:
    """Open a database to read ("ro"), to read and write ("rw"), or to also create a missing file ("rwc").

    Raises:
        sqlite3.Error: if the file cannot be opened.
        InputError: if it is not a database that this program has made, or if its journal names another journal.
    """
    _check_files(path)
    if mode == "ro" and not os.access(path.parent, os.W_OK) and not wal_of(path).exists():
        mode = "ro&immutable=1"  # in a folder that cannot be written, SQLite cannot create its auxiliary files
    connection = sqlite3.connect(f"{path.resolve().as_uri()}?mode={mode}", uri=True, timeout=30)
    try:
        _set_up(path, connection, is_reader=mode.startswith("ro"))
    except BaseException:
        connection.close()
        raise
    return connection


def wal_of(path: Path) -> Path:
    """Return the path of SQLite's write-ahead log, which holds the latest commits."""
    return path.with_name(path.name + "-wal")


def _set_up(path: Path, connection: sqlite3.Connection, *, is_reader: bool) -> None:
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_VALUE)
    connection.text_factory = bytes  # checksums detect damaged text; decoding must not fail first
    connection.execute("PRAGMA trusted_schema = OFF")  # until it has been checked
    connection.execute("PRAGMA cell_size_check = ON")  # damaged pages are found before they are used
    connection.execute("PRAGMA writable_schema = ON")  # read as much as possible of a truncated file
    _check_schema(path, connection, is_reader=is_reader)
    if is_reader:
        return
    connection.execute("PRAGMA trusted_schema = ON")  # it is ours now, with columns that use JSON
    connection.execute("PRAGMA writable_schema = RESET")
    if sys.version_info >= (3, 12):
        connection.setconfig(sqlite3.SQLITE_DBCONFIG_DEFENSIVE, True)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = FULL")


def _check_files(path: Path) -> None:
    """Check a database and the files beside it before SQLite opens them."""
    journal = path.with_name(path.name + "-journal")
    try:
        for file in (path, *(path.with_name(path.name + ending) for ending in AUXILIARY)):
            check_file(file)
        end = _last_bytes(journal, _NAME_TRAILER) if journal.exists() else b""
    except OSError as error:
        raise InputError(f"{path.parent} cannot be read: {error.strerror}") from None
    if len(end) == _NAME_TRAILER and end.endswith(_SUPER_JOURNAL):
        raise InputError(
            f"{journal} names another journal, which SQLite would delete, and no campaign writes such a name: delete "
            f"{journal.name} if the folder is not your own"
        )


def _last_bytes(file: Path, count: int) -> bytes:
    with file.open("rb") as content:
        content.seek(-min(count, file.stat().st_size), os.SEEK_END)
        return content.read(count)


def _check_schema(path: Path, connection: sqlite3.Connection, *, is_reader: bool) -> None:
    """Check that a database has no other tables than ours, and nothing else that would act."""
    try:
        for entry in _entries(connection):
            if entry not in _known_entries():
                kind, name, *_ = entry
                is_ours = name in {ours for _, ours, *_ in _known_entries()}
                mend = "restore it from a copy" if is_ours else f"if it is your own, drop the {kind}"
                raise InputError(
                    f"{path} has the {kind} {name!r:.60}, which this version of behavexplor does not make so: it is "
                    f"not opened, because that could change what is read and written; {mend}"
                )
    except sqlite3.DatabaseError as error:
        code = error.sqlite_errorcode & 0xFF  # the primary result code, without the bits of an extended one
        if not is_reader or code not in UNREADABLE:  # readers still find rows in the pages that are left
            raise


def _entries(connection: sqlite3.Connection) -> Iterator[_Entry]:
    """Yield type, name, table and definition of everything in a schema."""
    for row in connection.execute("SELECT type, name, tbl_name, sql FROM sqlite_schema"):
        kind, name, table, definition = (_text(value) for value in row)
        yield kind, name, table, " ".join(_COMMENT.sub("\n", definition).split())


def _text(value: object) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value or "")


@cache
def _known_entries() -> frozenset[_Entry]:
    """Return what our schema holds, without comments."""
    with closing(sqlite3.connect(":memory:")) as connection:
        connection.executescript(SCHEMA)
        return frozenset(_entries(connection))


def lock_folder(folder: Path) -> IO[str]:
    """Lock a run folder against other campaigns until the returned file is closed.

    Raises:
        InputError: if another campaign holds the lock.
        OSError: if the file of the lock cannot be written, or is not a regular file.
    """
    check_file(folder / LOCK)
    file = (folder / LOCK).open("a")
    if fcntl is not None:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            raise InputError(f"{folder} is in use by another command: wait until it ends, or stop it") from None
    return file


def is_being_written(folder: Path) -> bool:
    """Return whether a campaign is writing to a run folder now; False on a system without such locks."""
    if fcntl is None or not (folder / LOCK).is_file():
        return False
    with (folder / LOCK).open() as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False
