"""The drivers that others are measured against."""

import numpy as np
import pytest

from behavexplor.ads.idm import ACCELERATION, JAM_GAP, TIME_GAP, idm_acceleration
from behavexplor.ads.interface import ADS
from behavexplor.ads.loading import load_ads
from behavexplor.errors import InputError
from behavexplor.execution.simulation import Simulation
from tests.ads.learned.scenes import LOGICALS, ego, on_route
from tests.kernel_calls import called_alone

idm_acceleration = called_alone(idm_acceleration)

ROADMAP = LOGICALS["lane-follow"].roadmap


@pytest.mark.parametrize("name", ["idm", "constant", "constant:-3", "constant:0,0.1"])
def test_references_are_systems_under_test(name):
    ads = load_ads(name, ROADMAP)
    assert isinstance(ads, ADS)
    scene = [ego("lane-follow", 30.0, speed=5.0), on_route("lane-follow", "lane-3", 60.0)]
    actions, _ = ads.predict(np.array([scene, scene]))
    assert actions.shape == (2, 2)
    assert np.abs(actions).max() <= 1


def test_a_constant_driver_commands_what_it_is_called():
    scenes = np.zeros((3, 4, 8))
    np.testing.assert_allclose(load_ads("constant:-3,0.3", ROADMAP).predict(scenes)[0], np.tile([-1 / 6, 0.5], (3, 1)))
    np.testing.assert_allclose(load_ads("constant", ROADMAP).predict(scenes)[0], np.tile([2 / 3, 0.0], (3, 1)))


@pytest.mark.parametrize(
    "name", ["constant:fast", "constant:1,2,3", "constant:9", "constant:0,-1", "constant:IDLE", "idm:2"]
)
def test_wrong_variants_are_refused(name):
    with pytest.raises(InputError, match=r"constant|idm"):
        load_ads(name, ROADMAP)


@pytest.mark.parametrize("name", ["constant", "constant:1", "constant:fast"])
def test_in_a_stock_environment_the_meta_actions_are_named(name):
    with pytest.raises(InputError, match=r"such as constant:SLOWER: name one of .*FASTER"):
        load_ads(name, None)


@pytest.mark.parametrize(
    ("speed", "gap", "leader_speed", "expected"),
    [
        (0.0, np.inf, 0.0, ACCELERATION),
        (10.0, np.inf, 0.0, 0.0),
        (0.0, JAM_GAP, 0.0, 0.0),
        (5.0, JAM_GAP + 5 * TIME_GAP, 5.0, -ACCELERATION / 16),
        (5.0, 25.0, 9.0, ACCELERATION * (1 - 1 / 16 - ((5 + 7.5 - 20 / (2 * 15**0.5)) / 25) ** 2)),
    ],
)
def test_the_model_is_the_published_one(speed, gap, leader_speed, expected):
    assert idm_acceleration(speed, 10.0, gap, leader_speed) == pytest.approx(expected)


def test_idm_follows_a_vehicle_ahead_and_ignores_one_that_crosses():
    roadmap = LOGICALS["lane-follow"].roadmap
    route = roadmap.routes["lane-3"]
    simulation = Simulation("lane-follow", "idm")
    scenario = simulation.logical.sample(np.random.default_rng(0))
    trace = simulation.run(scenario)
    assert trace.end in {"arrived", "timeout", "standstill", "collision"}
    assert route.length > roadmap.destination
    slow = np.array([[ego("lane-follow", 60.0, speed=8.0), on_route("lane-follow", "lane-3", 75.0, 2.0)]])
    beside = np.array([[ego("lane-follow", 60.0, speed=8.0), on_route("lane-follow", "lane-2", 75.0, 2.0)]])
    crossing = LOGICALS["intersection-straight"].roadmap.routes["west-inner-straight"]
    across = np.array(
        [[ego("intersection-straight", 80.0, speed=8.0), on_route("intersection-straight", crossing.name, 110.0, 8.0)]]
    )
    braking, free = (simulation.ads.predict(scenes)[0][0, 0] for scenes in (slow, beside))
    ignoring = load_ads("idm", LOGICALS["intersection-straight"].roadmap).predict(across)[0][0, 0]
    assert braking < -0.2 < free
    assert ignoring == pytest.approx(free, abs=0.05)
    simulation.close()
