from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from behavexplor.behavior.features import (
    ATTRIBUTES,
    N_FEATURES,
    NEGLIGIBLE,
    STATISTICS,
    Clusters,
    known_states,
    merged_states,
    nearest_clusters,
    state_matrix,
)
from behavexplor.data.geometry import project_on_polyline
from tests.fakes import make_trace


@cache
def references():
    from tsfresh.feature_extraction import feature_calculators as tsfresh  # noqa: PLC0415 - it takes seconds

    return {
        "mean": tsfresh.mean,
        "variance": tsfresh.variance,
        "minimum": tsfresh.minimum,
        "maximum": tsfresh.maximum,
        "mean-change": lambda x: tsfresh.mean_change(x) if len(x) > 1 else 0.0,
        "mean-abs-change": lambda x: tsfresh.mean_abs_change(x) if len(x) > 1 else 0.0,
        "non-linearity": lambda x: tsfresh.c3(x, 1),
        "complexity": lambda x: tsfresh.cid_ce(x, normalize=True) if np.std(x) > 1e-3 else 0.0,
    }


def column(states, attribute):
    return states[:, ATTRIBUTES.index(attribute)]


def feature(merged, attribute, statistic):
    return merged[:, ATTRIBUTES.index(attribute) * len(STATISTICS) + STATISTICS.index(statistic)]


