"""The installed highway-env is the one that the engine was ported from, and a change would be noticed."""

import json

import pytest

from behavexplor.envs.stock import source_gate
from behavexplor.envs.stock.source_gate import changed_sources, ported_digests, present_digests


def test_highway_env_is_the_one_that_was_ported():
    present = json.dumps(present_digests(ported_digests()), indent=1)
    assert not changed_sources(), f"compare these with the port, then update source_digests.json: {present}"


@pytest.fixture
def gate(tmp_path, monkeypatch):
    """The gate with digests that a test may change."""
    path = tmp_path / "digests.json"
    monkeypatch.setattr(source_gate, "_PORTED", path)
    changed_sources.cache_clear()
    yield path
    changed_sources.cache_clear()


def test_a_changed_function_and_a_changed_constant_are_named(gate):
    digests = ported_digests_of_package()
    digests["highway_env.vehicle.behavior"]["IDMVehicle.mobil"] = "0" * 16
    digests["highway_env.road.lane"]["AbstractLane.VEHICLE_LENGTH"] = "0" * 16
    gate.write_text(json.dumps(digests))
    assert set(changed_sources()) == {"behavior.IDMVehicle.mobil", "lane.AbstractLane.VEHICLE_LENGTH"}


def test_what_a_release_no_longer_has_is_named(gate):
    gate.write_text(json.dumps({"highway_env.road.lane": {"StraightLane.gone": "0"}, "highway_env.gone": {"f": "0"}}))
    assert changed_sources() == ("lane.StraightLane.gone", "gone.f")


def ported_digests_of_package():
    return json.loads((source_gate.Path(source_gate.__file__).with_name("source_digests.json")).read_text())
