"""The list of what this user's machine has made: digests in a file outside of all folders that users hand on.

A digest is that of a folder's configuration and of the code that it names. A folder that is copied or moved keeps it.
Confined drivers cannot write the list. There is no secret in it: who can write it can do all that the user can.
"""

import os
import stat
from pathlib import Path
from typing import Final

from platformdirs import user_state_path

NAME: Final = "own-folders"
_FLAGS: Final = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0)


def list_path() -> Path:
    """Return the path of the list: on Linux, in $XDG_STATE_HOME or ~/.local/state."""
    return user_state_path("behavexplor") / NAME


def is_own(digest: str) -> bool:
    """Return whether a digest is in the list. A list that other users may have written does not count."""
    try:
        file = os.open(list_path(), os.O_RDONLY | _FLAGS)
    except OSError:
        return False
    with os.fdopen(file, "rb") as lines:
        return _is_users(os.fstat(lines.fileno())) and digest.encode() in lines.read().split()


def add_own(digest: str) -> None:
    """Add a digest to the list, and flush it to disk. Several processes may do so at a time.

    Raises:
        OSError: if the list cannot be written.
    """
    if is_own(digest):
        return
    path = list_path()
    if not path.is_absolute():  # without a home folder
        raise FileNotFoundError(f"there is no folder for {path}")
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    is_new = not path.exists()
    file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | _FLAGS, 0o600)
    try:
        os.write(file, f"\n{digest}\n".encode())  # the first newline ends what a crash may have cut off
        os.fsync(file)
    finally:
        os.close(file)
    if is_new:
        _flush_folder(path.parent)


def _is_users(status: os.stat_result) -> bool:
    if not hasattr(os, "getuid"):  # Windows keeps other users out of a user's folder
        return True
    return status.st_uid == os.getuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _flush_folder(folder: Path) -> None:
    """Flush the names of a folder to disk, where the system can."""
    if hasattr(os, "O_DIRECTORY"):
        file = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(file)
        finally:
            os.close(file)
