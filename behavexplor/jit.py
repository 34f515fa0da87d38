"""Compilation of kernels, which are functions on plain arrays, to machine code that is cached on disk.

Numba itself only notices changes in a kernel's own file, not in the kernels and constants that the kernel uses. So the
machine code of each module is in a folder whose name is a digest of all that it depends on.
"""

import gc
import hashlib
import logging
import os
import re
import shutil
import signal
import stat
import sys
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from threading import Lock, current_thread, main_thread
from types import SimpleNamespace
from typing import Any, Final, Self, TypeVar, cast

import llvmlite
import numba
import numpy as np
from numba.core import event
from platformdirs import user_cache_path

from behavexplor.errors import InputError

if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]
    raise InputError("NUMBA_DISABLE_JIT is set, and nothing here runs without compiled code: unset it")

Function = TypeVar("Function", bound=Callable[..., object])

_PACKAGE = Path(__file__).parent
_INSTALLATION = f"behavexplor-{hashlib.sha256(str(_PACKAGE).encode()).hexdigest()[:16]}"  # name of its folder for code
# absolute import statements; relative ones are not followed
_IMPORT = re.compile(r"^(?:from|import) ([.\w]+)(?: import (?:\(([^)]*)\)|(.*)))?", re.MULTILINE)
_njit = cast("Any", numba.njit)  # its stubs leave some options out
# Converts a number that a kernel passes to another. For a Python number, numba would compile that one once more.
int64: Final = cast("Callable[[int], int]", np.int64)
_COMPILING: Final = "Compiling to machine code; this takes some seconds, and the code is kept for next time ..."
_COMPILING_SLOWLY: Final = (
    "Compiling to machine code; this takes minutes, and driving takes several times as long as usual, with numba "
    f"{numba.__version__}, which is not one of the versions that this package knows ..."
)
_COMMON_OPTIONS: Final = {"nogil": True, "error_model": "numpy"}

# Kernels owe their speed to private options and classes of numba, in the versions with which they were tested. With
# any other version, kernels do without them: the results are the same, but compilation takes more than twice as long,
# and a step of an environment up to eight times.
TESTED: Final = ("0.61.", "0.62.", "0.63.", "0.64.", "0.65.", "0.66.", "0.67.", "0.68.")
IS_TESTED: Final = numba.__version__.startswith(TESTED)

_Code: Any = object
_Compiler: Any = object
if IS_TESTED:
    from numba.core.codegen import JITCodeLibrary as _Code
    from numba.core.compiler import Compiler as _Compiler


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


Options = Mapping[str, object]
WHOLE: Options = {"pipeline_class": _WholeCompiler, "no_cfunc_wrapper": True}  # C calls no kernels
IN_PLACE: Options = {**WHOLE, "_nrt": False}  # no counting of references to arrays
INNER: Options = {**IN_PLACE, "pipeline_class": _PartCompiler, "no_cpython_wrapper": True}  # Python cannot call it
if not IS_TESTED:  # see `TESTED`
    WHOLE = IN_PLACE = INNER = {}


def kernel(function: Function) -> Function:
    """Compile a function on plain arrays. The machine code is cached, see `folder_for_code`.

    Neither `fastmath` nor parallel loops are used, because results must not depend on the machine.
    """
    return _compile_and_keep(function, WHOLE)


def kernel_in_place(function: Function) -> Function:
    """Compile a function that neither creates nor returns an array; otherwise as `kernel`.

    The compiled function does not count references to arrays. For small functions that take tuples of many arrays, the
    counting took more than half of their time. Numba refuses to compile a function that creates an array. A test
    checks that none of these functions returns one.
    """
    return _compile_and_keep(function, IN_PLACE)


def kernel_inner(function: Function) -> Function:
    """Compile a function as a part of the kernels that call it, directly or not; otherwise as `kernel_in_place`.

    Python cannot call it. Numba would optimize each function once more with every function that calls it, and make
    machine code of it every time. A kernel with its parts is compiled in half of the time or less, and runs up to twice
    as fast, because the compiler sees that nothing else calls them.
    """
    return cast("Function", _njit(**_COMMON_OPTIONS, **INNER)(function))


def compiled_for(function: Function, *arguments: object) -> Function:
    """Compile a kernel for the types of some arguments, and return its machine code.

    Numba finds out the types of all arguments at each call, which takes 20 us for tuples of many arrays. The machine
    code does not: it must be called with arguments of exactly the same types, dimensions and memory layouts only. With
    any others, it reads and writes beyond them. Objects that hold it can be copied and pickled.
    """
    types = tuple(numba.typeof(argument) for argument in arguments)  # type: ignore[no-untyped-call]
    return cast("Function", _MachineCode(function, types))


