import math

import pytest

from behavexplor.errors import InputError
from behavexplor.fuzz.nsga2 import NSGA2Options
from behavexplor.fuzz.options import check_range
from behavexplor.fuzz.samota import SAMOTAOptions


@pytest.mark.parametrize("value", [0, 0.5, 1])
def test_values_in_range_pass(value):
    check_range("share", value, 0, 1)


@pytest.mark.parametrize("value", [-0.1, 1.1, math.nan, math.inf])
def test_values_out_of_range_are_named(value):
    with pytest.raises(InputError, match=f"share: must be a number from 0 to 1, got {value}"):
        check_range("share", value, 0, 1)


@pytest.mark.parametrize("value", [2, math.nan, math.inf, 10**9])
def test_every_option_has_an_upper_end(value):
    with pytest.raises(InputError, match=f"count: must be a number from 3 to 100000, got {value}"):
        check_range("count", value, 3)


@pytest.mark.parametrize("options", [NSGA2Options, SAMOTAOptions])
def test_a_population_whose_comparison_would_never_end_is_refused(options):
    assert options(population=1000).population == 1000
    with pytest.raises(InputError, match=r"population: must be a number from \d to 1000, got 20000"):
        options(population=20_000)


def test_a_number_of_thousands_of_digits_is_refused():
    with pytest.raises(InputError, match="got a int that is too long to be shown"):
        check_range("count", 10**5000, 3)
