"""Modules that are loaded at their first use, not when another module imports them.

highway-env imports Matplotlib's pyplot and pandas, and scikit-learn imports pandas, for functions that executions do not
call. Loading the two takes longer than everything else that a worker needs of highway-env.
"""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from types import ModuleType
from typing import Final

_RARELY_USED: Final = frozenset({"matplotlib.pyplot", "pandas"})


class _LazyFinder(MetaPathFinder):
    """Finds modules as usual, but executes them only when one of their attributes is used."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        spec = PathFinder.find_spec(fullname, path, target) if fullname in _RARELY_USED else None
        if spec is not None and spec.loader is not None:
            spec.loader = LazyLoader(spec.loader)
        return spec


_finder: Final = _LazyFinder()


def begin_loading_at_first_use() -> None:
    """Begin to load rarely used modules at their first use, if they are imported from now on."""
    sys.meta_path.insert(0, _finder)


def end_loading_at_first_use() -> None:
    """Load modules as usual again. Those that have been imported meanwhile are still loaded at their first use."""
    sys.meta_path.remove(_finder)


@contextmanager
def loaded_at_first_use() -> Iterator[None]:
    """Return a context in which rarely used modules that are imported are loaded at their first use."""
    begin_loading_at_first_use()
    try:
        yield
    finally:
        end_loading_at_first_use()
