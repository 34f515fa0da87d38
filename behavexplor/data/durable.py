"""Files that survive a crash."""

import errno
import os
from pathlib import Path


def write_durably(path: Path, text: str) -> None:
    """Write a file atomically and flush it to disk, so that a crash leaves no partial file.

    Raises:
        OSError: if it cannot be written.
    """
    if path.is_dir():  # before anything is written; the folders "." and "/" have no names to change, either
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    partial = path.with_name(path.name + ".part")
    with partial.open("w") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)
