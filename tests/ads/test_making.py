"""What is told to a user whose function or class cannot make a driving system."""

import re

import pytest

from behavexplor.ads.loading import load_ads, takes_one_observation
from behavexplor.errors import InputError


def with_state(observation, state):
    return 1, state


def with_mode(observation, *, mode):
    return 1


class WithSpeed:
    def __init__(self, speed):
        self.speed = speed

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return observation, state


class WithAll(WithSpeed):
    def __init__(self, *speeds, roadmap, **options):
        super().__init__(speeds)
        self.given = roadmap, options


@pytest.mark.parametrize(
    ("name", "needed"),
    [("with_state", "'observation' and 'state'"), ("with_mode", "'observation' and 'mode'"), ("WithSpeed", "'speed'")],
)
def test_parameters_that_a_factory_is_not_given_are_named(name, needed):
    with pytest.raises(InputError, match=re.escape(f"it needs {needed}, and is called with no arguments")):
        load_ads(f"{__name__}:{name}", None)


def test_a_factory_may_take_the_road_map_and_anything_optional():
    assert load_ads(f"{__name__}:WithAll", None).given == (None, {})
    assert not takes_one_observation(WithAll)


def test_a_parameter_that_only_has_a_name_is_no_observation():
    assert takes_one_observation(lambda observation, gain=2.0: observation)
    assert not takes_one_observation(lambda *, observation: observation)
