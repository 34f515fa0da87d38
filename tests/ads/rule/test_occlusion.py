import pytest

from behavexplor.ads.rule.occlusion import hidden_share
from tests.ads.rule.world import scene
from tests.kernel_calls import called_alone

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
