"""Compilation of kernels, which are functions on plain arrays, to machine code that is cached on disk."""

import hashlib
import json
import logging
import os
import re
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar, cast

import numba
from numba.core import caching, codegen, event
from numba.core.compiler import Compiler
from numba.core.registry import cpu_target

Function = TypeVar("Function", bound=Callable[..., object])

_PACKAGE = Path(__file__).parent
_IMPORT = re.compile(r"^(?:from|import) (behavexplor[.\w]*)(?: import (?:\(([^)]*)\)|(.*)))?", re.MULTILINE)
_FILES = "*"  # key of the digest of all files, beside those of modules
_njit = cast("Any", numba.njit)  # its stubs leave some options out
_OPTIONS = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}  # C calls no kernels


_Code: Any = codegen.JITCodeLibrary  # numba's stubs leave its methods out
_Compiler: Any = Compiler


class _Part(_Code):  # type: ignore[misc]
    """The code of a function that only other kernels call: it is optimized with each of them, not on its own."""

    @property
    def codegen(self) -> Any:
        """Where numba says at which address a function's constants are. A part has no address."""
        return SimpleNamespace(set_env=lambda *_: None)

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout  # noqa: SLF001 - all that is left of numba's own

    def finalize(self) -> None:
        """Leave the code as it is."""
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, _: str) -> int:
        """Return 0: there is no machine code."""
        self._ensure_finalized()
        return 0

    def parts(self) -> list[Any]:
        """Return what the code itself calls."""
        return list(self._linking_libraries)


class _Whole(_Code):  # type: ignore[misc]
    """The code of a kernel with all its parts, each of them once."""

    _linking_libraries: list[Any]

    def finalize(self) -> None:
        """Collect the parts, optimize the code and make machine code of it."""
        waiting = self._linking_libraries
        self._linking_libraries = []
        while waiting:
            library = waiting.pop()
            if library not in self._linking_libraries:
                self._linking_libraries.append(library)
                waiting += library.parts() if isinstance(library, _Part) else []
        super().finalize()

    def _optimize_final_module(self) -> None:
        """Optimize. No other kernel uses these parts, so they can be changed, or left out where they are called."""
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage.name == "linkonce_odr":
                function.linkage = "internal"
        super()._optimize_final_module()


class _PartCompiler(_Compiler):  # type: ignore[misc]
    def __init__(self, typing_context: Any, target_context: Any, _: Any, *arguments: Any) -> None:
        super().__init__(typing_context, target_context, _Part(target_context.codegen(), "part"), *arguments)


class _WholeCompiler(_Compiler):  # type: ignore[misc]
    def __init__(self, typing_context: Any, target_context: Any, _: Any, *arguments: Any) -> None:
        library = _Whole(target_context.codegen(), "kernel")
        library.enable_object_caching()
        super().__init__(typing_context, target_context, library, *arguments)


def kernel(function: Function) -> Function:
    """Compile a function on plain arrays. The machine code is cached beside its source file.

    Neither `fastmath` nor parallel loops are used, because results must not depend on the machine.
    """
    return cast("Function", _njit(cache=True, pipeline_class=_WholeCompiler, **_OPTIONS)(function))


def kernel_in_place(function: Function) -> Function:
    """Compile a function that neither creates nor returns an array; otherwise as `kernel`.

    The compiled function does not count references to arrays. For small functions that take tuples of many arrays, the
    counting took more than half of their time. Numba refuses to compile a function that creates an array. A test
    checks that none of these functions returns one.
    """
    return cast("Function", _njit(cache=True, _nrt=False, pipeline_class=_WholeCompiler, **_OPTIONS)(function))


def kernel_inner(function: Function) -> Function:
    """Compile a function as a part of the kernels that call it, directly or not; otherwise as `kernel_in_place`.

    Python cannot call it. Numba would optimize each function once more with every function that calls it, and make
    machine code of it every time. A kernel with its parts is compiled in half of the time or less, and runs up to a
    fifth faster, because the compiler sees that nothing else calls them.
    """
    options = {"_nrt": False, "no_cpython_wrapper": True, **_OPTIONS}
    return cast("Function", _njit(pipeline_class=_PartCompiler, **options)(function))


def compiled_for(function: Function, *arguments: object) -> Function:
    """Compile a kernel for the types of some arguments, and return its machine code.

    Numba finds out the types of all arguments at each call, which takes 20 us for tuples of many arrays. The machine
    code does not: it must be called with arguments of exactly the same types, dimensions and memory layouts only. With
    any others, it reads and writes beyond them. Objects that hold it can be copied and pickled.
    """
    types = tuple(numba.typeof(argument) for argument in arguments)  # type: ignore[no-untyped-call]
    return cast("Function", _MachineCode(function, types))


def load_compiler() -> None:
    """Load the parts of numba that the first compiled function of a process needs, which takes 0.2 s."""
    cpu_target.typing_context.refresh()
    cpu_target.target_context.refresh()


class _MachineCode:
    def __init__(self, function: Any, types: tuple[Any, ...]) -> None:
        self._recipe = function.__module__, function.__qualname__, types
        self._code: Callable[..., object] = function.compile(types)

    def __call__(self, *arguments: object) -> object:
        return self._code(*arguments)

    def __reduce__(self) -> tuple[Any, ...]:
        return _compiled_again, self._recipe


def _compiled_again(module: str, name: str, types: tuple[Any, ...]) -> _MachineCode:
    return _MachineCode(getattr(import_module(module), name), types)


