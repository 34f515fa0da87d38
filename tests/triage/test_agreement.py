"""Agreement of labels, against values worked out by hand."""

import pytest

from behavexplor.triage.signatures import agreement


def test_equal_labels_agree_in_everything():
    found = agreement(["a", "b", "b"], ["a", "b", "b"])
    assert (found.n, found.equal, found.precision, found.recall, found.adjusted_rand) == (3, 1.0, 1.0, 1.0, 1.0)


def test_groups_agree_whatever_they_are_called():
    found = agreement(["a", "a", "b", "b"], ["x", "x", "y", "y"])
    assert (found.equal, found.adjusted_rand) == (0.0, 1.0)


def test_precision_is_of_what_is_named_and_recall_of_what_is_there():
    found = agreement(["a", "a", "a", "b"], ["a", "b", "b", "b"])
    assert found.equal == pytest.approx(0.5)
    assert found.precision == pytest.approx((1 + 1 / 3) / 2)
    assert found.recall == pytest.approx((1 / 3 + 1) / 2)
    assert agreement(["a", "a", "b", "b"], ["b", "a", "b", "a"]).adjusted_rand == pytest.approx(-0.5)
