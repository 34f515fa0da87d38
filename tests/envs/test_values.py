"""Kinds of values: what each takes and what not."""

import math

import numpy as np
import pytest

from behavexplor.envs import values
from behavexplor.errors import InputError

HUGE = 10**400
NO_NUMBERS = (None, True, "1", [1], math.nan, math.inf, 1j, HUGE, 1e10, -1e308)


@pytest.mark.parametrize(
    ("kind", "taken", "refused"),
    [
        (values.NUMBER, (0, -2.5, np.float32(1), np.int64(-3)), NO_NUMBERS),
        (values.POSITIVE, (1e-9, 1, 10_000), (0, -1, 10_001, *NO_NUMBERS)),
        (values.NOT_NEGATIVE, (0, 0.5, 10_000), (-1e-9, 10_000.5, *NO_NUMBERS)),
        (values.WHOLE, (0, 5, np.int8(3)), (-1, 1.0, 10_001, np.uint8(3), *NO_NUMBERS)),
        (values.COUNT, (1, np.int32(10_000)), (0, 1.0, np.float64(2), np.uint8(4), *NO_NUMBERS)),
        (values.FLAG, (True, False, np.True_), (0, 1, None, "True")),
        (values.RANGE, ([0, 1], (-2.5, 3)), (np.array([1, 2]), [1, 0], [1, 1], [0, math.nan], [0], [0, 1, 2], "01", 3)),
        (values.TWO_NUMBERS, ([1, 0], (0.5, 0.5)), ([1], [1, 2, 3], [1, None], None)),
        (values.THREE_NUMBERS, ([1, 0, 2],), ([1, 2], "abc", {1: 1, 2: 2, 3: 3})),
        (values.TWO_POSITIVE, ((5, 0.1),), ((5, 0), (5,), 5)),
        (values.TWO_RANGES, ([[0, 1], (2, 3)],), ([0, 1], [[1, 0], [2, 3]], [[0, 1]], [[-1e308, 1e308], [0, 1]], None)),
        (values.IMAGE_SHAPE, ((84, 84),), ([84, 84], (84,), (84, 0), (84.0, 84))),
        (
            values.EVEN_NUMBERS,
            ([0, 4.5, 9], np.linspace(20, 30, 3)),
            ([1], [2, 1], [0, 1, 3], [0, 0], [0, 1e308, 10], None, []),
        ),
        (values.NUMBER_RANGES, ({}, {"x": [0, 1]}), ({"x": [1, 0]}, {"x": 1}, [("x", [0, 1])])),
        (values.names(("a", "b")), (["a"], ("b", "a")), ([], ["c"], "a", [["a"]], [None])),
        (values.one_of(("a", "b")), ("a",), ("c", "", ["a"], None)),
        (values.optional(values.COUNT), (None, 3), (0, False)),
    ],
)
def test_what_a_kind_takes(kind, taken, refused):
    for value in taken:
        kind.check("key", value)
    for value in refused:
        with pytest.raises(InputError) as error:
            kind.check("key", value)
        assert str(error.value).startswith(f"key: expected {kind.wanted}, got ")
        assert len(str(error.value)) < 300


def test_values_are_shown_in_one_short_line():
    assert values.shown(np.ones((2, 2))) == "array([[1., 1.], [1., 1.]])"
    assert len(values.shown("x" * 1000)) == 80
