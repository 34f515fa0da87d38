"""What the lanes of highway-env's roads say."""

import numpy as np
import pytest

from behavexplor.data.trace import ELSEWHERE, OBSTACLE, ON_ITS_WAY, WAYS
from behavexplor.envs.engine.lane_network import lane_indexes
from behavexplor.envs.highway.episode_record import lane_changes, lane_table, partner_places, places
from behavexplor.envs.making import make_env


def roads(name):
    env = make_env(name, {})
    env.reset(seed=0)
    network = env.inner.road.network
    return lane_table(network), lane_indexes(network).index


@pytest.mark.parametrize(
    ("name", "lane", "way"),
    [
        ("roundabout-v0", ("ser", "ses", 0), "going-straight"),
        ("roundabout-v0", ("ses", "se", 0), "entering-the-ring"),
        ("roundabout-v0", ("ex", "ee", 1), "driving-in-the-ring"),
        ("roundabout-v0", ("nx", "nxs", 0), "leaving-the-ring"),
        ("intersection-v0", ("ir0", "il1", 0), "turning-left"),
        ("intersection-v0", ("ir0", "il3", 0), "turning-right"),
        ("intersection-v0", ("ir0", "il2", 0), "going-straight"),
        ("merge-v0", ("k", "b", 0), "going-straight"),
        ("racetrack-v0", ("a", "b", 0), "going-straight"),
    ],
)
def test_a_road_tells_what_is_done_there(name, lane, way):
    table, index = roads(name)
    assert WAYS[table.way[index(lane)]] == way


@pytest.mark.parametrize(
    ("name", "lane", "other", "beside"),
    [
        ("merge-v0", ("a", "b", 0), ("b", "c", 2), 2),
        ("merge-v0", ("b", "c", 1), ("k", "b", 0), 1),
        ("merge-v0", ("a", "b", 1), ("k", "b", 0), None),
        ("roundabout-v0", ("se", "ex", 1), ("ee", "nx", 0), -1),
        ("roundabout-v0", ("ee", "nx", 1), ("nx", "nxs", 0), 0),
        ("roundabout-v0", ("sx", "se", 1), ("ses", "se", 0), None),
        ("intersection-v0", ("o0", "ir0", 0), ("ir0", "il1", 0), 0),
        ("intersection-v0", ("ir0", "il1", 0), ("o1", "ir1", 0), None),
        ("two-way-v0", ("a", "b", 1), ("b", "a", 0), None),
    ],
)
def test_lanes_are_beside_one_another_along_a_way(name, lane, other, beside):
    table, index = roads(name)
    found = table.beside[index(lane), index(other)]
    assert (None if np.isnan(found) else found) == beside
    assert table.beside[index(other), index(lane)] == -found or np.isnan(found)


def test_a_lane_change_lasts_from_the_command_until_the_lane_is_reached():
    table, _ = roads("highway-fast-v0")
    lane, target = np.array([1, 1, 1, 0, 0, 0]), np.array([1, 0, 0, 0, 0, 0])
    assert lane_changes(table, lane, target).tolist() == [0, -1, -1, -1, 0, 0]
    assert lane_changes(table, np.array([1, 1, 2, 2]), np.full(4, -1)).tolist() == [0, 0, 1, 0]
    assert lane_changes(table, np.array([1, 1, 1, 1]), np.array([1, 0, 1, 1])).tolist() == [0, -1, 1, 0]


def test_a_place_is_the_lane_unless_another_road_is_aimed_at():
    table, index = roads("merge-v0")
    lane, target = index(("a", "b", 0)), index(("b", "c", 1))
    assert places(table, np.array([lane] * 2), np.array([-1, lane + 1])).tolist() == [lane] * 2
    assert places(table, np.array([lane] * 2), np.array([target] * 2)).tolist() == [target] * 2


def test_a_vehicle_that_waits_at_the_end_of_its_road_is_on_it():
    """highway-env lets it aim at the next road half a vehicle's length before; then a crossing lane is the closest."""
    table, index = roads("intersection-v0")
    entry, turn, crossing = (index(lane) for lane in (("o0", "ir0", 0), ("ir0", "il1", 0), ("ir3", "il1", 0)))
    lane, target = np.array([entry, entry, crossing, turn]), np.array([entry, turn, turn, turn])
    assert places(table, lane, target).tolist() == [entry, entry, turn, turn]


def test_a_partner_is_on_the_way_if_it_also_drives_along_it():
    table, index = roads("highway-fast-v0")
    place, partner = np.zeros(3, dtype=int), np.array([2, 2, -1])
    where, lanes = partner_places(table, place, partner, np.array([0.2, 2.0, 0.0]))
    assert where.tolist() == [ON_ITS_WAY, ELSEWHERE, OBSTACLE]
    assert lanes.tolist() == [2, 0, 0]
    assert index(("0", "1", 2)) == 2
