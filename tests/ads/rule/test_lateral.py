import numpy as np
import pytest

from behavexplor.ads.rule.control import LateralProfile, change_profile, keep_profile, offset_at
from tests.kernel_calls import called_alone

change_profile = called_alone(change_profile)
keep_profile = called_alone(keep_profile)
offset_at = called_alone(offset_at)

CHANGES = [(0.0, 3.5, 0.0, 20.0), (3.5, 0.0, 0.0, 15.0), (1.2, 0.0, 0.25, 18.0), (-7.0, -3.5, -0.1, 40.0)]


@pytest.mark.parametrize(("first", "last", "slope", "length"), CHANGES)
def test_a_change_joins_both_offsets_smoothly(first, last, slope, length):
    profile = change_profile(50.0, first, slope, last, length)
    step = 1e-4

    def derivatives(station):
        before, here, after = (offset_at(profile, station + k * step) for k in (-1, 0, 1))
        return here, (after - before) / (2 * step), (after - 2 * here + before) / step**2

    assert derivatives(50.0 + 2 * step) == pytest.approx((first, slope, 0.0), abs=1e-2)
    assert derivatives(50.0 + length - 2 * step) == pytest.approx((last, 0.0, 0.0), abs=1e-2)
    assert offset_at(profile, 20.0) == first
    assert offset_at(profile, 500.0) == last


def test_a_change_from_rest_never_leaves_the_span_between_its_ends():
    profile = change_profile(0.0, 0.0, 0.0, 3.5, 15.0)
    offsets = np.array([offset_at(profile, station) for station in np.linspace(-5, 25, 500)])
    assert (np.diff(offsets) >= -1e-12).all()
    assert (offsets.min(), offsets.max()) == (0.0, 3.5)


def test_an_offset_is_kept_everywhere_and_steep_slopes_are_bounded():
    assert {offset_at(keep_profile(-3.5), station) for station in (-100.0, 0.0, 300.0)} == {-3.5}
    assert change_profile(0.0, 0.0, 3.0, 3.5, 15.0).slope == 0.5
    assert isinstance(keep_profile(0.0), LateralProfile)
