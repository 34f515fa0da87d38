"""Traces: validated, read-only, and restored exactly from their files."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from behavexplor.errors import InputError
from behavexplor.trace import Trace
from tests.strategies import random_trace, seeds

TRACE = random_trace(0)


@given(seeds, st.integers(1, 12), st.integers(0, 3), st.integers(0, 6))
def test_bytes_restore_exactly(seed, frames, npcs, decisions):
    trace = random_trace(seed, frames, npcs, decisions)
    restored = Trace.from_bytes(trace.to_bytes())
    for name in ("time", "position", "heading", "velocity", "size", "actions", "action_frame", "route", "destination"):
        assert np.array_equal(getattr(restored, name), getattr(trace, name)), name
    assert restored.end == trace.end
    assert np.array_equal(restored.decisions["code"], trace.decisions["code"])
    assert restored.to_bytes() == trace.to_bytes()


def test_file_restores_exactly(tmp_path):
    TRACE.save(tmp_path / "trace.npz")
    assert Trace.load(tmp_path / "trace.npz").to_bytes() == TRACE.to_bytes()


def test_motion_is_recorded_to_a_nanometre():
    precise = replace(TRACE, position=TRACE.position + 0.4e-9)
    assert np.array_equal(precise.position, TRACE.position)
    assert not np.array_equal(replace(TRACE, position=TRACE.position + 1e-9).position, TRACE.position)


def test_arrays_are_read_only_copies():
    mine = np.array(TRACE.position)
    trace = replace(TRACE, position=mine)
    mine[:] = 0
    assert trace.position.any()
    with pytest.raises(ValueError, match="read-only"):
        trace.position[0, 0, 0] = 1.0
    with pytest.raises(TypeError):
        trace.decisions["code"] = np.zeros(3)


def test_acceleration_is_the_change_of_velocity():
    trace = replace(
        TRACE, velocity=np.broadcast_to(TRACE.time[:, None, None] * np.array([3.0, -2.0]), TRACE.velocity.shape)
    )
    assert trace.acceleration.shape == (len(TRACE.time) - 1, 4, 2)
    assert trace.acceleration == pytest.approx(np.broadcast_to([3.0, -2.0], trace.acceleration.shape), abs=1e-6)


def test_destination_distance_is_the_last_one():
    position = np.array(TRACE.position)
    position[-1, 0] = TRACE.destination + (3.0, 4.0)
    assert replace(TRACE, position=position).destination_distance == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("time", np.arange(19) * 0.05),
        ("time", np.zeros(20)),
        ("time", 1 + np.arange(20.0)),
        ("position", np.zeros((20, 3, 2))),
        ("position", np.full((20, 4, 2), np.nan)),
        ("heading", np.zeros((20, 5))),
        ("velocity", np.full((20, 4, 2), np.inf)),
        ("size", np.zeros((4, 3))),
        ("actions", np.zeros((9, 2))),
        ("action_frame", np.full(10, 20)),
        ("action_frame", np.full(10, -1)),
        ("route", np.zeros((1, 2))),
        ("destination", np.zeros(3)),
        ("illegal_lines", np.zeros((2, 2))),
        ("end", "exploded"),
    ],
)
def test_a_wrong_field_is_named(field, value):
    with pytest.raises(InputError) as error:
        replace(TRACE, **{field: value})
    assert field in str(error.value) or (field == "time" and "position" in str(error.value))


def test_a_decision_log_of_another_length_is_named():
    with pytest.raises(InputError, match="code"):
        replace(TRACE, decisions={"code": np.zeros(11)})


@given(st.integers(0, 10**6), st.binary(min_size=1, max_size=3))
def test_damaged_bytes_are_refused_or_read(place, noise):
    data = bytearray(TRACE.to_bytes())
    place %= len(data)
    data[place : place + len(noise)] = noise
    try:
        Trace.from_bytes(bytes(data))
    except InputError as error:
        assert "\n" not in str(error)


@pytest.mark.parametrize("data", [b"", b"PK", b"not a trace", TRACE.to_bytes()[:1000]])
def test_what_is_no_trace_is_refused(data):
    with pytest.raises(InputError, match="trace"):
        Trace.from_bytes(data)


def test_nothing_is_unpickled(tmp_path):
    path = tmp_path / "evil.npz"
    np.savez(path, time=np.array([object()], dtype=object))
    with pytest.raises(InputError):
        Trace.load(path)


def test_traces_are_copied_and_sent_to_other_processes():
    """As vector environments do with what `info` holds."""
    assert copy.deepcopy({"trace": TRACE})["trace"] is TRACE
    assert pickle.loads(pickle.dumps(TRACE)).to_bytes() == TRACE.to_bytes()
