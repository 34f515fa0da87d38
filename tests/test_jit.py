"""Machine code that is kept is dropped when what it was made from changes; making it is announced."""

import ast
import gc
import os
import pickle
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import get_args, get_origin

import numba
import numpy as np
import pytest
from numba.core import event
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError
from numpy.typing import NDArray

from behavexplor import errors
from behavexplor import jit as compiled
from behavexplor.ads.rule.control import LateralProfile
from behavexplor.ads.rule.station_time import StationTime
from behavexplor.behavior.features import fill_statistics

ERRORS = Path(errors.__file__).read_text()
SOURCES = {
    "__init__.py": "",
    "constants.py": "LIMIT = 1.0\n",
    "other.py": "UNUSED = 1\n",
    "parts/__init__.py": "",
    "parts/inner.py": """
from behavexplor.constants import LIMIT
from behavexplor.jit import kernel_inner


@kernel_inner
def limited(x):
    return min(x, LIMIT)
""",
    "parts/outer.py": """
from behavexplor.jit import kernel
from behavexplor.parts import (
    inner,
)

limited = inner.limited


@kernel
def twice(x):
    return 2.0 * limited(x)
""",
    "parts/alone.py": """
import behavexplor.other
from behavexplor.jit import kernel_in_place


@kernel_in_place
def half(x):
    return 0.5 * x
""",
}
CALLS = """
from behavexplor.parts.alone import half
from behavexplor.parts.outer import twice
print(twice(9.0), half(9.0), *(sum(function.stats.cache_hits.values()) for function in (twice, half)))
"""
KEPT, LIMIT_IS_2 = "2.0 4.5 1 1", ("constants.py", "LIMIT = 2.0\n")
PART_ADDS_1 = ("parts/inner.py", SOURCES["parts/inner.py"].replace("min(x", "1.0 + min(x"))


def installed(folder, *changes):
    """An installation with three modules of kernels, and with changes of its sources, which have the same times."""
    sources = {**SOURCES, "jit.py": Path(compiled.__file__).read_text(), "errors.py": ERRORS, **dict(changes)}
    for name, text in sources.items():
        file = folder / "behavexplor" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        os.utime(file, ns=(10**18, 10**18))  # as an installer may do
    return folder


def computed(folder, code=CALLS, **environment):
    """What the kernels return, and how many of them were kept by an earlier process."""
    environment = {**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1", **environment}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=folder, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


def place(kind, folder):
    """The environment variables with which numba keeps code in a certain place, for an installation in a folder."""
    own = folder.parent / kind
    if kind == "beside the source":
        return {}
    if kind == "NUMBA_CACHE_DIR":
        return {"NUMBA_CACHE_DIR": str(own)}
    (folder / "behavexplor" / "__pycache__").write_text("no folder can be made here, not even by root")
    if kind == "the cache of the user":
        return {"XDG_CACHE_HOME": str(own), "HOME": str(own)}
    own.mkdir()
    (own / "file").touch()
    return {"XDG_CACHE_HOME": str(own / "file"), "HOME": str(own / "file"), "TMPDIR": str(own)}


@pytest.mark.parametrize(
    "kind", ["beside the source", "NUMBA_CACHE_DIR", "the cache of the user", "a temporary folder"]
)
def test_code_is_kept_for_as_long_as_what_it_depends_on_is_the_same(kind, tmp_path):
    folder = installed(tmp_path / "package")
    environment = place(kind, folder)
    found = folder if kind == "beside the source" else tmp_path / kind
    assert computed(folder, **environment) == "2.0 4.5 0 0"
    kept = set(found.rglob("*.nbi"))
    assert len(kept) == 2
    assert computed(installed(folder, LIMIT_IS_2), **environment) == "4.0 4.5 0 1"
    assert computed(installed(folder, LIMIT_IS_2, PART_ADDS_1), **environment) == "6.0 4.5 0 1"
    assert len(set(found.rglob("*.nbi"))) == 2  # what cannot be used any more is deleted
    assert len(kept & set(found.rglob("*.nbi"))) == 1


def test_a_constant_that_comes_from_elsewhere_is_noticed(tmp_path):
    """As those that kernels take from classes of highway-env."""
    folder = installed(tmp_path, ("constants.py", "import os\n\nLIMIT = float(os.environ['GIVEN'])\n"))
    assert computed(folder, GIVEN="1.0") == "2.0 4.5 0 0"
    assert computed(folder, GIVEN="2.0") == "4.0 4.5 0 1"


def test_a_change_that_no_kernel_depends_on_and_a_new_time_drop_nothing(tmp_path):
    folder = installed(tmp_path)
    assert computed(folder) == "2.0 4.5 0 0"
    installed(folder, ("unrelated.py", "NEW = 1\n"))
    os.utime(folder / "behavexplor" / "constants.py", ns=(1, 1))
    assert computed(folder) == KEPT
    assert computed(installed(folder, ("other.py", "UNUSED = 2\n"))) == "2.0 4.5 1 0"  # one imports it


def test_two_installations_share_a_folder_and_no_code(tmp_path):
    """Their kernels have the same names, in modules of the same names."""
    environment = {"NUMBA_CACHE_DIR": str(tmp_path / "code")}
    first, second = installed(tmp_path / "first"), installed(tmp_path / "second", LIMIT_IS_2)
    assert computed(first, **environment) == "2.0 4.5 0 0"
    assert computed(second, **environment) == "4.0 4.5 0 0"
    assert computed(first, **environment) == KEPT


def test_kernels_are_compiled_by_any_other_version_of_numba_too(tmp_path):
    folder = installed(tmp_path)
    other = 'import numba\nnumba.__version__ = "99.0"\n'
    options = "from behavexplor.jit import IN_PLACE, INNER, WHOLE\nprint(IN_PLACE, INNER, WHOLE)\n"
    assert computed(folder, code=other + options + CALLS) == "{} {} {}\n2.0 4.5 0 0"
    assert computed(folder, code=other + CALLS) == KEPT
    assert computed(folder) == "2.0 4.5 0 0"  # what one version keeps is of no use to another


@pytest.mark.slow
def test_any_other_version_of_numba_computes_the_same(tmp_path):
    def campaign(version):
        run = tmp_path / version
        code = f"""
import numba
numba.__version__ = "{version}"
from behavexplor.commands import main
main("fuzz --env highway-fast-v0 --ads careful --budget 3 --workers 0 --out {run}".split())
"""
        subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, check=True)
        with closing(sqlite3.connect(run / "campaign.db")) as database:
            return database.execute("SELECT record, trace FROM executions").fetchall()

    executions = campaign("99.0")
    assert len(executions) == 3
    assert executions == campaign(numba.__version__)