class _Notice(event.Listener):
    """Reports, once in each process, that kernels of this package are being compiled.

    The report is a log message of level WARNING, so that it shows without any logging configuration.
    """

    def __init__(self) -> None:
        self._is_said = False

    def on_start(self, event: event.Event) -> None:
        """Report that a function is about to be compiled. Numba does not call this for cached functions."""
        module = event.data["dispatcher"].py_func.__module__
        if self._is_said or not module.startswith(__package__):
            return
        self._is_said = True
        logging.getLogger(__name__).warning(
            "Compiling to machine code; this takes some seconds, and the result is cached for next time ..."
        )

    def on_end(self, event: event.Event) -> None:
        """Do nothing; numba requires this method."""


event.register("numba:compile", _Notice())  # type: ignore[no-untyped-call]


def keep_no_code() -> None:
    """Let numba work without the right to write: it uses cached code, but caches nothing from now on.

    By default, numba raises an error if it cannot write to the cache folder.
    """

    @contextmanager
    def unkept(_: object) -> Iterator[None]:
        with suppress(OSError):
            yield

    caching._CacheLocator.ensure_cache_path = lambda _: None  # type: ignore[method-assign] # noqa: SLF001
    caching.Cache._guard_against_spurious_io_errors = unkept  # type: ignore[assignment] # noqa: SLF001


def drop_stale_code(folder: Path = _PACKAGE, package: Path = _PACKAGE) -> None:
    """Delete the cached machine code of modules whose source, or the source of a module that they import, has changed.

    Numba itself only notices changes in a kernel's own file, not in the kernels and constants that the kernel uses.

    Args:
        folder: folder of the modules.
        package: folder of the package `behavexplor`, from which they import kernels and constants.
    """
    stamp = folder / "__pycache__" / "kernels.json"
    files, known = _files({folder, package}), _read(stamp)
    if known.get(_FILES) == files:  # without reading all sources
        return
    digests = {str(path.relative_to(folder)): _digest(path, package) for path in _modules_with_kernels(folder)}
    try:
        stamp.parent.mkdir(exist_ok=True)
        for name, digest in digests.items():
            if known.get(name) != digest:
                _drop(folder / name)
        stamp.write_text(json.dumps({_FILES: files, **digests}))
    except OSError:  # a read-only installation, whose sources do not change
        return


def _files(folders: set[Path]) -> str:
    """Return a digest of the sizes and times of change of all modules in some folders.

    An installer may give a new file the time of the old one, but not the time at which its entry was changed.
    """
    paths = sorted(path for folder in folders for path in folder.rglob("*.py") if path.is_file())
    found = [(str(path), path.stat()) for path in paths]
    changes = [(path, info.st_size, info.st_mtime_ns, info.st_ctime_ns) for path, info in found]
    return hashlib.sha256(repr(changes).encode()).hexdigest()


def _modules_with_kernels(folder: Path) -> list[Path]:
    return [path for path in sorted(folder.rglob("*.py")) if path.is_file() and "\n@kernel" in _source(path)]


def _read(stamp: Path) -> dict[str, str]:
    try:
        return dict(json.loads(stamp.read_text()))
    except (FileNotFoundError, ValueError, TypeError):  # the first import, or a truncated file
        return {}


def _digest(path: Path, package: Path) -> str:
    """Return the digest of the sources of a module and of all modules of the package that it imports, recursively."""
    reached = {path}
    waiting = [path]
    while waiting:
        new = _imported(_source(waiting.pop()), package) - reached
        reached |= new
        waiting += new
    sources = [_source(module) for module in sorted(reached)]
    return hashlib.sha256("".join(sources).encode()).hexdigest()


@cache
def _imported(source: str, package: Path) -> frozenset[Path]:
    found: set[Path] = set()
    for module, *names in _IMPORT.findall(source):
        path = package.joinpath(*module.split(".")[1:])
        found |= {path.with_suffix(".py"), *(path / f"{name}.py" for name in re.findall(r"\w+", " ".join(names)))}
    return frozenset(path for path in found if path.is_file())


def _drop(module: Path) -> None:
    for index in module.parent.glob(f"__pycache__/{module.stem}.*.nbi"):
        index.unlink(missing_ok=True)


@cache
def _source(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def find_place_for_code() -> None:
    """Let numba keep code in a temporary folder if it can write neither beside the sources nor in the user's cache.

    If it cannot write there either, such as in a container whose root is read-only, it compiles in every process.
    """
    locating: Any = caching.CompileResultCacheImpl
    with suppress(RuntimeError):  # there is no place
        locating(find_place_for_code)
        return
    place = _own_temporary_folder()
    if place is None:
        keep_no_code()
        return
    os.environ["NUMBA_CACHE_DIR"] = numba.config.CACHE_DIR = str(place)  # type: ignore[attr-defined]


def _own_temporary_folder() -> Path | None:
    """Return a folder that only this user can write, for the code of these sources; None if there is none.

    Numba executes what it finds in its cache, so the folder must not be another user's.
    """
    user = os.getuid() if hasattr(os, "getuid") else 0
    sources = "".join(_source(path) for path in sorted(_PACKAGE.rglob("*.py")))
    try:
        folder = Path(tempfile.gettempdir()) / f"behavexplor-{user}-{hashlib.sha256(sources.encode()).hexdigest()[:16]}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.stat(follow_symlinks=False)
    except OSError:
        return None
    is_ours = stat.S_ISDIR(found.st_mode) and found.st_uid == user and not found.st_mode & 0o077
    return folder if is_ours or not hasattr(os, "getuid") else None


drop_stale_code()
find_place_for_code()
