"""Options of numba's compiler that are numba's own affair: they make kernels fast, and kernels work without them.

Numba optimizes a function once more with every function that calls it, and makes machine code of it every time. With
these options, a function that only kernels call is a part of each of them, and optimized with it alone. Numba also
counts references to arrays at every call, which a kernel that neither creates nor returns an array does not need.

With any other version of numba than the tested ones, there are no such options. The results are the same then, but the
first compilation of an environment takes four times as long, and a step takes up to ten times as long.
"""

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, Final

import numba

Options = Mapping[str, object]

TESTED: Final = ("0.68.",)  # versions of numba
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


_UNCALLED: Final = {"no_cfunc_wrapper": True}  # C calls no kernels
WHOLE: Final[Options] = {"pipeline_class": _WholeCompiler, **_UNCALLED} if IS_TESTED else {}
IN_PLACE: Final[Options] = {"_nrt": False, **WHOLE} if IS_TESTED else {}
INNER: Final[Options] = {**IN_PLACE, "pipeline_class": _PartCompiler, "no_cpython_wrapper": True} if IS_TESTED else {}
