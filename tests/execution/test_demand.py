"""How much of the time a caller waits, by a clock of the test."""

import pytest

from behavexplor.execution import demand
from behavexplor.execution.demand import Demand


class Clock:
    now = 100.0

    def monotonic(self):
        return self.now

    def run(self, seconds):
        self.now += seconds


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(demand, "time", clock)
    return clock


def waits(measured, clock, seconds):
    with measured.waiting():
        clock.run(seconds)


def test_demand_is_high_after_a_period_in_which_the_caller_waited_for_most_of_the_time(clock):
    measured = Demand()
    waits(measured, clock, 0.9)
    assert not measured.is_high  # the period has not ended
    clock.run(0.2)
    assert measured.is_high


def test_demand_is_low_if_the_caller_worked_for_most_of_the_time(clock):
    measured = Demand()
    waits(measured, clock, 0.4)
    clock.run(0.7)
    assert not measured.is_high


def test_a_long_time_of_work_is_forgotten_after_a_period(clock):
    """A campaign that has loaded its kernels and fitted its first clusters waits for a slow driver from then on."""
    measured = Demand()
    clock.run(5.0)
    assert not measured.is_high
    waits(measured, clock, 0.8)
    clock.run(0.3)
    assert measured.is_high
    clock.run(1.5)
    assert not measured.is_high


def test_a_wait_that_goes_on_counts(clock):
    measured = Demand()
    clock.run(5.0)
    assert not measured.is_high
    with measured.waiting():
        clock.run(1.1)
        assert measured.is_high
        clock.run(1.1)
        assert measured.is_high
    clock.run(0.5)
    assert measured.is_high  # until the next period ends
    clock.run(0.6)
    assert not measured.is_high


def test_measuring_anew_forgets_what_was_measured(clock):
    measured = Demand()
    waits(measured, clock, 2.0)
    assert measured.is_high
    measured.measure_anew()
    assert not measured.is_high
