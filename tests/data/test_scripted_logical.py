"""Which scenarios are possible: what is sampled is accepted, what breaks a rule is refused by name."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given

from behavexplor.data.conventions import EGO_SIZE, VEHICLE_SIZES
from behavexplor.data.geometry import box_corners, boxes_overlap
from behavexplor.data.scripted import _MARGIN, NPC, ScriptedScenario, Waypoint, _gap_across, _overlap, _Placed
from behavexplor.envs.functional import IntersectionStraightEnv
from behavexplor.errors import InputError
from tests.strategies import scenarios

LOGICAL = IntersectionStraightEnv.logical

ROADMAP = LOGICAL.roadmap


def npc(route="west-inner-straight", start=60.0, kind="sedan"):
    """A vehicle in the middle of everything that it may be."""
    ranges = LOGICAL.position_ranges(ROADMAP.routes[route])
    waypoints = [Waypoint(float(np.mean(bounds)), 5.0) for bounds in ranges]
    waypoints[0] = Waypoint(start, 5.0)
    waypoints[1] = Waypoint(max(start, waypoints[1].position), 5.0)
    waypoints[-1] = Waypoint(waypoints[-1].position, 0.0)
    return NPC(kind, route, tuple(waypoints))


def with_waypoint(npc, index, waypoint):
    waypoints = list(npc.waypoints)
    waypoints[index] = waypoint
    return replace(npc, waypoints=tuple(waypoints))


def check(*npcs, functional=LOGICAL.name):
    LOGICAL.check(ScriptedScenario(functional, npcs))


@given(scenarios(LOGICAL))
def test_samples_are_accepted(scenario):
    LOGICAL.check(scenario)
    assert len(scenario.npcs) == LOGICAL.n_npcs


@given(scenarios(LOGICAL))
def test_spawn_rules_hold(scenario):
    routes = [ROADMAP.routes[npc.route] for npc in scenario.npcs]
    poses = np.array([route.pose(npc.waypoints[0].position) for route, npc in zip(routes, scenario.npcs, strict=True)])
    poses = np.vstack([ROADMAP.start_pose, poses])
    sizes = np.array([EGO_SIZE, *(VEHICLE_SIZES[npc.type] for npc in scenario.npcs)])
    boxes = box_corners(poses[:, :2], poses[:, 2], sizes)
    overlap = boxes_overlap(boxes[:, None], boxes)
    assert not overlap[~np.eye(len(boxes), dtype=bool)].any()
    assert (np.hypot(*(poses[1:, :2] - poses[0, :2]).T) >= 15).all()
    for i, route in enumerate(routes):
        for j in range(i):
            if routes[j].lanes[0] is route.lanes[0]:
                assert np.hypot(*(poses[1 + i, :2] - poses[1 + j, :2])) >= 8


def test_sampling_reaches_every_route_and_type():
    rng = np.random.default_rng(0)
    npcs = [npc for _ in range(60) for npc in LOGICAL.sample(rng).npcs]
    assert {npc.route for npc in npcs} == set(ROADMAP.routes)
    assert {npc.type for npc in npcs} == set(VEHICLE_SIZES)


def test_the_same_generator_gives_the_same_scenario():
    assert LOGICAL.sample(np.random.default_rng(5)) == LOGICAL.sample(np.random.default_rng(5))
    assert LOGICAL.sample(np.random.default_rng(5)) != LOGICAL.sample(np.random.default_rng(6))


def test_fewer_npcs_are_accepted():
    check()
    check(npc())


def test_parked_npcs_leave_the_destination_free():
    """Even a bus that parks as early as it may, and brakes as late, stands clear of the ego's destination."""
    for route in ROADMAP.npc_routes:
        if route.lanes[-2] is not ROADMAP.ego_route.lanes[2]:
            continue
        parked = float(LOGICAL.position_ranges(route)[-1, 0])
        destination = route.bounds[2] + 60.0
        bus, ego = VEHICLE_SIZES["school-bus"][0], EGO_SIZE[0]
        assert parked - destination > (bus + ego) / 2


