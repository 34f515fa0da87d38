import numpy as np
import pytest

from behavexplor.errors import InputError
from behavexplor.fuzz.quality_diversity import SCALES, check_measures, describe
from tests.fakes import make_trace, simulate

from .test_assessment import LOGICAL


def drive(speeds):
    """A straight drive at these speeds, one for each twentieth of a second."""
    x = np.concatenate([[0.0], np.cumsum(speeds) / 20])
    return make_trace(np.stack([x, 0 * x, 0 * x], axis=1))


def test_a_steady_drive():
    measures = describe(drive(np.full(200, 6.0)), tuple(SCALES))
    assert measures == pytest.approx([0.5, 0.0, 0.0, 0.0, 10 / 120], abs=1e-6)


def test_a_stop():
    speeds = np.concatenate([np.full(100, 8.0), np.linspace(8, 0, 40), np.zeros(60)])
    values = dict(zip(SCALES, describe(drive(speeds), tuple(SCALES)), strict=True))
    assert values["braking"] == pytest.approx(4 / 8, rel=0.1)
    assert values["standing"] == pytest.approx(0.3, abs=0.03)
    assert values["mean-speed"] == pytest.approx(speeds.mean() / 12, abs=0.01)


def test_a_turn():
    angle = np.arange(200) / 20 * 0.4  # 8 m/s at 0.4 rad/s: 3.2 m/s2
    trace = make_trace(np.stack([20 * np.sin(angle), 20 - 20 * np.cos(angle), angle], axis=1))
    assert describe(trace, ("cornering",)) == pytest.approx([0.8], abs=0.01)


def test_values_stay_within_their_scales_and_in_order():
    trace = simulate(LOGICAL.sample(np.random.default_rng(0)))
    values = describe(trace, tuple(SCALES))
    assert ((values >= 0) & (values <= 1)).all()
    assert describe(trace, ("duration", "braking")).tolist() == [values[4], values[1]]


def test_the_shortest_trace():
    assert describe(make_trace(np.zeros((1, 3))), tuple(SCALES)).tolist() == [0, 0, 0, 1, 0]


@pytest.mark.parametrize("measures", [(), ("braking", "braking")])
def test_measures_that_span_nothing(measures):
    with pytest.raises(InputError, match="measures: name at least one, and each only once"):
        check_measures(measures)
