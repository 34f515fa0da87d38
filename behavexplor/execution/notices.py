"""Collection of the warnings that libraries log or issue while something is loaded."""

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from behavexplor.errors import sentence

_COMPILING = "behavexplor.jit"  # logger that tells that the user has to wait, which is no warning about an ADS


@contextmanager
def collected_notices() -> Iterator[list[str]]:
    """Collect what is logged at level WARNING or above, and Python's warnings, instead of printing it.

    Yields:
        A list to which the notices are added, each as one printable line.
    """
    notices: list[str] = []
    handler = _Collector(notices)
    root = logging.getLogger()
    root.addHandler(handler)
    try:
        with warnings.catch_warnings(record=True) as issued:
            yield notices
    finally:
        root.removeHandler(handler)
    notices += [sentence(str(warning.message)) for warning in issued]


class _Collector(logging.Handler):
    def __init__(self, notices: list[str]) -> None:
        super().__init__(logging.WARNING)
        self._notices = notices
        self.addFilter(lambda record: record.name != _COMPILING)

    def emit(self, record: logging.LogRecord) -> None:
        self._notices.append(sentence(record.getMessage()))
