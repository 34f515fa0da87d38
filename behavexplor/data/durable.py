"""Files that survive a crash."""

import os
from pathlib import Path


def write_durably(path: Path, text: str) -> None:
    """Write a file atomically and flush it to disk, so that a crash leaves no partial file."""
    partial = path.with_name(path.name + ".part")
    with partial.open("w") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)
