"""How the planner's kernels are compiled."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar, cast

import numba

import behavexplor.scene

Function = TypeVar("Function", bound=Callable[..., object])


def kernel(function: Function) -> Function:
    """Compile a function on plain arrays; the machine code is cached beside its source file.

    Neither `fastmath` nor parallel loops: results must not depend on the machine.
    """
    return cast("Function", numba.njit(cache=True, nogil=True, error_model="numpy")(function))


def _drop_stale_code(folder: Path, *others: Path) -> None:
    """Numba notices a change in a kernel's own file only, not in the kernels and constants that it uses."""
    sources = [*sorted(folder.glob("*.py")), *others]
    digest = hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()
    cache = folder / "__pycache__"
    stamp = cache / "kernels.sha256"
    try:
        if stamp.exists() and stamp.read_text() == digest:
            return
        cache.mkdir(exist_ok=True)
        for index in cache.glob("*.nbi"):
            index.unlink(missing_ok=True)
        stamp.write_text(digest)
    except OSError:  # a read-only installation, which nobody edits
        return


_drop_stale_code(Path(__file__).parent, Path(behavexplor.scene.__file__))
