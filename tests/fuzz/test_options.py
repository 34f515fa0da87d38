import math

import pytest

from behavexplor.errors import InputError
from behavexplor.fuzz.options import check_range


@pytest.mark.parametrize("value", [0, 0.5, 1])
def test_values_in_range_pass(value):
    check_range("share", value, 0, 1)


@pytest.mark.parametrize("value", [-0.1, 1.1, math.nan, math.inf])
def test_values_out_of_range_are_named(value):
    with pytest.raises(InputError, match=f"share: must be a number from 0 to 1, got {value}"):
        check_range("share", value, 0, 1)


@pytest.mark.parametrize("value", [2, math.nan, math.inf])
def test_without_an_upper_end(value):
    with pytest.raises(InputError, match=f"count: must be a number at least 3, got {value}"):
        check_range("count", value, 3)
