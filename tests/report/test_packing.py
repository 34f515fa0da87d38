"""Replays come out of the page as they went in, to the units in which they are packed."""

import base64
import zlib

import numpy as np
import pytest

from behavexplor.data.trace import Trace
from behavexplor.report.gallery import LENGTH_UNIT, MAX_FRAMES, SPEED_UNIT, TIME_UNIT, TURN, pack

HALF = 0.5 + 1e-6


def trace(time, position, heading, velocity=None):
    position = np.asarray(position, dtype=float)
    vehicles = position.shape[1]
    return Trace(
        time=time,
        position=position,
        heading=heading,
        velocity=np.zeros_like(position) if velocity is None else velocity,
        size=np.full((vehicles, 2), (4.7, 2.06)),
        actions=np.zeros((0, 1)),
        action_frame=np.zeros(0, dtype=np.int64),
        route=[[0.0, 0.0], [1.0, 0.0]],
        destination=[1.0, 0.0],
        illegal_lines=np.zeros((0, 2, 2)),
        end="timeout",
    )


def wandering(frames, vehicles=3, span=300.0, seed=0):
    rng = np.random.default_rng(seed)
    position = 1000 + rng.uniform(-span / 2, span / 2, (frames, vehicles, 2))
    heading = np.cumsum(rng.uniform(-3, 3, (frames, vehicles)), axis=0)
    velocity = rng.uniform(-40, 40, (frames, vehicles, 2))
    return trace(np.arange(frames) * 0.05, position, heading, velocity)


def unpacked(packed):
    """What the page's script does, written another way: sums of differences modulo 2^16."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(packed.data)), dtype=np.uint8).reshape(2, -1)
    steps = (planes[0].astype(np.int64) | planes[1].astype(np.int64) << 8).reshape(-1, packed.frames)
    sums = np.cumsum(steps, axis=1)
    signed = (sums + 2**15) % 2**16 - 2**15
    motion = signed[2:].reshape(packed.vehicles, 3, -1)
    position = motion[:, :2] * packed.unit + np.array(packed.middle)[None, :, None]
    return sums[0] * TIME_UNIT, signed[1] * SPEED_UNIT, position.transpose(2, 0, 1), motion[:, 2].T * TURN


@pytest.mark.parametrize("frames", [1, 2, 3, 400])
def test_motion_is_kept_to_half_a_unit(frames):
    given = wandering(frames)
    packed = pack(given, frames - 1)
    time, speed, position, heading = unpacked(packed)
    assert np.abs(time - given.time[packed.kept]).max() <= HALF * TIME_UNIT
    assert np.abs(speed - np.hypot(*given.velocity[packed.kept, 0].T)).max() <= HALF * SPEED_UNIT
    assert np.abs(position - given.position[packed.kept]).max() <= HALF * LENGTH_UNIT
    turned = heading - given.heading[packed.kept]
    assert np.abs(turned - 2 * np.pi * np.rint(turned / (2 * np.pi))).max() <= HALF * TURN


def test_a_wide_replay_has_a_coarser_unit_and_is_still_right():
    given = wandering(50, span=5000.0)
    packed = pack(given, 0)
    assert LENGTH_UNIT < packed.unit < 0.1
    assert np.abs(unpacked(packed)[2] - given.position[packed.kept]).max() <= HALF * packed.unit


def test_a_run_of_many_minutes_keeps_its_time():
    """Its time does not fit into 16 bits, its frames lie farther apart, and there are not too many of them."""
    frames = 20_000
    still = np.zeros((frames, 1, 2))
    given = trace(np.arange(frames) * 0.05, still, np.zeros((frames, 1)))
    packed = pack(given, 12_345)
    time = unpacked(packed)[0]
    assert time[-1] == pytest.approx(given.duration)
    assert len(time) <= MAX_FRAMES + 2
    assert (np.diff(time) > 0).all()


@pytest.mark.parametrize("frame", [0, 1, 7, 199])
def test_the_frame_that_is_asked_for_and_the_last_are_kept(frame):
    packed = pack(wandering(200), frame)
    assert {frame, 199} <= set(packed.kept.tolist())
    assert packed.frames == len(packed.kept)
    assert len(packed.kept) <= 102  # every second one


def test_a_hundred_replays_take_less_than_a_megabyte():
    """Of 200 frames and five vehicles that drive as vehicles do: with changing accelerations and turns."""
    rng = np.random.default_rng(1)
    time = np.arange(200) * 0.1
    size = 0
    for _ in range(100):
        speed = 8 + np.cumsum(rng.normal(0, 0.2, (200, 5)), axis=0)
        heading = np.cumsum(rng.normal(0, 0.01, (200, 5)), axis=0)
        velocity = speed[..., None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        given = trace(time, np.cumsum(velocity * 0.1, axis=0), heading, velocity)
        size += len(pack(given, 0).data)
    assert size < 1_000_000


def test_equal_traces_give_equal_bytes():
    assert pack(wandering(100), 3).data == pack(wandering(100), 3).data
