"""Values of dataclasses: what is out of range, of a wrong type or unknown is named in one sentence."""

import math
from dataclasses import make_dataclass, replace
from typing import Annotated

import pytest

from behavexplor.data.validation import between, checked, validated
from behavexplor.errors import InputError
from behavexplor.fuzz.nsga2 import NSGA2Options
from behavexplor.fuzz.samota import SAMOTAOptions


@validated
class Shares:
    """Two numbers."""

    share: Annotated[float, between(0, 1)] = 0.5
    count: Annotated[int, between(3)] = 3

    def __post_init__(self):
        if self.share == 0.25:
            raise InputError("share: not a quarter")


@pytest.mark.parametrize("value", [0, 0.5, 1])
def test_values_in_range_pass(value):
    assert Shares(share=value).share == value


@pytest.mark.parametrize("value", [-0.1, 1.1, math.nan, math.inf])
def test_values_out_of_range_are_named(value):
    with pytest.raises(InputError, match=f"share: must be a number from 0 to 1, got {value}"):
        Shares(share=value)
    with pytest.raises(InputError, match=f"share: must be a number from 0 to 1, got {value}"):
        checked(Shares, {"share": value}, "options")


@pytest.mark.parametrize("value", [2, 10**9])
def test_every_option_has_an_upper_end(value):
    with pytest.raises(InputError, match=f"count: must be a number from 3 to 100000, got {value}"):
        Shares(count=value)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"count": "many"}, "count of the options: Input should be a valid integer"),
        ({"count": math.nan}, "count of the options: Input should be a finite number"),
        ({"share": 0.25}, "share: not a quarter"),
        ({"shar": 0.2}, "Unknown key of the options 'shar': did you mean 'share'"),
        ({"count": 10**5000}, "that is too long to be shown"),
    ],
)
def test_the_first_value_that_is_wrong_is_named(values, message):
    with pytest.raises(InputError, match=message):
        checked(Shares, values, "options")


def test_a_changed_copy_is_validated_too():
    with pytest.raises(InputError, match="share: must be"):
        replace(Shares(), share=2.0)


@pytest.mark.parametrize("options", [NSGA2Options, SAMOTAOptions])
def test_a_population_whose_comparison_would_never_end_is_refused(options):
    assert options(population=1000).population == 1000
    with pytest.raises(InputError, match=r"population: must be a number from \d to 1000, got 20000"):
        options(population=20_000)


def test_a_key_where_there_are_none_is_named():
    with pytest.raises(InputError, match="Unknown key of the options of uniform 'x': there are none"):
        checked(make_dataclass("Options", []), {"x": 1}, "options of uniform")
