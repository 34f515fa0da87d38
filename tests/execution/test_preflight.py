"""What is said of a driver before it is tested."""

import json

import numpy as np
import pytest

from behavexplor.data.target import Target
from behavexplor.execution import preflight
from behavexplor.execution.evaluator import evaluator_recipe
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


class Undecided(Cruiser):
    """Draws its steering anew in every drive."""

    def __init__(self):
        self.rng = np.random.default_rng()

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        actions, state = super().predict(observation, state)
        actions[:, 1] += self.rng.uniform(-0.01, 0.01, len(actions))
        return actions, state


class Forgetful(Cruiser):
    """Drives its first episode in another way than all others."""

    drives = 0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.drives += bool(np.any(episode_start))
        actions, state = super().predict(observation, state)
        return actions * (0.9 if self.drives == 2 else 1.0), state


class Comparing(Cruiser):
    """Decides each row by the others."""

    vectorized = True

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        actions, state = super().predict(observation, state)
        return actions * (0.9 if len(observation) > 1 else 1.0), state


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
    assert constant.startswith("The driver always chooses [0.33333333 0.        ] (")
    assert f"in {SCENARIOS} scenarios" in constant
    assert motionless == f"The ego never moved in {SCENARIOS} scenarios"


def test_answers_to_rows_without_an_ego_do_not_count():
    """The scenarios end one after the other, so that some rows are zeros before all have ended."""

    class Blind(Parked):
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            actions, state = super().predict(observation, state)
            actions[~observation.any(axis=(1, 2))] = 1.0
            return actions, state

    assert warnings_about(Blind())[0].startswith("The driver always chooses")


def test_a_driver_that_answers_no_number_is_named():
    (warning,) = warnings_about(Lost())
    assert "failed (invalid): predict must return finite numbers" in warning


@pytest.mark.parametrize(
    ("answer", "words"), [(None, "a pair"), ((1, None), "actions of shape"), ({}, "a pair"), (([[1], []], None), "")]
)
def test_an_answer_of_another_form_is_described_as_in_the_campaign(answer, words, monkeypatch):
    monkeypatch.setattr(Cruiser, "predict", lambda *_, **__: answer)
    (said,) = warnings_about(Cruiser())
    assert said.startswith("In the first scenarios, the ADS failed (")
    assert words in said
    assert "preflight" not in said


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


@pytest.fixture(scope="module")
def scenes():
    return seen_by(Cruiser())


@pytest.mark.parametrize(("share", "is_named"), [(0.39, False), (0.41, True)])
def test_up_to_two_fifths_of_the_values_may_lie_elsewhere(scenes, share, is_named):
    """Policies that were trained for a short time reach a third; without its statistics one has four fifths."""
    seen = scenes.copy()
    elsewhere = np.random.default_rng(0).permutation(seen.size)[: int(share * seen.size)]
    seen.reshape(-1)[elsewhere] = 1e6
    said = warnings_about(Trained(seen))
    assert [one[:3] for one in said] == (["41%"] if is_named else [])


@pytest.mark.parametrize(("beyond", "is_named"), [(0.24, False), (0.27, True)])
def test_values_may_lie_beyond_the_range_by_a_quarter_of_it(scenes, beyond, is_named):
    low, high = scenes.min(axis=0), scenes.max(axis=0)
    found = preflight._foreign(scenes, np.where(high - low > 1.0, low - beyond * (high - low), 1e6)[None])
    assert (found or "").startswith("100%") is is_named


def test_observations_of_another_shape_are_not_compared():
    assert warnings_about(Trained(np.full((4, 3, 3), 1e9))) == []


def test_an_environment_that_does_not_repeat_its_episodes_is_named():
    def said_of(kind):
        simulation = Simulation(strange.registered(kind), "constant:SLOWER")
        return [warning for warning in preflight_warnings(simulation) if "it must draw by its attribute" in warning]

    assert len(said_of(strange.DrawsElsewhere)) == 1
    assert said_of(strange.Brief) == []


@pytest.mark.parametrize("driver", [Undecided, Forgetful])
def test_a_driver_that_does_not_repeat_its_drives_is_named(driver):
    (warning,) = warnings_about(driver())
    assert warning.startswith("The driver does not drive the same scenario in the same way")


def test_a_driver_whose_rows_depend_on_each_other_is_named():
    (warning,) = warnings_about(Comparing())
    assert warning.startswith("The driver drives a scenario otherwise when it drives others at the same time")
    assert warning.endswith("or leave out `vectorized`")


def test_traffic_that_draws_elsewhere_is_named(monkeypatch):
    monkeypatch.setattr(strange, "draws", np.random.default_rng(0))
    config = {"duration": 10, "other_vehicles_type": "tests.envs.highway.strange.Nervous"}
    target = Target("highway-fast-v0", "constant:FASTER", env_config=config)  # which always crashes
    evaluator = evaluator_recipe(target).make()
    evaluator.begin()
    said = json.loads(evaluator.preflight(b""))
    assert any(warning.startswith("The environment goes on in another way") for warning in said)


def test_a_meta_action_is_named_and_so_is_that_the_policy_could_draw():
    def said(**settings):
        simulation = Simulation("highway-fast-v0", "constant:SLOWER", **settings)
        simulation.ads = Drawable(simulation.ads)
        return [one for one in preflight_warnings(simulation) if "always chooses" in one]

    (warning,) = said()
    assert warning.startswith("The driver always chooses SLOWER (120 decisions in 4 scenarios); with --stochastic")


class Drawable:
    """A driver that could draw its actions."""

    noise, vectorized = 1, True

    def __init__(self, ads):
        self._ads = ads
        self.predict = ads.predict

    def draw(self, observation, state, episode_start, noise):
        actions, state = self._ads.predict(observation, state, episode_start)
        return np.where(noise[..., 0] < 0.5, actions, 0), state


def test_a_policy_whose_actions_are_drawn_is_driven_so():
    simulation = Simulation("highway-fast-v0", "constant:SLOWER")
    simulation.ads, simulation.stochastic = Drawable(simulation.ads), True
    assert not [one for one in preflight_warnings(simulation) if "always chooses" in one or "same way" in one]
