"""Imports of exactly those bytes that were checked.

A module is looked at, judged, and imported later, perhaps in another process. In between, its file may be replaced, and
compiled code beside it may have been planted. So the importer compares what it reads, and compiles that.
"""

import hashlib
import sys
from collections.abc import Iterable, Mapping, Sequence
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_file_location
from pathlib import Path
from types import CodeType, ModuleType
from typing import Final

from behavexplor.errors import InputError

_SOURCE: Final = ".py"


def source_files(module: str) -> dict[str, Path]:
    """Return the files of a module and of its packages, by the names of the modules, without importing any.

    Those that are not found, or have no file, are left out.
    """
    found: dict[str, Path] = {}
    places: Sequence[str] | None = None
    for name in _with_packages(module):
        spec = _spec(name, places)
        if spec is None:
            break
        if spec.has_location and spec.origin is not None:
            found[name] = Path(spec.origin)
        places = spec.submodule_search_locations
        if places is None:
            break
    return found


def digests_of(modules: Iterable[str]) -> dict[str, str]:
    """Return SHA-256 of the files of modules and of their packages, by module; see `source_files`."""
    files = {name: path for module in modules for name, path in source_files(module).items()}
    return {name: _digest(_read(path)) for name, path in sorted(files.items())}


def import_checked(digests: Mapping[str, str]) -> None:
    """Import modules that have not been imported, each from a file with a known digest, see `digests_of`.

    Raises:
        InputError: if a file differs, or a module cannot be imported.
    """
    finder = _CheckingFinder(digests)
    sys.meta_path.insert(0, finder)
    name = ""
    try:
        for name in digests:
            import_module(name)
    except InputError:
        raise
    except Exception as error:  # a module can raise anything when it is imported
        raise InputError(f"The module {name} cannot be imported: {type(error).__name__}: {error}") from error
    finally:
        sys.meta_path.remove(finder)


class _CheckedSource(SourceFileLoader):
    """Loads a module from source that has been read, and from no compiled file beside it."""

    def __init__(self, name: str, path: str, source: bytes) -> None:
        super().__init__(name, path)
        self._source = source

    def get_code(self, fullname: str) -> CodeType:  # noqa: ARG002 - the signature of a loader
        return self.source_to_code(self._source, self.path)


class _CheckingFinder(MetaPathFinder):
    """Finds modules with a known digest, and refuses those whose files have another one.

    The bytes of a source are those that are compiled. A library in machine code is compared just before it is loaded.
    """

    def __init__(self, digests: Mapping[str, str]) -> None:
        self._digests = digests

    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None,
        target: ModuleType | None = None,  # noqa: ARG002 - the signature of a finder
    ) -> ModuleSpec | None:
        if fullname not in self._digests:
            return None
        spec = _spec(fullname, path)
        if spec is None or spec.origin is None:
            return spec
        data = _read(Path(spec.origin))
        if _digest(data) != self._digests[fullname]:
            raise InputError(f"{spec.origin} has changed since it was checked, so it was not run: repeat the command")
        if not spec.origin.endswith(_SOURCE):
            return spec
        loader, places = _CheckedSource(fullname, spec.origin, data), spec.submodule_search_locations
        return spec_from_file_location(fullname, spec.origin, loader=loader, submodule_search_locations=places)


def _with_packages(module: str) -> list[str]:
    """Return the names of a module's packages, from the outermost one on, and its own; none if it is no name."""
    parts = module.split(".")
    return [] if "" in parts else [".".join(parts[: i + 1]) for i in range(len(parts))]


def _spec(name: str, places: Sequence[str] | None) -> ModuleSpec | None:
    """Return where a module would be loaded from, without importing its packages; None if it is not found."""
    for finder in sys.meta_path:
        if not isinstance(finder, _CheckingFinder) and (spec := finder.find_spec(name, places)) is not None:
            return spec
    return None


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