@pytest.mark.parametrize(
    ("npcs", "message"),
    [
        ([npc(kind="tank")], "npcs[0].type: Unknown vehicle type 'tank'"),
        ([npc(kind="sedann")], "did you mean 'sedan'?"),
        ([replace(npc(), route="west-inner-left-turn")], "did you mean 'west-inner-left'?"),
        (
            [replace(npc(), waypoints=npc().waypoints[:-1])],
            "npcs[0].waypoints: route 'west-inner-straight' takes 8, got 7",
        ),
        ([npc(start=2.4)], "npcs[0].waypoints[0].position: 2.4 is not in [2.5, 117.5] m"),
        ([npc(start=118.0)], "npcs[0].waypoints[0].position: 118.0 is not in"),
        (
            [with_waypoint(npc(), 3, Waypoint(151.0, 5.0))],
            "npcs[0].waypoints[3].position: 151.0 is not in [120, 150] m",
        ),
        ([with_waypoint(npc(), 2, Waypoint(130.0, 11.2))], "npcs[0].waypoints[2].speed: 11.2 is not in [0.2, 11.176]"),
        ([with_waypoint(npc(), 2, Waypoint(130.0, 0.1))], "npcs[0].waypoints[2].speed: 0.1"),
        ([with_waypoint(npc(), -1, Waypoint(280.0, 0.2))], "npcs[0].waypoints[7].speed: 0.2 is not in [0, 0]"),
        ([npc(), npc("west-inner-left", 67.9)], "npcs[1].waypoints[0].position: the vehicle starts 7.90 m from NPC 0"),
        ([npc(kind="school-bus"), npc("west-outer-right", 60.0, "school-bus")], None),
        ([npc("south-inner-straight", 34.0)], "starts 14.00 m from the ego, closer than 15 m"),
        ([npc("south-outer-right", 31.0)], "from the ego, closer than 15 m"),
        ([npc("west-inner-straight", float(x)) for x in (10, 20, 30, 40, 50, 60)], "npcs: 6 are too many"),
    ],
)
def test_broken_rules_are_named(npcs, message):
    if message is None:
        check(*npcs)
        return
    with pytest.raises(InputError) as error:
        check(*npcs)
    assert message in str(error.value)


def test_another_functional_scenario_is_refused():
    with pytest.raises(InputError, match="functional: this is a scenario of 'lane-follow'"):
        check(functional="lane-follow")


def test_a_road_that_is_too_full_is_said_to_be():
    crowded = replace(LOGICAL, n_npcs=200)
    with pytest.raises(InputError, match="use fewer NPCs"):
        crowded.sample(np.random.default_rng(0))


def test_the_quick_tests_for_overlapping_vehicles_never_decide_otherwise():
    rng = np.random.default_rng(0)
    sizes = list(VEHICLE_SIZES.values())
    agreed, decided = {True: 0, False: 0}, 0
    for _ in range(5000):
        a, b = (
            _Placed(
                *rng.uniform(-4, 4, 2),
                rng.choice([0.0, np.pi / 2, np.pi, rng.uniform(-4, 4)]),
                size,
                np.hypot(*size) / 2,
                ROADMAP.ego_route.lanes[0],
            )
            for size in (sizes[i] for i in rng.integers(len(sizes), size=2))
        )
        corners = (box_corners(np.array([one.x, one.y]), np.array(one.heading), np.array(one.size)) for one in (a, b))
        overlap = bool(boxes_overlap(*corners))
        assert _overlap(a, b, np.hypot(a.x - b.x, a.y - b.y)) == overlap
        agreed[overlap] += 1
        decided += _gap_across(a, b) > _MARGIN
    assert min(agreed.values()) > 500
    assert decided > 300
