"""Late loading of modules that other libraries import and this package rarely uses.

highway-env imports Matplotlib's pyplot and pandas, and loading them takes twice as long as the rest of it. Commands and
workers load them at their first use. A program that uses this package as a library does not, because before Python
3.11.9, two threads must not use such a module for the first time at once. scikit-learn imports pandas if it is
installed, and clustering does not need it.
"""

import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from types import ModuleType
from typing import Final

_RARELY_USED: Final = frozenset({"matplotlib.pyplot", "pandas"})


class _LazyFinder(MetaPathFinder):
    """Finds modules as usual, but rarely used ones are executed only when one of their attributes is used."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        spec = PathFinder.find_spec(fullname, path, target) if fullname in _RARELY_USED else None
        if spec is not None and spec.loader is not None:
            spec.loader = LazyLoader(spec.loader)
        return spec


class _HidingFinder(MetaPathFinder):
    """Hides a module from what the current thread imports, as if it were not installed."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._thread = threading.get_ident()

    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None,  # noqa: ARG002 - the signature of a finder
        target: ModuleType | None = None,  # noqa: ARG002
    ) -> ModuleSpec | None:
        if fullname == self._name and threading.get_ident() == self._thread:
            raise ModuleNotFoundError(f"No module named {fullname!r}", name=fullname)
        return None


_lazy: Final = _LazyFinder()


def begin_loading_at_first_use() -> None:
    """Begin to load rarely used modules at their first use, if they are imported from now on."""
    sys.meta_path.insert(0, _lazy)


def end_loading_at_first_use() -> None:
    """Load modules as usual again. Those that have been imported meanwhile are still loaded at their first use."""
    sys.meta_path.remove(_lazy)


@contextmanager
def loaded_at_first_use() -> Iterator[None]:
    """Return a context in which rarely used modules that are imported are loaded at their first use."""
    begin_loading_at_first_use()
    try:
        yield
    finally:
        end_loading_at_first_use()


@contextmanager
def hidden(name: str) -> Iterator[None]:
    """Return a context in which this thread cannot import a module. A module that is already imported stays available.

    Libraries that can do without the module are loaded faster in it.

    Args:
        name: name of the module.
    """
    finder = _HidingFinder(name)
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)
