"""Folders that libraries write to: what to do where HOME, or even the folder of temporary files, cannot be written."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

NO_TEMPORARY_FOLDER: Final = (
    "There is no folder for temporary files: set the environment variable TMPDIR to a folder that can be written"
)
_VARIABLE: Final = "MPLCONFIGDIR"  # names the folder in which matplotlib keeps its cache


@contextmanager
def folder_for_matplotlib() -> Iterator[None]:
    """Give matplotlib, which highway-env imports, a temporary folder if HOME cannot be written; it warns otherwise."""
    if _VARIABLE in os.environ or _has_home() or not has_temporary_folder():
        yield
        return
    with tempfile.TemporaryDirectory(prefix="behavexplor-matplotlib-", ignore_cleanup_errors=True) as folder:
        os.environ[_VARIABLE] = folder
        try:
            yield
        finally:
            del os.environ[_VARIABLE]


def has_temporary_folder() -> bool:
    """Return whether temporary files can be written."""
    try:
        tempfile.gettempdir()
    except FileNotFoundError:
        return False
    return True


def _has_home() -> bool:
    try:
        return os.access(Path.home(), os.W_OK)
    except RuntimeError:  # the user has no home
        return False
