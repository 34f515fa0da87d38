"""The lock of a run folder: it lets at most one campaign write to the folder."""

from pathlib import Path
from typing import IO

from behavexplor.data.durable import check_file
from behavexplor.errors import InputError

try:
    import fcntl
except ImportError:  # Windows has no such locks
    fcntl = None  # type: ignore[assignment]

LOCK = "campaign.lock"


def lock_folder(folder: Path) -> IO[str]:
    """Lock a run folder against other campaigns until the returned file is closed.

    Raises:
        InputError: if another campaign holds the lock.
        OSError: if the file of the lock cannot be written, or is none.
    """
    check_file(folder / LOCK)
    file = (folder / LOCK).open("a")
    if fcntl is not None:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            raise InputError(f"{folder} is in use by another campaign: wait until it ends, or stop it") from None
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
