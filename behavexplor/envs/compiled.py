"""How the kernels of the environments are compiled."""

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., object])


def kernel(function: Function) -> Function:
    """Compile a function on plain arrays; the machine code is cached beside its source file.

    Neither `fastmath` nor parallel loops: results must not depend on the machine.
    """
    return cast("Function", numba.njit(cache=True, nogil=True, error_model="numpy")(function))


def _drop_stale_code(folder: Path, constants: Sequence[Path]) -> None:
    """Numba notices a change in a kernel's own file only, not in the kernels and constants that it uses."""
    sources = [source.read_bytes() for source in sorted(folder.rglob("*.py"))]
    used = [source for source in sources if b"@kernel" in source] + [source.read_bytes() for source in constants]
    digest = hashlib.sha256(b"".join(used)).hexdigest()
    stamp = folder / "__pycache__" / "kernels.sha256"
    try:
        if stamp.exists() and stamp.read_text() == digest:
            return
        stamp.parent.mkdir(exist_ok=True)
        for index in folder.rglob("__pycache__/*.nbi"):
            index.unlink(missing_ok=True)
        stamp.write_text(digest)
    except OSError:  # a read-only installation, which nobody edits
        return


_FOLDER = Path(__file__).parent
_drop_stale_code(
    _FOLDER,
    [
        _FOLDER / "reward.py",
        _FOLDER / "kinematics.py",
        *(_FOLDER.parent / f"{name}.py" for name in ("logical", "scene", "trace")),
    ],
)
