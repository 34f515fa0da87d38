"""What two machines must agree in to give the same results."""

import json
import socket

import numpy as np
import pytest

from behavexplor.execution.fingerprint import difference, fingerprint, machine_fingerprint
from tests.drivers import cruiser


def test_an_identity_says_whose_it_is_and_what_results_go_through():
    found = json.loads(fingerprint(b'["constant"]'))
    assert found["node"] == socket.gethostname()
    assert found["numpy"] == np.__version__
    assert len(found["behavexplor"]) == 16
    assert difference(fingerprint(b'["constant"]'), fingerprint(b'["rule:hardened"]')) is None


def test_a_library_that_only_one_of_them_has_loaded_is_no_difference():
    theirs = {"node": "far", "torch": "2.10", "numpy": "2.1"}
    assert difference(json.dumps(theirs).encode(), json.dumps({"node": "here", "numpy": "2.1"}).encode()) is None
    said = difference(json.dumps(theirs).encode(), json.dumps({"node": "here", "numpy": "2.2"}).encode())
    assert said.startswith("The node far has a different numpy (2.1) than this machine (2.2)")


def renamed(model):
    (model / "weights").rename(model / "others")


def overwritten(model):
    (model / "weights").write_bytes(b"2")


def extended(model):
    (model / "more").write_bytes(b"1")


@pytest.mark.parametrize("change", [renamed, overwritten, extended])
def test_the_files_of_an_ads_are_part_of_it(tmp_path, change):
    model = tmp_path / "model"
    model.mkdir()
    (model / "weights").write_bytes(b"1")
    name = str(model)
    before = fingerprint(json.dumps([name]).encode())
    assert difference(before, fingerprint(json.dumps([name]).encode())) is None
    change(model)
    assert f"has a different {model}" in difference(before, fingerprint(json.dumps([name]).encode()))


def test_the_module_of_an_ads_is_part_of_it():
    assert cruiser.vectorized
    assert "file of tests.drivers" in json.loads(fingerprint(b'["tests.drivers:cruiser"]'))
    assert not {"file of constant", "file of rule"} & json.loads(fingerprint(b'["rule:hardened"]')).keys()


def test_a_machine_names_all_that_it_has_and_loads_nothing(tmp_path, monkeypatch):
    package = tmp_path / "strange"
    package.mkdir()
    (package / "__init__.py").write_text("raise SystemExit")
    (package / "driver.py").write_text("raise SystemExit")
    monkeypatch.syspath_prepend(str(tmp_path))
    found = json.loads(machine_fingerprint(["strange.driver:driver"]))
    assert {"numba", "scipy", "gymnasium"} <= set(found)
    assert "file of strange.driver" in found
    (package / "driver.py").write_text("raise KeyboardInterrupt")
    assert machine_fingerprint(["strange.driver:driver"]) != json.dumps(found).encode()
    assert "file of absent" not in json.loads(machine_fingerprint(["absent:driver"]))


def test_a_process_that_has_loaded_the_ads_is_like_its_machine():
    name = "tests.drivers:cruiser"
    assert cruiser is not None
    assert difference(fingerprint(json.dumps([name]).encode()), machine_fingerprint([name])) is None
