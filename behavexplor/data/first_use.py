"""Late loading of modules that other libraries import and this package rarely uses.

highway-env imports Matplotlib's pyplot and pandas, and loading them takes twice as long as the rest of it. SciPy loads
all of NumPy, with f2py. Commands and workers load these modules at their first use. A program that uses this package as
a library does not, because before Python 3.11.9, two threads must not use such a module for the first time at once.

scikit-learn imports pandas if it is installed, and functions of scipy.stats, which takes as long as the rest of what
clustering loads. Clustering needs neither.
"""

import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from types import ModuleType
from typing import Any, Final

_RARELY_USED: Final = frozenset({"matplotlib.pyplot", "numpy.f2py", "pandas"})


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


class _StandIn(ModuleType):
    """Stands for a module that is not loaded. Its functions load the module when they are called.

    Attributes:
        is_standing_in: whether every name is that of a function. Afterwards, the names are those of the module itself.
    """

    is_standing_in = True

    def __getattr__(self, name: str) -> Any:
        if not self.is_standing_in:
            return getattr(import_module(self.__name__), name)
        if name.startswith("__"):
            raise AttributeError(name)
        return partial(_call, self.__name__, name)


def _call(module: str, function: str, /, *args: Any, **kwargs: Any) -> Any:
    return getattr(import_module(module), function)(*args, **kwargs)


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
    """Return a context in which this thread cannot import a module. A module that is already loaded stays available.

    Libraries that can do without the module are loaded faster in it.

    Args:
        name: name of the module.
    """
    finder, late = _HidingFinder(name), _taken_if_late(name)
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)
        if late is not None:
            sys.modules[name] = late


def _taken_if_late(name: str) -> ModuleType | None:
    """Take a module out of the imported ones if it waits for its first use, because another import would load it."""
    module_type = type(sys.modules.get(name, sys))
    waits = name in _RARELY_USED and module_type is not ModuleType  # LazyLoader changes the type once it is loaded
    return sys.modules.pop(name) if waits else None


@contextmanager
def functions_loaded_late(name: str) -> Iterator[None]:
    """Return a context in which functions can be imported from a module that is loaded when one of them is called.

    It has no effect if the module is already loaded, and where modules are not loaded at their first use, because other
    threads would see it.

    Args:
        name: name of a module in a package that is loaded. In the context, only functions can be imported from it.
    """
    if name in sys.modules or _lazy not in sys.meta_path:
        yield
        return
    sys.modules[name] = stand_in = _StandIn(name)
    try:
        yield
    finally:
        del sys.modules[name]
        stand_in.is_standing_in = False
