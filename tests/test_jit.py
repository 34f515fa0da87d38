"""Machine code that is kept is dropped when what it was made from changes; making it is announced."""

import ast
import os
import pickle
import subprocess
import sys
from importlib import import_module
from types import SimpleNamespace
from typing import get_args, get_origin

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError

from behavexplor import jit as compiled
from behavexplor.ads.rule.lateral import LateralProfile
from behavexplor.ads.rule.station_time import StationTime
from behavexplor.behavior.window_statistics import fill_statistics

SOURCES = {
    "constants.py": "LIMIT = 1\n",
    "other.py": "UNUSED = 1\n",
    "rooms/first.py": "from behavexplor.constants import LIMIT\n\n\n@kernel\ndef f(x): ...\n",
    "rooms/second.py": "from behavexplor.rooms import (\n    first,\n)\n\n\n@kernel\ndef g(x): ...\n",
    "rooms/third.py": "import behavexplor.other\n\n\n@kernel\ndef h(x): ...\n",
    "rooms/fourth.py": (
        "from behavexplor.rooms import third  # one\nfrom behavexplor.constants import (\n    LIMIT,\n)\n"
        "from behavexplor.other import UNUSED as U\n\n\n@kernel\ndef i(x): ...\n"
    ),
}
KERNELS = ("first.f", "second.g", "third.h", "fourth.i")


def put(package, sources):
    compiled._source.cache_clear()
    for name, text in sources.items():
        (package / name).parent.mkdir(parents=True, exist_ok=True)
        (package / name).write_text(text)


def compile_all(package):
    folder = package / "rooms" / "__pycache__"
    folder.mkdir(exist_ok=True)
    for name in KERNELS:
        (folder / f"{name}-1.py311.nbi").touch()


def kept(package):
    return {path.name.removesuffix("-1.py311.nbi") for path in (package / "rooms/__pycache__").glob("*.nbi")}


@pytest.fixture
def package(tmp_path):
    package = tmp_path / "behavexplor"
    put(package, SOURCES)
    compiled.drop_stale_code(package, package)
    compile_all(package)
    yield package
    compiled._source.cache_clear()


def test_nothing_is_dropped_while_nothing_changes(package):
    compiled.drop_stale_code(package, package)
    assert kept(package) == set(KERNELS)


@pytest.mark.parametrize(
    ("changed", "left"),
    [
        ("rooms/first.py", {"third.h", "fourth.i"}),
        ("constants.py", {"third.h"}),
        ("rooms/second.py", {"first.f", "third.h", "fourth.i"}),
        ("rooms/third.py", {"first.f", "second.g"}),
        ("other.py", {"first.f", "second.g"}),
    ],
)
def test_a_change_drops_the_kernels_that_rest_on_it(package, changed, left):
    put(package, {changed: SOURCES[changed] + "NEW = 2\n"})
    compiled.drop_stale_code(package, package)
    assert kept(package) == left


def test_sources_are_not_read_again_while_no_file_has_changed(package, monkeypatch):
    monkeypatch.setattr(compiled, "_source", lambda _: pytest.fail("a source was read"))
    compiled.drop_stale_code(package, package)
    assert kept(package) == set(KERNELS)


def test_a_link_to_nothing_is_no_module(package):
    """Some editors mark a file that is open by such a link."""
    (package / "rooms/.#first.py").symlink_to("nowhere")
    put(package, {"constants.py": SOURCES["constants.py"] + "NEW = 2\n"})
    compiled.drop_stale_code(package, package)
    assert kept(package) == {"third.h"}


def test_another_content_of_the_same_size_and_time_is_noticed(package):
    file = package / "constants.py"
    before = file.stat()
    put(package, {"constants.py": "LIMIT = 2\n"})
    os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert file.stat().st_size == before.st_size
    compiled.drop_stale_code(package, package)
    assert kept(package) == {"third.h"}


def test_a_file_with_a_new_time_and_the_same_content_drops_nothing(package):
    os.utime(package / "constants.py", ns=(1, 1))
    compiled.drop_stale_code(package, package)
    assert kept(package) == set(KERNELS)


@pytest.mark.parametrize("text", ["", "[1", "[1, 2]", "null"])
def test_a_stamp_that_cannot_be_read_drops_everything(package, text):
    (package / "__pycache__/kernels.json").write_text(text)
    compiled.drop_stale_code(package, package)
    assert kept(package) == set()


def test_every_module_with_kernels_is_known_with_all_that_it_imports():
    """As Python itself reads the imports."""
    package = compiled._PACKAGE
    for path in compiled._modules_with_kernels(package):
        expected = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module.startswith("behavexplor"):
                names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
                files = {package.parent.joinpath(*name.split(".")).with_suffix(".py") for name in names}
                expected |= {file for file in files if file.is_file()}
        assert compiled._imported(path.read_text(), package) == expected


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
    return get_origin(annotation) is np.ndarray or any(map(holds_arrays, fields.values()))


def test_no_kernel_in_place_returns_an_array_whose_reference_nobody_counts():
    assert holds_arrays(tuple[float, StationTime])
    assert not holds_arrays(tuple[int, LateralProfile])
    names = [
        ".".join(path.relative_to(compiled._PACKAGE.parent).with_suffix("").parts)
        for path in compiled._modules_with_kernels(compiled._PACKAGE)
    ]
    found = 0
    for module in map(import_module, names):
        for function in vars(module).values():
            if isinstance(function, Dispatcher) and not function.targetoptions.get("_nrt", True):
                found += 1
                assert not holds_arrays(function.py_func.__annotations__["return"]), function
    assert found > 50


def compiling(module):
    function = SimpleNamespace(py_func=SimpleNamespace(__module__=module))
    return SimpleNamespace(data={"dispatcher": function})


def test_compiling_is_announced_once_and_only_ours(caplog):
    notice = compiled._Notice()
    notice.on_start(compiling("elsewhere.kernels"))
    notice.on_end(compiling("elsewhere.kernels"))
    assert caplog.messages == []
    for module in ("behavexplor.data.npc_motion", "behavexplor.envs.vector.step"):
        notice.on_start(compiling(module))
        assert [record.name for record in caplog.records] == ["behavexplor.jit"]
    assert caplog.messages[0].startswith("Compiling to machine code")


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