def test_code_of_another_compiler_or_other_settings_is_not_used(tmp_path, monkeypatch):
    tools = {compiled._tools()}
    for library in (compiled.numba, compiled.llvmlite, compiled.np):
        with monkeypatch.context() as patch:
            patch.setattr(library, "__version__", "0")
            tools.add(compiled._tools())
    monkeypatch.setenv("NUMBA_BOUNDSCHECK", "1")
    tools.add(compiled._tools())
    assert len(tools) == 5
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))  # says where, and not what
    assert compiled._tools() in tools


def test_code_of_other_libraries_stays_where_numba_keeps_it():
    assert os.environ.get("NUMBA_CACHE_DIR", "") == numba.config.CACHE_DIR


def modules_with_kernels():
    for path in sorted(compiled._PACKAGE.rglob("*.py")):
        if "\n@kernel" in path.read_text():
            yield import_module(".".join(path.relative_to(compiled._PACKAGE.parent).with_suffix("").parts))


def test_every_module_with_kernels_is_known_with_all_that_it_imports():
    """As Python itself reads the imports."""
    for module in modules_with_kernels():
        expected = set()
        for node in ast.walk(ast.parse(Path(module.__file__).read_text())):
            if isinstance(node, ast.ImportFrom) and node.module.startswith("behavexplor"):
                expected |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        assert compiled._imported(module.__name__) == expected & sys.modules.keys()


def test_a_kernel_computes_what_its_python_source_says():
    @compiled.kernel
    def mean_of_positive(values):
        total, count = 0.0, 0
        for value in values:
            if value > 0.0:
                total += value
                count += 1
        return total / count

    values = np.random.default_rng(0).normal(size=50)
    assert mean_of_positive(values) == mean_of_positive.py_func(values)
    assert np.isnan(mean_of_positive(np.array([-1.0])))  # as numpy divides, where Python raises


def test_a_kernel_in_place_counts_no_references_and_makes_no_array():
    @compiled.kernel_in_place
    def move(values, by):
        for i in range(len(values)):
            values[i] += by

    @compiled.kernel_in_place
    def moved(values, by):
        return (values + by).sum()

    values = np.arange(5.0)
    before = sys.getrefcount(values)
    move(values, 2.0)
    assert values.tolist() == [2.0, 3.0, 4.0, 5.0, 6.0]
    assert sys.getrefcount(values) == before
    move.recompile()  # what comes from the cache cannot be inspected
    (assembly,) = move.inspect_asm().values()
    assert "NRT_incref" not in assembly
    with pytest.raises(NumbaError, match="NRT required"):
        moved(values, 2.0)


def test_inner_kernels_serve_other_kernels_only():
    @compiled.kernel_inner
    def twice(value):
        return 2 * value

    @compiled.kernel_in_place
    def add(value):
        return twice(value) + twice(1.0)

    assert add(2.0) == 6.0


