import numpy as np
import pytest

from behavexplor.fuzz.vector_search import objectives
from behavexplor.judge.specs import Verdict


def of(degree, *, violated=False):
    return objectives(Verdict({"collision": degree}, ("collision",) if violated else ()))[0]


def test_they_keep_the_order_within_0_and_1():
    values = [of(degree) for degree in (0.0, 1e-3, 0.5, 3.0, 1000.0)]
    assert values == sorted(values)
    assert all(0 < value < 1 for value in values)


def test_0_is_a_violation_and_nothing_else_is():
    assert of(0.0, violated=True) == 0
    assert of(5.0, violated=True) == 0  # R3: missed by 5 m
    assert of(0.0) > 0
    assert of(-2.0) == of(0.0)


def test_one_for_each_spec_in_their_order():
    values = objectives(Verdict({"a": 1.0, "b": 3.0, "c": 0.0}, ("b",)))
    assert values.shape == (3,)
    assert values[1] == 0
    assert values == pytest.approx(np.array([0.5, 0.0, 0.0]), abs=1e-3)