class _MachineCode(partial[Any]):
    """Machine code that can be pickled. It is a `partial`, because that is called in less time than a method."""

    recipe: tuple[str, str, tuple[Any, ...]]

    def __new__(cls, function: Any, types: tuple[Any, ...]) -> Self:
        made = super().__new__(cls, function.compile(types))
        made.recipe = function.__module__, function.__qualname__, types
        return made

    def __reduce__(self) -> tuple[Any, ...]:
        return _compiled_again, self.recipe


def _compiled_again(module: str, name: str, types: tuple[Any, ...]) -> _MachineCode:
    return _MachineCode(getattr(import_module(module), name), types)


class _Interrupts:
    """Puts off Ctrl-C while the main thread compiles: LLVM's callbacks, in which it may come, would lose it."""

    def __init__(self) -> None:
        self._compilations = 0  # number of those of the main thread that have not ended
        self._has_come = False

    def put_off(self) -> None:
        """Put it off until the compilation that begins has ended."""
        if current_thread() is not main_thread():
            return
        if self._compilations == 0 and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, self._keep)
        self._compilations += 1

    def _keep(self, _number: int, _frame: object) -> None:
        self._has_come = True

    def raise_if_any(self) -> None:
        """Raise a KeyboardInterrupt if Ctrl-C has come, and the outermost compilation has ended."""
        if current_thread() is not main_thread():
            return
        self._compilations -= 1
        if self._compilations > 0 or signal.getsignal(signal.SIGINT) != self._keep:
            return
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if self._has_come:
            self._has_come = False
            raise KeyboardInterrupt


class _Compilation(event.Listener):
    """Reports, once in each process, that kernels of this package are being compiled, and puts off garbage collection.

    The report is a log message of level WARNING, so that it shows without any logging configuration. Collections took
    a tenth of the time of compiling. Without them it uses up to 150 MB more. Ctrl-C is put off, too.
    """

    def __init__(self) -> None:
        self._is_said = False
        self._collected: list[bool] = []  # whether garbage was collected before each compilation that has not ended
        self._interrupts = _Interrupts()

    def on_start(self, event: event.Event) -> None:
        """Report the first compilation; put off garbage collection and Ctrl-C. Cached code does not come here."""
        self._collected.append(gc.isenabled())
        self._interrupts.put_off()
        if not event.data["dispatcher"].py_func.__module__.startswith(__package__):
            return
        gc.disable()
        if not self._is_said:
            self._is_said = True
            logging.getLogger(__name__).warning(_COMPILING if IS_TESTED else _COMPILING_SLOWLY)

    def on_end(self, event: event.Event) -> None:  # noqa: ARG002 - as numba calls it
        """Enable garbage collection if it was enabled before the compilation that ends, and raise what was put off."""
        if self._collected.pop():
            gc.enable()
        self._interrupts.raise_if_any()


event.register("numba:compile", _Compilation())  # type: ignore[no-untyped-call]


def keep_code_in(folder: Path) -> None:
    """Let numba keep machine code in a folder from now on, and copy there what it has kept so far.

    It is for a process that is about to lose its right to write anywhere else. Numba raises an error if it cannot write
    to the folder that it has found.
    """
    global _code_folder  # noqa: PLW0603 - like numba, this module has one setting for all threads
    for kept in _code_folder.glob(f"*-{_TOOLS}-*"):
        with suppress(OSError):  # another process is changing it
            shutil.copytree(kept, folder / kept.name)
    os.environ["NUMBA_CACHE_DIR"] = numba.config.CACHE_DIR = str(folder)  # type: ignore[attr-defined]
    _code_folder = folder
    for made in _KERNELS:
        _enable_caching(made)


def _compile_and_keep(function: Function, options: Options) -> Function:
    """Compile a function, and let numba keep its code. What was kept for earlier sources of its module is deleted."""
    made = _njit(**_COMMON_OPTIONS, **options)(function)
    module = function.__module__
    if not _folder_of(module).exists():
        for stale in _code_folder.glob(f"{module}-{_TOOLS}-*"):
            shutil.rmtree(stale, ignore_errors=True)
    _enable_caching(made)
    _KERNELS.append(made)
    return cast("Function", made)


