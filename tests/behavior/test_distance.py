import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from behavexplor.behavior.miner import AbstractTraces

LABELS = st.lists(st.integers(0, 3), max_size=40)


def traces(*rows):
    known = AbstractTraces()
    for row in rows:
        known.append(np.array(row, dtype=np.uint8))
    return known


def distances(query, *rows):
    return traces(*rows).distances(np.array(query, dtype=np.uint8)).tolist()


def equation_9(a, b):
    if not a and not b:
        return 0.0
    hamming = sum(x != y for x, y in zip(a, b, strict=False))
    return (hamming + abs(len(a) - len(b))) / max(len(a), len(b))


@pytest.mark.parametrize(
    ("a", "b", "distance"),
    [
        ([1, 2, 3], [1, 2, 3], 0.0),
        ([1, 2, 3], [4, 5, 6], 1.0),
        ([1, 2, 3, 4], [1, 2, 3, 5], 1 / 4),
        ([1, 1], [1, 1, 1, 1, 1], 3 / 5),  # dynamic time warping would say 0
        ([2, 1], [1, 1, 1, 1, 1], 4 / 5),
        ([], [1, 2], 1.0),
        ([], [], 0.0),
        (list(range(9)), list(range(8)), 1 / 9),
    ],
)
def test_by_hand(a, b, distance):
    assert distances(a, b) == distances(b, a) == [distance]


def test_the_papers_figure():
    """Two abstract traces of equal length that differ in two of three states are at distance 0.67."""
    assert distances([0, 1, 2], [0, 3, 4]) == [pytest.approx(0.67, abs=0.005)]


@given(query=LABELS, known=st.lists(LABELS, max_size=40))
def test_all_at_once_equal_one_by_one(query, known):
    assert distances(query, *known) == [equation_9(query, row) for row in known]


@given(a=LABELS, b=LABELS)
def test_it_is_a_share_symmetric_and_0_only_for_equals(a, b):
    (there,), (back,) = distances(a, b), distances(b, a)
    assert 0 <= there == back <= 1
    assert (there == 0) == (a == b)


def test_replacing():
    known = traces([1, 2, 3], [4, 5, 6, 7, 8, 9, 10, 11, 12])
    known[0] = np.array([2, 2, 2], dtype=np.uint8)
    assert known.distances(np.array([2, 2, 2], dtype=np.uint8)).tolist() == [0, 1]
    assert known.distances(np.array([1, 2, 3], dtype=np.uint8)).tolist() == [2 / 3, 1]
    assert known.distances(np.arange(4, 13, dtype=np.uint8)).tolist() == [1, 0]
    with pytest.raises(ValueError, match="broadcast"):
        known[1] = np.array([1, 2], dtype=np.uint8)


def test_none_known():
    assert distances([1, 2, 3]) == []
