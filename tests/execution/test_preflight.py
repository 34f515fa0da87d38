"""What is said of a driver before it is tested."""

import numpy as np
import pytest

from behavexplor.execution.preflight import SCENARIOS, preflight_warnings
from behavexplor.execution.simulation import Simulation
from tests.drivers import Cruiser, Lost
from tests.envs.highway import strange


class Parked(Cruiser):
    """Neither brakes nor goes."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.tile([1 / 3, 0.0], (len(observation), 1)), state


class Trained(Cruiser):
    """The same, and it knows what it was trained on."""

    def __init__(self, last_trained_on=None):
        self.last_trained_on = last_trained_on


def warnings_about(driver):
    simulation = Simulation("lane-follow", f"tests.drivers:{Cruiser.__name__}")
    simulation.ads = driver
    try:
        return preflight_warnings(simulation)
    finally:
        simulation.close()


def seen_by(driver):
    """Some of what a driver sees."""
    scenes = []

    class Watching(Cruiser):
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            scenes.extend(scene for scene in observation if scene.any())
            return driver.predict(observation, state)

    warnings_about(Watching())
    return np.array(scenes[:: len(scenes) // 16])


def test_a_driver_that_drives_is_fit():
    assert warnings_about(Cruiser()) == []


def test_a_constant_driver_is_named_and_so_is_one_that_never_moves():
    constant, motionless = warnings_about(Parked())
    assert constant.startswith("The ADS is constant")
    assert f"in {SCENARIOS} scenarios" in constant
    assert motionless == f"The ego never moved in {SCENARIOS} scenarios"


def test_answers_to_rows_without_an_ego_do_not_count():
    """The scenarios end one after the other, so that some rows are zeros before all have ended."""

    class Blind(Parked):
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            actions, state = super().predict(observation, state)
            actions[~observation.any(axis=(1, 2))] = 1.0
            return actions, state

    assert warnings_about(Blind())[0].startswith("The ADS is constant")


def test_a_driver_that_answers_no_number_is_named():
    (warning,) = warnings_about(Lost())
    assert "failed (invalid): predict must return finite numbers" in warning


def test_a_policy_trained_on_what_it_sees_is_fit():
    assert warnings_about(Trained(seen_by(Cruiser()))) == []


@pytest.mark.parametrize("scale", [0.01, 30.0])
def test_a_policy_trained_on_something_else_is_named(scale):
    (warning,) = warnings_about(Trained(scale * seen_by(Cruiser())))
    assert "statistics of VecNormalize missing" in warning


def test_a_policy_that_went_elsewhere_while_it_was_trained_is_fit():
    seen = seen_by(Cruiser())
    seen.reshape(-1)[::3] = 1e6
    assert warnings_about(Trained(seen)) == []


def test_observations_of_another_shape_are_not_compared():
    assert warnings_about(Trained(np.full((4, 3, 3), 1e9))) == []


def test_an_environment_that_does_not_repeat_its_episodes_is_named():
    def said_of(kind):
        simulation = Simulation(strange.registered(kind), "constant:SLOWER")
        return [warning for warning in preflight_warnings(simulation) if "it must draw by its attribute" in warning]

    assert len(said_of(strange.DrawsElsewhere)) == 1
    assert said_of(strange.Brief) == []
