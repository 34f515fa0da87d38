"""How kernels, functions on plain arrays, are compiled to machine code, and kept."""

import hashlib
import json
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., object])

_PACKAGE = Path(__file__).parent
_IMPORT = re.compile(r"^(?:from|import) (behavexplor[.\w]*)(?: import (?:\(([^)]*)\)|(.*)))?", re.MULTILINE)


def kernel(function: Function) -> Function:
    """Compile a function on plain arrays; the machine code is cached beside its source file.

    Neither `fastmath` nor parallel loops: results must not depend on the machine.
    """
    return cast("Function", numba.njit(cache=True, nogil=True, error_model="numpy")(function))


def drop_stale_code(package: Path = _PACKAGE) -> None:
    """Delete the cached machine code of modules of which a source changed, directly or by what they import.

    Numba itself notices a change in a kernel's own file only, not in the kernels and constants that it uses.
    """
    digests = {str(path.relative_to(package)): _digest(path, package) for path in _modules_with_kernels(package)}
    stamp = package / "__pycache__" / "kernels.json"
    try:
        known = _read(stamp)
        if known == digests:
            return
        stamp.parent.mkdir(exist_ok=True)
        for name, digest in digests.items():
            if known.get(name) != digest:
                _drop(package / name)
        stamp.write_text(json.dumps(digests))
    except OSError:  # a read-only installation, which nobody edits
        return


def _modules_with_kernels(package: Path) -> list[Path]:
    return [path for path in sorted(package.rglob("*.py")) if "\n@kernel" in _source(path)]


def _read(stamp: Path) -> dict[str, str]:
    try:
        return dict(json.loads(stamp.read_text()))
    except (FileNotFoundError, ValueError, TypeError):  # the first import, or a file cut short
        return {}


def _digest(path: Path, package: Path) -> str:
    """Of the sources of a module and of all modules of the package that it imports, and so on."""
    reached = {path}
    waiting = [path]
    while waiting:
        new = _imported(_source(waiting.pop()), package) - reached
        reached |= new
        waiting += new
    sources = [_source(module) for module in sorted(reached)]
    return hashlib.sha256("".join(sources).encode()).hexdigest()


def _imported(source: str, package: Path) -> set[Path]:
    found: set[Path] = set()
    for module, *names in _IMPORT.findall(source):
        path = package.joinpath(*module.split(".")[1:])
        found |= {path.with_suffix(".py"), *(path / f"{name}.py" for name in re.findall(r"\w+", " ".join(names)))}
    return {path for path in found if path.is_file()}


def _drop(module: Path) -> None:
    for index in module.parent.glob(f"__pycache__/{module.stem}.*.nbi"):
        index.unlink(missing_ok=True)


@cache
def _source(path: Path) -> str:
    return path.read_text(encoding="utf-8")


drop_stale_code()
