"""The shape of a road, as a file of someone else may give it."""

import json

import pytest

from behavexplor.data.road_shape import RoadShape
from behavexplor.errors import InputError


@pytest.mark.parametrize(
    ("striped", "words"),
    [
        ([[[0.0, 0.0], [1e9, 0.0]]], "striped of the shape of a road must be lines"),
        ([[[0.0, 0.0], [1e7, 0.0]] * 5], "has at most 1000000 points and dashes"),
        ([[[0.0, 0.0], [float("nan"), 0.0]]], "striped of the shape of a road must be lines"),
    ],
)
def test_a_road_that_would_be_drawn_for_hours_is_refused(striped, words):
    with pytest.raises(InputError, match=words):
        RoadShape.from_json(json.dumps({"surfaces": [], "striped": striped, "borders": []}))
