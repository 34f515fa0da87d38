"""Waiting, restarting, creeping: decisions on station-time graphs made by hand."""

import numpy as np
import pytest

from behavexplor.ads.rule.decision import CREEP_TIME, creep, restarts_hastily, shorten, waits_for_ever
from behavexplor.ads.rule.parameters import Parameters, numbers
from behavexplor.ads.rule.station_time import INTERVAL, LEAD_SPEED, LEADS, N_INTERVALS, empty_station_time
from behavexplor.ads.rule.weaknesses import R1_3, R3_4, REACHED, TRIGGERED
from tests.ads.rule.world import memory_with
from tests.kernel_calls import called_alone

creep = called_alone(creep)
restarts_hastily = called_alone(restarts_hastily)
shorten = called_alone(shorten)
waits_for_ever = called_alone(waits_for_ever)


def graph(low=40.0, high=50.0, speed=0.3, leads=0.0):
    """A graph with one vehicle that takes up a stretch all the time."""
    room = empty_station_time(1)
    room.counts[:] = 1
    room.spans[:, 0, :4] = low, high, low - 2, high + 2
    room.spans[:, 0, LEADS], room.spans[:, 0, LEAD_SPEED] = leads, speed
    return room


@pytest.mark.parametrize(("stood", "ahead", "creeps"), [(20.0, 10.0, True), (5.0, 10.0, False), (20.0, 0.5, False)])
def test_who_has_stood_for_long_creeps_if_the_next_meter_is_free(stood, ahead, creeps):
    room, state, p = graph(low=30.0 + ahead), memory_with(stood=stood), numbers(Parameters())
    assert creep(room, 30.0, np.inf, state, room.bits, p) == creeps
    assert state.creeps == (CREEP_TIME if creeps else 0.0)


def test_nobody_creeps_past_the_limit_and_creeping_once_begun_goes_on():
    room, p = graph(), numbers(Parameters())
    assert not creep(room, 30.0, 30.2, memory_with(stood=20.0), room.bits, p)
    state = memory_with()
    state.creeps = 0.3
    assert creep(room, 30.0, 30.2, state, room.bits, p)


def test_r3_4_neither_creeps_nor_goes_while_a_slow_one_crosses():
    p = numbers(Parameters(deadlock=0.5))
    for speed, stays in ((0.3, True), (0.8, False)):
        room = graph(speed=speed)
        assert creep(room, 30.0, np.inf, memory_with(stood=20.0), room.bits, p) != stays
        assert waits_for_ever(room, memory_with(waited=1.0), room.bits, p) == stays
        assert room.bits[TRIGGERED] == (R3_4 if stays else 0)
    room = graph()
    assert not waits_for_ever(room, memory_with(waited=0.0), room.bits, p)
    assert not waits_for_ever(room, memory_with(waited=9.0), room.bits, numbers(Parameters()))


def test_r1_3_decides_anew_after_a_stop():
    p = numbers(Parameters(restart=2.0))
    bits, state = np.zeros(2, np.int64), memory_with(waited=1.0)
    assert restarts_hastily(False, state, bits, p)
    assert state.restarted == 2.0
    assert bits[TRIGGERED] == R1_3
    bits, state = np.zeros(2, np.int64), memory_with(waited=1.0)
    assert not restarts_hastily(True, state, bits, p)
    assert (bits[REACHED], bits[TRIGGERED]) == (R1_3, 0)
    assert not restarts_hastily(False, memory_with(waited=0.2), bits, p)
    assert not restarts_hastily(False, memory_with(waited=9.0), bits, numbers(Parameters()))


def test_a_short_outlook_forgets_who_crosses_later_but_no_leader():
    crossing, leading = graph(), graph(leads=1.0)
    shorten(crossing, 1.0)
    shorten(leading, 1.0)
    assert crossing.counts.tolist() == [1 if k * INTERVAL < 1.0 else 0 for k in range(N_INTERVALS)]
    assert leading.counts.min() == 1