def test_a_kernel_compiled_for_some_types_does_the_same_for_other_values():
    @compiled.kernel_in_place
    def move(values, by):
        for i in range(len(values)):
            values[i] += by

    values, others = np.arange(3.0), np.arange(5.0)
    machine_code = compiled.compiled_for(move, values, 2.0)
    machine_code(values, 2.0)
    machine_code(others, 1.0)
    assert values.tolist() == [2.0, 3.0, 4.0]
    assert others.tolist() == [1.0, 2.0, 3.0, 4.0, 5.0]
    assert len(move.signatures) == 1


def test_what_holds_machine_code_can_be_pickled():
    values = np.arange(6.0).reshape(2, 3)  # two attributes, and so two windows of 16 features
    code = compiled.compiled_for(fill_statistics, values, 2, 0.1, np.zeros((2, 16)))
    results = [np.zeros((2, 16)), np.zeros((2, 16))]
    for again, result in zip((code, pickle.loads(pickle.dumps(code))), results, strict=True):
        again(values, 2, 0.1, result)
    assert results[0].any()
    assert np.array_equal(*results)


def holds_arrays(annotation):
    fields = getattr(annotation, "__annotations__", None) or dict(enumerate(get_args(annotation)))
    return get_origin(annotation) in (np.ndarray, NDArray) or any(map(holds_arrays, fields.values()))


def test_no_kernel_in_place_returns_an_array_whose_reference_nobody_counts():
    assert holds_arrays(tuple[float, StationTime])
    assert not holds_arrays(tuple[int, LateralProfile])
    found = 0
    for module in modules_with_kernels():
        for function in vars(module).values():
            if isinstance(function, Dispatcher) and not function.targetoptions.get("_nrt", True):
                found += 1
                assert not holds_arrays(function.py_func.__annotations__["return"]), function
    assert found > 50


def compiling(module):
    function = SimpleNamespace(py_func=SimpleNamespace(__module__=module))
    return SimpleNamespace(data={"dispatcher": function})


def test_compiling_is_announced_once_and_only_ours(caplog):
    notice = compiled._Compilation()
    notice.on_start(compiling("elsewhere.kernels"))
    notice.on_end(compiling("elsewhere.kernels"))
    assert caplog.messages == []
    for module in ("behavexplor.data.npc_motion", "behavexplor.envs.tasks.scripted_step"):
        notice.on_start(compiling(module))
        assert [record.name for record in caplog.records] == ["behavexplor.jit"]
        notice.on_end(compiling(module))
    assert caplog.messages[0].startswith("Compiling to machine code")


@pytest.mark.parametrize("collects", [True, False])
def test_garbage_is_not_collected_while_compiling_and_then_as_before(collects):
    listener, before = compiled._Compilation(), gc.isenabled()
    outer, inner = compiling("behavexplor.data.npc_motion"), compiling("elsewhere.inner")
    try:
        (gc.enable if collects else gc.disable)()
        listener.on_start(inner)
        assert gc.isenabled() == collects  # others compile as they like
        listener.on_end(inner)
        listener.on_start(outer)
        listener.on_start(inner)
        listener.on_end(inner)
        assert not gc.isenabled()
        listener.on_end(outer)
        assert gc.isenabled() == collects
    finally:
        (gc.enable if before else gc.disable)()


FIRST_USE = """
from behavexplor.data.npc_motion import fill_phases
import numpy as np
fill_phases(np.ones((2, 2)), np.zeros((3, 4)))
"""


def test_a_first_run_is_no_silent_wait(tmp_path):
    """Without any configuration of logging, and not again when the machine code is there."""
    said = [
        subprocess.run(
            [sys.executable, "-c", FIRST_USE],
            env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        )
        for _ in range(2)
    ]
    assert said[0].stderr.startswith("Compiling to machine code")
    assert said[0].stderr.count("\n") == 1
    assert (said[0].stdout, said[1].stdout, said[1].stderr) == ("", "", "")


class Interrupter(event.Listener):
    """Presses Ctrl-C when a compilation has begun."""

    def on_start(self, event):
        if not self.pressed:
            self.pressed = True
            signal.raise_signal(signal.SIGINT)

    def on_end(self, event):
        pass

    pressed = False


def test_control_c_ends_a_program_once_the_kernel_is_compiled():
    """LLVM's callbacks would lose it, or the compilation end in another error."""

    @compiled.kernel
    def doubled(x):
        return 2.0 * x

    interrupter = Interrupter()
    with event.install_listener("numba:compile", interrupter), pytest.raises(KeyboardInterrupt):
        doubled(1.0)
    assert interrupter.pressed
    assert doubled.signatures
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert doubled(2.0) == 4.0