def circle(radius, speed, seconds, rate, start=0.0):
    """A steady right turn: heading grows."""
    time = np.arange(int(seconds * rate) + 1) / rate
    heading = start + speed / radius * time
    return time, np.stack([radius * np.sin(heading), -radius * np.cos(heading), heading], axis=1)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    rows=st.integers(1, 25),
    window=st.integers(1, 12),
    scale=st.sampled_from([0.01, 1.0, 30.0]),
    tail=st.sampled_from(["padded", "cut"]),
)
def test_statistics_equal_tsfresh(seed, rows, window, scale, tail):
    rng = np.random.default_rng(seed)
    states = rng.normal(rng.normal(0, 2, 8), scale, (rows, 8))
    states[:, 3] = 0.5  # a constant attribute; a number that a mean reproduces exactly
    merged = merged_states(states, window, tail)
    padded = np.concatenate([states, np.repeat(states[-1:], window, axis=0)])
    for i in {0, len(merged) // 2, len(merged) - 1}:
        expected = [references()[name](padded[i : i + window, a]) for a in range(8) for name in STATISTICS]
        assert merged[i] == pytest.approx(np.array(expected), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    ("rows", "window", "tail", "windows"),
    [(30, 10, "padded", 30), (30, 10, "cut", 21), (10, 10, "cut", 1), (4, 10, "cut", 1), (4, 10, "padded", 4)],
)
def test_number_of_windows(rows, window, tail, windows):
    assert merged_states(np.ones((rows, 8)), window, tail).shape == (windows, N_FEATURES)


def test_the_tail_repeats_the_last_state():
    states = np.arange(5.0)[:, None] * np.ones(8)
    merged = merged_states(states, 3)
    assert feature(merged, "speed", "mean").tolist() == pytest.approx([1, 2, 3, (3 + 4 + 4) / 3, 4])
    assert feature(merged, "speed", "maximum").tolist() == [2, 3, 4, 4, 4]


def test_nearly_constant_windows_have_no_complexity():
    states = np.full((20, 8), 0.1)  # the mean of ten times 0.1 is not quite 0.1
    states[::2] += 1e-4
    assert (feature(merged_states(states, 10), "speed", "complexity") == 0).all()


@pytest.mark.parametrize(("deviation", "has_complexity"), [(0.99e-3, False), (1.01e-3, True)])
def test_a_window_has_a_complexity_if_it_deviates_by_a_thousandth(deviation, has_complexity):
    states = np.where(np.arange(20) % 2, deviation, -deviation)[:, None] * np.ones(8)
    found = feature(merged_states(states, 10, "cut"), "speed", "complexity")
    assert found == pytest.approx(6.0 if has_complexity else 0.0)  # the root of 9 changes by 2 deviations
    effects = dict(zip(STATISTICS, NEGLIGIBLE, strict=False))  # of a deviation of a thousandth
    assert effects.pop("variance") == pytest.approx(1e-6)
    assert effects.pop("non-linearity") == pytest.approx(1e-9)
    assert set(effects.values()) == {1e-3}
    assert NEGLIGIBLE.reshape(8, 8).tolist() == [NEGLIGIBLE[:8].tolist()] * 8


@pytest.mark.parametrize("tail", ["padded", "cut"])
@pytest.mark.parametrize("count", [1, 2, 7])
def test_the_nearest_cluster_is_that_of_all_scaled_features(count, tail):
    """Features and centers vary alike in all 64 features, so that each one matters."""
    rng = np.random.default_rng(count)
    for rows, window in ((1, 3), (5, 1), (30, 2), (30, 10)):
        states = rng.normal(0, 2, (rows, 8))
        merged = merged_states(states, window, tail)
        mean, scale = rng.normal(0, 1, N_FEATURES), np.maximum(merged.std(0), 0.1) * rng.uniform(0.5, 2, N_FEATURES)
        centers = rng.normal(0, 1, (count, N_FEATURES))
        found = nearest_clusters(states, window, tail, Clusters(centers, np.square(centers).sum(1), mean, scale))
        gaps = np.square((merged - mean) / scale - centers[:, None]).sum(2)
        assert found.tolist() == gaps.argmin(0).tolist()
        assert found.dtype == np.uint8


@pytest.mark.parametrize("feature_number", range(N_FEATURES))
def test_each_feature_alone_decides_between_clusters(feature_number):
    """A window belongs to the nearer of two centers that differ in one feature, and to the first of two equal ones."""
    states = np.random.default_rng(3).normal(0, 2, (12, 8))
    merged = merged_states(states, 4, "cut")
    values = merged[:, feature_number]
    low, high = np.zeros((2, N_FEATURES))
    low[feature_number], high[feature_number] = values.min() - 1.0, values.max() + 0.5
    centers = np.stack([high, low, high])
    clusters = Clusters(centers, np.square(centers).sum(1), np.zeros(N_FEATURES), np.ones(N_FEATURES))
    middle = (low[feature_number] + high[feature_number]) / 2
    assert nearest_clusters(states, 4, "cut", clusters).tolist() == (values < middle).astype(int).tolist()


def test_what_another_process_has_computed_is_taken_for_its_frame_only():
    trace, known = make_trace(np.zeros((5, 3))), np.full((2, 8), 3.0, np.float32)
    vars(trace).update(known_states("world", known))
    assert state_matrix(trace, "world") is known
    assert state_matrix(trace).shape == state_matrix(trace, "route").shape == (3 - 1, 8)
    assert not state_matrix(trace, "route").any()


@pytest.mark.parametrize("start", [0.0, 3.0, 4.0, -4.0, 7.0, 20.0])
def test_headings_begin_within_half_a_turn_and_go_on_without_jumps(start):
    ego = np.column_stack([np.zeros((30, 2)), start + 0.3 * np.arange(30)])
    found = column(state_matrix(make_trace(ego, time=np.arange(30) / 10), "world"), "heading")
    assert abs(found[0]) <= np.pi + 1e-6
    assert np.exp(1j * found[0]) == pytest.approx(np.exp(1j * start))
    assert np.diff(found) == pytest.approx(0.3, abs=1e-5)


def test_window_of_one_is_the_state_itself():
    states = np.random.default_rng(0).normal(size=(6, 8))
    merged = merged_states(states, 1)
    for i, attribute in enumerate(ATTRIBUTES):
        assert feature(merged, attribute, "mean") == pytest.approx(states[:, i])
        assert feature(merged, attribute, "maximum") == pytest.approx(states[:, i])
        for statistic in ("variance", "mean-change", "mean-abs-change", "non-linearity", "complexity"):
            assert (feature(merged, attribute, statistic) == 0).all()


def test_no_states_no_windows():
    assert merged_states(np.zeros((0, 8)), 10).shape == (0, N_FEATURES)


def test_straight_braking_by_hand():
    time = np.arange(101) / 20  # 5 s
    speed = 10 - 2 * time
    ego = np.stack([10 * time - time**2, np.zeros(101), np.zeros(101)], axis=1)
    states = state_matrix(make_trace(ego, time=time))
    inner = slice(1, -1)  # make_trace estimates velocities, less well at the ends
    assert len(states) == 50  # grid 0.0 ... 4.9 s: the last frame begins no difference
    assert column(states, "speed")[inner] == pytest.approx(speed[:-1:2][inner], abs=1e-5)
    for attribute in ("speed-change", "acceleration-along"):
        assert column(states, attribute)[inner] == pytest.approx(-2, abs=1e-4)
    assert column(states, "velocity-along")[inner] == pytest.approx(column(states, "speed")[inner])
    for attribute in ("velocity-across", "acceleration-across", "yaw-rate", "heading"):
        assert column(states, attribute) == pytest.approx(0, abs=1e-6)


def test_steady_turn_by_hand():
    time, ego = circle(radius=20, speed=8, seconds=4, rate=100)
    inner = state_matrix(make_trace(ego, time=time), "world")[2:-2]
    assert column(inner, "speed") == pytest.approx(8, abs=1e-3)
    assert column(inner, "yaw-rate") == pytest.approx(8 / 20, abs=1e-4)
    assert column(inner, "acceleration-across") == pytest.approx(8**2 / 20, abs=0.02)
    assert column(inner, "acceleration-along") == pytest.approx(0, abs=0.02)
    assert column(inner, "heading")[-1] == pytest.approx(0.4 * 3.7, abs=0.02)


def test_states_and_rates_belong_to_the_frame_at_which_they_begin():
    time = np.arange(21) / 20
    ego = np.random.default_rng(0).normal(0, 0.1, (21, 3))
    trace = make_trace(ego, time=time)
    states = state_matrix(trace, "world")
    assert len(states) == 10
    assert column(states, "heading") == pytest.approx(trace.heading[0:20:2, 0], abs=1e-6)
    assert column(states, "yaw-rate") == pytest.approx(np.diff(trace.heading[:, 0])[::2] * 20, abs=1e-5)
    speed = np.hypot(*trace.velocity[:, 0].T)
    assert column(states, "speed") == pytest.approx(speed[0:20:2], abs=1e-5)
    assert column(states, "speed-change") == pytest.approx(np.diff(speed)[::2] * 20, abs=1e-4)


def test_heading_relative_to_the_route():
    time, ego = circle(radius=20, speed=8, seconds=3, rate=20, start=1.0)
    trace = make_trace(ego, time=time, route=ego[:, :2])
    assert column(state_matrix(trace), "heading") == pytest.approx(0, abs=0.02)


@pytest.mark.parametrize("turn", [0.5, 1.5, 3.1, -2.0])
def test_the_compass_does_not_matter(turn):
    time, ego = circle(radius=30, speed=6, seconds=4, rate=20)
    ego[:, 1] += np.sin(time)
    route = ego[::5, :2] + [0.3, 0.0]
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    turned = np.column_stack([ego[:, :2] @ rotation, ego[:, 2] + turn])
    here = state_matrix(make_trace(ego, time=time, route=route))
    there = state_matrix(make_trace(turned, time=time, route=route @ rotation))
    assert there == pytest.approx(here, abs=1e-5)


def interpolated_by_numpy(trace):
    """Return the states in the world's frame by NumPy's functions alone."""
    time, step = trace.time[:-1], np.diff(trace.time)
    heading, velocity = np.unwrap(trace.heading[:, 0]), trace.velocity[:, 0]
    speed, change = np.hypot(*velocity.T), np.diff(velocity, axis=0) / step[:, None]
    cos, sin = np.cos(heading[:-1]), np.sin(heading[:-1])
    columns = [speed[:-1], np.diff(speed) / step]
    for vector in (velocity[:-1], change):
        columns += [vector[:, 0] * cos + vector[:, 1] * sin, vector[:, 1] * cos - vector[:, 0] * sin]
    columns += [np.diff(heading) / step, heading[:-1]]
    grid = np.arange(int((time[-1] + 1e-9) / 0.1) + 1) * 0.1
    states = np.stack([np.interp(grid, time, values) for values in columns], axis=1)
    states[:, -1] -= 2 * np.pi * np.rint(states[0, -1] / (2 * np.pi))
    return states.astype(np.float32)


@pytest.mark.parametrize("seed", range(20))
def test_states_are_numpys_interpolation_to_the_last_bit(seed):
    rng = np.random.default_rng(seed)
    frames = int(rng.integers(2, 60))
    steps = rng.choice([0.05, 0.1, rng.uniform(0.01, 0.3)], frames - 1)
    heading = np.cumsum(rng.normal(0, 2.0 if seed % 2 else 0.1, frames))  # with jumps, or without
    ego = np.column_stack([rng.normal(0, 9, (frames, 2)), heading])
    trace = make_trace(ego, [ego + 10], time=np.concatenate([[0.0], np.cumsum(steps)]))
    assert state_matrix(trace, "world").tobytes() == interpolated_by_numpy(trace).tobytes()


@pytest.mark.parametrize("jump", [0.0, 2 * np.pi])
def test_a_negative_zero_is_a_zero_with_jumps_and_without(jump):
    ego = np.array([[3.0, 0.0, 0.5], [2.0, 0.0, -0.0], [0.0, 0.0, -0.0], [1.0, 0.0, 0.5 + jump]])
    trace = make_trace(ego, time=np.arange(4) / 10)
    states = state_matrix(trace, "world")
    assert states.tobytes() == interpolated_by_numpy(trace).tobytes()
    assert not np.signbit(column(states, "heading")).any()


@pytest.mark.parametrize("seed", range(5))
def test_the_route_s_heading_is_taken_where_the_ego_is_at_each_time(seed):
    rng = np.random.default_rng(seed)
    time = np.concatenate([[0.0], np.cumsum(rng.uniform(0.03, 0.25, 40))])  # frames between and on both sides of states
    ego = np.stack([20 * np.sin(0.4 * time), -20 * np.cos(0.4 * time), 0.4 * time], axis=1)
    trace = make_trace(ego, time=time, route=ego[:, :2])
    grid = np.arange(len(state_matrix(trace))) * 0.1
    places = np.stack([np.interp(grid, time, trace.position[:, 0, axis]) for axis in (0, 1)], axis=1)
    expected = column(state_matrix(trace, "world"), "heading") - project_on_polyline(places, trace.route)[1]
    assert column(state_matrix(trace), "heading") == pytest.approx(expected, abs=1e-5)


def test_headings_beyond_a_turn_do_not_jump():
    time, ego = circle(radius=5, speed=5, seconds=12, rate=20)
    ego[:, 2] = np.angle(np.exp(1j * ego[:, 2]))  # wrapped, as simulators record it
    states = state_matrix(make_trace(ego, time=time), "world")
    assert np.diff(column(states, "heading")) == pytest.approx(0.1, abs=1e-4)
    assert column(states, "yaw-rate") == pytest.approx(1.0, abs=1e-4)


def test_uneven_frames_are_interpolated():
    rng = np.random.default_rng(0)
    time = np.concatenate([[0.0], np.cumsum(rng.uniform(0.01, 0.3, 60))])
    ego = np.stack([7.0 * time, np.zeros_like(time), np.zeros_like(time)], axis=1)
    states = state_matrix(make_trace(ego, time=time))
    assert len(states) == int(time[-2] / 0.1) + 1
    assert column(states, "speed") == pytest.approx(7, abs=1e-5)


@pytest.mark.parametrize("rate", [10, 15, 20, 50])
def test_any_rate_gives_the_same_behavior(rate):
    time, ego = circle(radius=25, speed=9, seconds=6, rate=rate)
    states = state_matrix(make_trace(ego, time=time, route=ego[:, :2]))
    assert len(states) == int((6 - 1 / rate) * 10 + 1e-6) + 1
    assert column(states, "speed")[1:-1] == pytest.approx(9, abs=0.02)


def test_the_end_invents_no_braking():
    """The last frame begins no difference, least of all one towards speed 0."""
    time = np.arange(41) / 20
    ego = np.stack([11 * time, np.zeros(41), np.zeros(41)], axis=1)
    assert column(state_matrix(make_trace(ego, time=time)), "acceleration-along") == pytest.approx(0, abs=1e-4)


@pytest.mark.parametrize(("frames", "states"), [(1, 0), (2, 1), (3, 1), (4, 2)])
def test_short_traces(frames, states):
    assert state_matrix(make_trace(np.zeros((frames, 3)))).shape == (states, 8)


def test_states_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        state_matrix(make_trace(np.zeros((5, 3))))[0, 0] = 1
