"""Traces: validated, read-only, and restored exactly from their files."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from behavexplor.data import trace as trace_module
from behavexplor.data.motion_bytes import MAX_UNPACKED, pack_arrays, unpack_arrays
from behavexplor.data.trace import MOST_PLACES, Trace
from behavexplor.data.untrusted import MAX_ARRAY_BYTES
from behavexplor.errors import InputError
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


def test_bytes_restore_a_trace_with_all_its_fields_exactly():
    assert Trace.from_bytes(TRACE.to_bytes()).to_bytes() == TRACE.to_bytes()


def test_motion_is_recorded_to_a_nanometer():
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
    with pytest.raises(InputError, match="code"):
        TRACE.with_decisions({"code": np.zeros(11)})


def test_another_decision_log_leaves_the_rest_of_a_trace_as_it_is():
    log = {"speed": np.arange(10.0), "code": np.ones((10, 2))}
    changed = TRACE.with_decisions(log)
    assert changed.to_bytes() == replace(TRACE, decisions=log).to_bytes() != TRACE.to_bytes()
    assert not changed.decisions["speed"].flags.writeable


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
        Trace.from_bytes(path.read_bytes())


def test_traces_are_copied_and_sent_to_other_processes():
    """As vector environments do with what `info` holds."""
    assert copy.deepcopy({"trace": TRACE})["trace"] is TRACE
    assert pickle.loads(pickle.dumps(TRACE)).to_bytes() == TRACE.to_bytes()


BYTES = TRACE.to_bytes()


def test_a_trace_cut_anywhere_is_refused():
    for length in range(0, len(BYTES), 50):
        with pytest.raises(InputError, match="Not a trace"):
            Trace.from_bytes(BYTES[:length])


WRONG_SHAPES = {
    "time": ((20, 1), (19,), ()),
    "position": ((20, 4), (20, 4, 3), (19, 4, 2), (20, 4, 2, 1)),
    "heading": ((20,), (4, 20), (20, 3)),
    "velocity": ((20, 4), (20, 3, 2), (21, 4, 2)),
    "size": ((4,), (5, 2), (4, 1), (4, 2, 1)),
    "actions": ((10,), (9, 2), (10, 2, 1)),
    "action_frame": ((9,), (10, 1), ()),
    "route": ((51,), (51, 3), (1, 2), (0, 2)),
    "destination": ((3,), (1, 2), ()),
    "illegal_lines": ((6, 4), (6, 2, 3), (2, 2)),
}
NAMES = {"time": "time|position|heading", "size": "size|position", "action_frame": "action_frame|actions"}


@pytest.mark.parametrize(
    ("field", "shape"), [(field, shape) for field, shapes in WRONG_SHAPES.items() for shape in shapes]
)
def test_every_wrong_shape_is_named(field, shape):
    with pytest.raises(InputError, match=NAMES.get(field, field)):
        replace(TRACE, **{field: np.zeros(shape)})


@pytest.mark.parametrize("field", [*WRONG_SHAPES, "decisions"])
@pytest.mark.parametrize("value", [np.nan, np.inf, "x", None, 1j, object()])
def test_every_value_that_is_no_finite_number_is_named(field, value):
    broken = np.full(np.shape(getattr(TRACE, field)) or (10,), value, dtype=object)
    with pytest.raises(InputError, match=field):
        replace(TRACE, **{field: {"code": broken} if field == "decisions" else broken})


@pytest.mark.parametrize("field", [*WRONG_SHAPES, "decisions"])
def test_ragged_lists_are_named(field):
    ragged = [[1.0], [2.0, 3.0]]
    with pytest.raises(InputError, match=field):
        replace(TRACE, **{field: {"code": ragged} if field == "decisions" else ragged})


@pytest.mark.parametrize("value", [[], 3, [("code", np.zeros(10))], "code"])
def test_decisions_are_a_mapping(value):
    with pytest.raises(InputError, match="decisions"):
        replace(TRACE, decisions=value)


@pytest.mark.parametrize("frames", [[0.5] * 10, np.linspace(0, 9.9, 10)])
def test_frames_are_whole_numbers(frames):
    with pytest.raises(InputError, match="action_frame"):
        replace(TRACE, action_frame=frames)


@pytest.mark.parametrize("field", ["end", "format", *WRONG_SHAPES])
def test_a_file_without_a_field_is_refused_by_its_name(field):
    values = unpack_arrays(BYTES)
    del values[field]
    with pytest.raises(InputError, match=f"{field} is missing"):
        Trace.from_bytes(pack_arrays(values))


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("format", np.array(4), "has format 4; this version reads format 3"),
        ("format", np.array(2), "has format 2; this version reads format 3"),
        ("format", np.ones(2), "this version reads format 3"),
        ("end", np.frombuffer(b"exploded", dtype=np.uint8), "end: expected one of"),
        ("end", np.array([200, 201], dtype=np.uint8), "end: expected one of"),
        ("position", np.zeros((8, 4, 2, 19), dtype=np.uint8), "wrong shape"),
        ("heading", np.zeros((8, 4, 20)), "wrong shape"),
        ("velocity", np.zeros((9, 4, 2, 20), dtype=np.uint8), "wrong shape"),
        ("velocity", np.zeros((0, 4, 2, 20), dtype=np.uint8), "wrong shape"),
        ("velocity", np.zeros(20, dtype=np.uint8), "wrong shape"),
        ("time", np.array(3.0), "Not a trace"),
    ],
)
def test_a_file_with_a_wrong_field_is_refused(field, value, message):
    with pytest.raises(InputError, match=message):
        Trace.from_bytes(pack_arrays(unpack_arrays(BYTES) | {field: value}))


def test_bytes_that_would_unpack_to_too_much_are_refused():
    packing = zstandard.ZstdCompressor().compressobj(size=MAX_UNPACKED + 1)
    bomb = packing.compress(bytes(9)) + packing.flush(zstandard.COMPRESSOBJ_FLUSH_BLOCK)
    with pytest.raises(InputError, match="unpacked size of 450000001 bytes"):
        Trace.from_bytes(bomb)


@pytest.mark.parametrize(
    ("frames", "vehicles", "changes", "words"),
    [
        (1_000_001, 1, {}, "at most 1,000,000 frames, not 1,000,001"),
        (60, 20, {}, "at most 1,000 vehicles times frames, not 1,200"),
        (2, 1, {"time": np.array([0.0, 1e6])}, "at most 100,000 seconds, not 1,000,000"),
        (2, 1, {"route": np.zeros((500_000, 2))}, "at most 200,000 points of the route, not 500,000"),
        (1000, 1, {"illegal_lines": np.zeros((100_001, 2, 2))}, "at most 100,000,000 illegal lines times frames"),
    ],
)
def test_a_trace_that_nothing_makes_is_refused(frames, vehicles, changes, words, monkeypatch):
    """Judging and drawing it would take minutes and gigabytes."""
    if vehicles > 1:
        monkeypatch.setattr(trace_module, "MOST_PLACES", 1000)  # so that this test takes no gigabyte
    arrays = {
        "time": np.arange(frames) * 0.05,
        "position": np.broadcast_to(0.0, (frames, vehicles, 2)),
        "heading": np.broadcast_to(0.0, (frames, vehicles)),
        "velocity": np.broadcast_to(0.0, (frames, vehicles, 2)),
        "size": np.ones((vehicles, 2)),
        "actions": np.zeros((1, 2)),
        "action_frame": np.zeros(1, dtype=int),
        "route": np.array([[0.0, 0.0], [1.0, 0.0]]),
        "destination": np.zeros(2),
        "illegal_lines": np.zeros((0, 2, 2)),
    }
    with pytest.raises(InputError, match=words):
        Trace(**{**arrays, **changes}, end="timeout")


def test_bytes_that_unpack_to_much_more_are_refused_before_they_do():
    small = unpack_arrays(random_trace(0).to_bytes())
    frames = small["time"].size
    standing = np.zeros((1, 2_000_000, 2, frames), dtype=np.uint8)  # packed, a few kilobytes
    with pytest.raises(InputError, match="its motion has 80000000 values, more than 20000000"):
        Trace.from_bytes(pack_arrays({**small, "position": standing}))
    log = np.zeros((len(small["action_frame"]), 3_000_000), dtype=np.uint8)
    with pytest.raises(InputError, match="would take more memory than those that are written"):
        Trace.from_bytes(pack_arrays({**small, "decisions.log": log}))


def test_the_largest_trace_can_be_read_again():
    """As it is with motion that needs all bytes of a number, which absent vehicles do."""
    values = 2 + 1 + 2  # of position, heading and velocity
    assert MOST_PLACES * (8 * values + 1) + MAX_ARRAY_BYTES // 8 < MAX_UNPACKED
