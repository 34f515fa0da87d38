import math

import numpy as np
import pytest

from behavexplor.ads.rule.station_time import bearings, hidden_share
from tests.ads.rule.world import scene
from tests.kernel_calls import called_alone

bearings = called_alone(bearings)
hidden_share = called_alone(hidden_share)

EGO = (0.0, 0.0, 0.0, 5.0)


def car(x, y, heading=0.0):
    return (x, y, heading, 5.0, 0.0)


def test_a_car_straight_behind_another_is_hidden_and_the_nearer_one_is_not():
    view = scene(EGO, [car(40, 0), car(20, 0)])
    assert hidden_share(view, 1) >= 1.0
    assert hidden_share(view, 2) == 0.0


def test_less_is_hidden_the_farther_aside_it_is():
    shares = [hidden_share(scene(EGO, [car(40, aside), car(20, 0)]), 1) for aside in (0.0, 2.0, 3.0, 3.5, 4.0, 6.0)]
    assert shares == sorted(shares, reverse=True)
    assert shares[0] >= 1.0
    assert 0.0 < shares[2] < 1.0
    assert shares[-1] <= 0.0


@pytest.mark.parametrize("x", [-40.0, 40.0])
def test_it_does_not_depend_on_where_the_bearing_jumps(x):
    assert hidden_share(scene(EGO, [car(x, 0.3), car(x / 2, -0.2)]), 1) > 0.8
    assert hidden_share(scene(EGO, [car(x, 0.3), car(-x / 2, 0.0)]), 1) == 0.0


def test_absent_vehicles_hide_nobody():
    view = scene(EGO, [car(40, 0), car(20, 0)])
    view[2, 0] = 0.0
    assert hidden_share(view, 1) == 0.0


def plain_hidden_share(view, row):
    """The hidden share by the bearings of all vehicles that are nearer."""
    distances = np.hypot(view[:, 1] - view[0, 1], view[:, 2] - view[0, 2])
    bearing, low, high = bearings(view, row)
    shares = [0.0]
    for other in range(1, len(view)):
        if other != row and distances[other] < distances[row]:
            middle, other_low, other_high = bearings(view, other)
            away = (middle - bearing + math.pi) % (2 * math.pi) - math.pi
            shares.append((min(high, away + other_high) - max(low, away + other_low)) / (high - low))
    return max(shares)


def test_it_is_the_share_by_the_bearings_of_all_nearer_vehicles_bit_by_bit():
    rng, hidden = np.random.default_rng(0), 0
    for _ in range(2000):
        reach = rng.choice([8.0, 60.0])
        cars = [car(*rng.uniform(-reach, reach, 2), rng.uniform(-4, 4)) for _ in range(5)]
        view = scene(EGO, cars)
        share = hidden_share(view, 1)
        assert share == plain_hidden_share(view, 1)
        hidden += share > 0.0
    assert hidden > 200
