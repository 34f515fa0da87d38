"""Checked imports run exactly the bytes that were checked, even if a file has changed since."""

import os
import py_compile
import sys
from importlib import import_module

import pytest

from behavexplor.errors import InputError
from behavexplor.execution.checked_imports import digests_of, import_checked, source_files

VALUE = "value = {}\n"


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package with a module, which can be imported, and nothing of them stays."""
    folder = tmp_path / "checked_package"
    folder.mkdir()
    (folder / "__init__.py").write_text("from checked_package.part import value\n")
    (folder / "part.py").write_text(VALUE.format(1))
    (folder / "other.py").write_text(VALUE.format(2))
    monkeypatch.syspath_prepend(tmp_path)
    yield folder
    forget(folder)


def forget(package):
    for name in [name for name in sys.modules if name.partition(".")[0] == package.name]:
        del sys.modules[name]


def test_a_module_has_its_file_and_those_of_its_packages(package):
    names = ["checked_package", "checked_package.part"]
    assert source_files("checked_package.part") == {names[0]: package / "__init__.py", names[1]: package / "part.py"}
    assert list(digests_of(["checked_package.part", "checked_package"])) == names
    assert source_files("checked_package.nothing") == {names[0]: package / "__init__.py"}
    for name in ("no_such_package.part", "sys", "", "checked_package."):
        assert source_files(name) == {}
    assert "checked_package" not in sys.modules


def test_what_was_checked_is_imported(package):
    before = list(sys.meta_path)
    import_checked(digests_of(["checked_package.part"]))
    assert sys.modules["checked_package"].value == sys.modules["checked_package.part"].value == 1
    assert sys.meta_path == before
    from checked_package import other  # noqa: PLC0415 - what is not listed is imported as usual

    assert other.value == 2


@pytest.mark.parametrize("name", ["__init__.py", "part.py"])
def test_a_file_that_has_changed_since_is_not_run(package, name):
    digests = digests_of(["checked_package.part"])
    (package / name).write_text("raise SystemExit\n")
    with pytest.raises(InputError, match=f"{name} has changed since it was checked, so it was not run"):
        import_checked(digests)
    assert not [finder for finder in sys.meta_path if "Checking" in type(finder).__name__]


def test_compiled_code_that_was_planted_beside_a_source_is_not_run(package):
    """It has the time and size of that source, so that Python takes it."""
    part = package / "part.py"
    times = part.stat().st_atime_ns, part.stat().st_mtime_ns
    part.write_text(VALUE.format(7))
    os.utime(part, ns=times)
    py_compile.compile(str(part))
    part.write_text(VALUE.format(1))
    os.utime(part, ns=times)
    assert import_module("checked_package.part").value == 7
    forget(package)
    import_checked(digests_of(["checked_package.part"]))
    assert sys.modules["checked_package.part"].value == 1


def test_a_module_that_cannot_be_imported_is_named(package):
    (package / "part.py").write_text("1 / 0\n")
    with pytest.raises(InputError, match=r"The module checked_package cannot be imported: ZeroDivisionError: division"):
        import_checked(digests_of(["checked_package.part"]))
    digests = digests_of(["checked_package.part"])
    (package / "part.py").unlink()
    with pytest.raises(InputError, match=r"No module named 'checked_package\.part'"):
        import_checked(digests)
