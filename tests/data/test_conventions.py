"""What counts as a rear-end collision, for the reward of a policy and for the judge alike."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from behavexplor.data.conventions import REAR_END_ANGLE, is_rear_end, wrapped


@pytest.mark.parametrize(
    ("ahead", "turned", "npc_speed", "expected"),
    [
        (-4.6, 0.0, 9.0, True),
        (-4.6, 0.0, 4.0, False),  # slower: the ego backed into it
        (4.6, 0.0, 9.0, False),  # in front
        (-1.0, 0.0, 9.0, False),  # alongside
        (-4.6, 1.2, 9.0, False),  # from the side
        (-4.6, -REAR_END_ANGLE, 9.0, False),
    ],
)
def test_rear_end_collisions(ahead, turned, npc_speed, expected):
    assert is_rear_end(ahead, turned, 4.6, 5.0, npc_speed) is expected


@given(st.floats(-100, 100))
def test_a_wrapped_angle_is_the_same_direction(angle):
    assert abs(wrapped(angle)) <= math.pi
    assert math.cos(wrapped(angle)) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrapped(angle)) == pytest.approx(math.sin(angle), abs=1e-9)
