"""What is told while an ADS is asked, and actions of rows without an episode."""

from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete

from behavexplor.execution import rollout
from behavexplor.execution.executor import ADSError
from behavexplor.execution.rollout import ask

SECOND_IS_UNUSED = np.array([True, False, True])


def answered(actions, space, counts):
    ads = SimpleNamespace(predict=lambda *_, **__: (actions, "state"))
    return ask(ads, np.zeros((3, 1)), None, np.zeros(3, dtype=bool), space, counts)


@pytest.mark.parametrize(
    ("actions", "space"),
    [
        (np.array([[1.0, 0.5], [np.nan, np.inf], [0.0, -1.0]]), Box(-1, 1, (2,))),
        (np.array([1, 99, 0]), Discrete(3)),
        (np.array([2, -5, 3]), Discrete(3, start=1)),
    ],
)
def test_an_action_that_is_not_used_may_be_anything(actions, space):
    taken, state = answered(actions, space, SECOND_IS_UNUSED)
    assert state == "state"
    assert all(space.contains(action.astype(space.dtype)) for action in taken)
    np.testing.assert_array_equal(taken[[0, 2]], actions[[0, 2]])
    with pytest.raises(ADSError, match="predict must return"):
        answered(actions, space, None)
    with pytest.raises(ADSError, match="predict must return"):
        answered(actions, space, ~SECOND_IS_UNUSED)


def test_valid_actions_are_passed_on():
    actions = np.array([[1.0, 0.5], [0.0, 0.0], [0.0, -1.0]])
    assert answered(actions, Box(-1, 1, (2,)), SECOND_IS_UNUSED)[0] is actions


@pytest.mark.parametrize("action", [np.array([[0.0, 0.0]]), None])
def test_another_process_is_told_as_long_as_an_ads_is_asked(monkeypatch, action):
    """The campaign's process tells by this flag whether the end of a worker is a failure of the ADS."""
    seen = []

    def predict(*_, **__):
        seen.append(flag.value)
        if action is None:
            raise ValueError("no idea")
        return action, None

    flag = SimpleNamespace(value=0)
    monkeypatch.setattr(rollout, "_asking", [flag])
    with nullcontext() if action is not None else pytest.raises(ADSError, match="no idea"):
        ask(SimpleNamespace(predict=predict), np.zeros((1, 1)), None, np.zeros(1, dtype=bool), Box(-1, 1, (2,)), None)
    assert seen == [1]
    assert flag.value == 0