def _enable_caching(made: Any) -> None:
    """Let numba keep the code of a kernel in the folder for all that it depends on, or nowhere if it cannot write."""
    with _CACHE_DIR_LOCK:
        before = numba.config.CACHE_DIR  # type: ignore[attr-defined]
        numba.config.CACHE_DIR = str(_folder_of(made.__module__))  # type: ignore[attr-defined]
        try:
            with suppress(RuntimeError):  # numba finds no folder where it can write
                made.enable_caching()
        finally:
            numba.config.CACHE_DIR = before  # type: ignore[attr-defined]


def _folder_of(module: str) -> Path:
    return _code_folder / f"{module}-{_TOOLS}-{_digest(module)}"


def _tools() -> str:
    """Return a digest of the versions and settings of all that compiles: Python, numba, LLVM and NumPy."""
    settings = sorted(item for item in os.environ.items() if item[0].startswith("NUMBA_") and "CACHE" not in item[0])
    tools = (sys.version, numba.__version__, llvmlite.__version__, np.__version__, settings)
    return hashlib.sha256(repr(tools).encode()).hexdigest()[:8]


@cache
def _digest(module: str) -> str:
    """Return the digest of the sources and constants of a module and of those that it imports, recursively.

    Only modules of its own package and of this one count. They are loaded before a kernel is made. Constants count
    because numba compiles their values in, and some values come from other libraries.
    """
    reached = {module}
    waiting = [module]
    while waiting:
        new = _imported(waiting.pop()) - reached
        reached |= new
        waiting += new
    digest = hashlib.sha256()
    for name in sorted(reached):
        digest.update(f"{name} {_constants(name)}\n{_source(name)}".encode(errors="surrogateescape"))
    return digest.hexdigest()[:16]


@cache
def _imported(module: str) -> frozenset[str]:
    """Return the modules, of the same package or this one, that a module's source imports."""
    roots = {__package__, module.partition(".")[0]}
    found: set[str] = set()
    for name, *parts in _IMPORT.findall(_source(module)):
        if name.partition(".")[0] in roots:
            found |= {name, *(f"{name}.{part}" for part in re.findall(r"\w+", " ".join(parts)))}
    return frozenset(name for name in found if name in sys.modules)


@cache
def _source(module: str) -> str:
    file = getattr(sys.modules[module], "__file__", None)
    with suppress(OSError):  # the module is in an archive or a notebook
        return Path(file).read_text(encoding="utf-8", errors="surrogateescape") if file else ""
    return ""


def _constants(module: str) -> list[tuple[str, object]]:
    """Return the numbers among the global variables of a module, with those in tuples and arrays."""
    found = ((name, _numbers(value)) for name, value in sorted(vars(sys.modules[module]).items()))
    return [(name, numbers) for name, numbers in found if numbers is not None]


def _numbers(value: object) -> object:
    """Return a number, or the content of an array or tuple, to be hashed; None for any other value."""
    if isinstance(value, tuple):
        return tuple(map(_numbers, value))
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        return value.dtype.str, value.shape, value.tobytes()
    return value if isinstance(value, (int, float, complex, np.generic)) else None


def folder_for_code() -> Path:
    """Return the folder for machine code.

    It is the first one where this process can write: `NUMBA_CACHE_DIR` if that is set, beside the source, in the user's
    cache, or a temporary folder. If it can write nowhere, as in a container whose root is read-only, each process
    compiles again.
    """
    named = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    beside = _PACKAGE / "__pycache__"
    first = [Path(named) / _INSTALLATION] if named else []
    places = [*first, beside, user_cache_path() / _INSTALLATION]
    writable = next(filter(_is_writable, places), None)
    return writable or _own_temporary_folder() or beside


def _is_writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


def _own_temporary_folder() -> Path | None:
    """Return a folder that only this user can write, for the code of this installation; None if there is none.

    Numba executes what it finds in its cache, so the folder must not be another user's.
    """
    user = os.getuid() if hasattr(os, "getuid") else 0
    try:
        folder = Path(tempfile.gettempdir()) / f"{_INSTALLATION}-{user}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.stat(follow_symlinks=False)
    except OSError:
        return None
    is_ours = stat.S_ISDIR(found.st_mode) and found.st_uid == user and not found.st_mode & 0o077
    return folder if is_ours or not hasattr(os, "getuid") else None


# at the end, because they call the functions above
_code_folder = folder_for_code()  # where numba keeps machine code
_TOOLS: Final = _tools()
_CACHE_DIR_LOCK: Final = Lock()  # numba has one setting for all threads
_KERNELS: Final[list[Any]] = []  # those whose code is kept
