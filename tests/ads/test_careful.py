"""The careful driver for highway-env's own environments."""

import numpy as np
import pytest

from behavexplor.ads.careful import CarefulDriver, careful_driver
from behavexplor.data.conventions import MANEUVERS
from behavexplor.errors import InputError
from behavexplor.execution.simulation import Simulation

FREE = (0.0,) * 7


def seen(speed, *others):
    """An observation of an ego that drives along x, and of others: x, y, vx, vy."""
    rows = [(1.0, 0.0, 0.0, speed, 0.0, 1.0, 0.0)]
    for x, y, vx, vy in others:
        length = max(np.hypot(vx, vy), 1e-9)
        rows.append((1.0, x, y, vx, vy, vx / length, vy / length))
    return np.array([*rows, *[FREE] * (15 - len(rows))])


@pytest.mark.parametrize(
    ("observation", "expected"),
    [
        (seen(20.0), "FASTER"),
        (seen(20.0, (30.0, 0.0, 10.0, 0.0)), "SLOWER"),  # the vehicle ahead is slower
        (seen(20.0, (30.0, 4.0, 10.0, 0.0)), "FASTER"),  # it is in the next lane
        (seen(20.0, (-15.0, 0.0, 25.0, 0.0)), "FASTER"),  # it is behind
        (seen(20.0, (46.0, 0.0, 20.0, 0.0)), "IDLE"),
        (seen(9.0, (20.0, -15.0, 0.0, 9.0)), "SLOWER"),  # it comes across
        (seen(9.0, (20.0, 40.0, 0.0, 9.0)), "FASTER"),  # it has passed
        (seen(0.0, (12.0, -12.0, 0.0, 9.0)), "SLOWER"),  # the ego waits
    ],
)
def test_it_keeps_its_distance_and_gives_way(observation, expected):
    actions, state = CarefulDriver().predict(np.stack([observation, seen(20.0)]), "kept")
    assert [MANEUVERS[action] for action in actions] == [expected, "FASTER"]
    assert state == "kept"


def test_the_direction_of_the_road_does_not_matter():
    observation = seen(20.0, (30.0, 0.0, 10.0, 0.0), (20.0, -15.0, 0.0, 9.0))
    turned = observation.copy()
    for x, y in ((1, 2), (3, 4), (5, 6)):
        turned[:, x], turned[:, y] = -observation[:, y], observation[:, x]
    both, _ = CarefulDriver().predict(np.stack([observation, turned]))
    assert both[0] == both[1]


@pytest.mark.parametrize("ads", ["careful", "constant:IDLE"])
def test_it_drives_with_the_environments_target_speeds(ads):
    simulation = Simulation("roundabout-v0", ads, env_config={"duration": 9})
    assert simulation.env.inner.vehicle.target_speeds.tolist() == [0, 8, 16]
    assert simulation.env.config["duration"] == 9


def test_it_enters_a_roundabout_when_it_can():
    simulation = Simulation("roundabout-v0", "careful")
    rng = np.random.default_rng(100)
    traces = [trace for _, trace in simulation.run_all([simulation.logical.sample(rng) for _ in range(40)])]
    assert sum(bool(trace.signals["crashed"].any()) for trace in traces) <= 2
    assert sum(bool(trace.signals["arrived"].any()) for trace in traces) >= 36


def test_where_it_cannot_drive_it_says_so():
    with pytest.raises(InputError, match="use --ads idm or --ads rule here"):
        Simulation("lane-follow", "careful")
    with pytest.raises(InputError, match="careful:bold: the careful driver has no variants"):
        careful_driver(None, "bold")
