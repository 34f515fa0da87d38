import numpy as np
import pytest

from behavexplor.ads.road.lane_arrays import pose_on_lane
from behavexplor.ads.road.path import ego_path
from behavexplor.ads.rule.parameters import Parameters, numbers
from behavexplor.ads.rule.prediction import find_tails, lane_graph, reach, traveled
from behavexplor.envs.functional import IntersectionStraightEnv
from tests.kernel_calls import called_alone

find_tails = called_alone(find_tails)
pose_on_lane = called_alone(pose_on_lane)
traveled = called_alone(traveled)

LOGICAL = IntersectionStraightEnv.logical

ROADMAP = LOGICAL.roadmap
GRAPH = lane_graph(ROADMAP, ego_path(ROADMAP))
CAREFUL = Parameters()
NAMES = list({lane.name: 0 for route in ROADMAP.npc_routes for lane in route.lanes})


def ways(x, y, heading, parameters=CAREFUL, speed=5.0):
    """The names of the lanes of each way found, and the stations along them."""
    tails, stations = np.empty(8, np.int64), np.empty(8)
    found, overlooked = find_tails(GRAPH, x, y, heading, speed, numbers(parameters), tails, stations)
    found -= overlooked
    names = [tuple(NAMES[lane] for lane in GRAPH.tails[tail] if 0 <= lane < len(NAMES)) for tail in tails[:found]]
    return dict(zip(names, stations[:found], strict=True))


@pytest.mark.parametrize("route", ROADMAP.npc_routes, ids=lambda route: route.name)
def test_the_way_an_npc_takes_is_always_among_those_predicted(route):
    for station in np.linspace(0.1, route.length - 0.1, 97):
        here = int(np.searchsorted(route.bounds[1:-1], station, side="right"))
        rest = tuple(lane.name for lane in route.lanes[here:])
        found = ways(*route.pose(station))
        assert found[rest] == pytest.approx(station - route.bounds[here], abs=1e-6)


def test_before_the_junction_both_branches_are_predicted_and_behind_it_one():
    route = ROADMAP.routes["west-inner-left"]
    assert {names[1] for names in ways(*route.pose(50.0))} == {"west-inner-left", "west-inner-straight"}
    assert len(ways(*route.pose(route.bounds[2] + 5))) == 1


def test_with_weakness_r1_8_only_the_way_straight_on_is_predicted_until_the_vehicle_has_turned():
    blind = Parameters(branch_turn=0.3)
    for name, station in (("west-inner-left", 50.0), ("west-inner-left", 122.0), ("west-outer-right", 50.0)):
        route = ROADMAP.routes[name]
        straight = name.rsplit("-", 1)[0] + "-straight"
        assert [names[-3] for names in ways(*route.pose(station), blind)] == [straight]
    route = ROADMAP.routes["west-inner-left"]
    assert route.name in {names[0] for names in ways(*route.pose(route.bounds[1] + 0.31 * 16.75), blind)}
    assert route.name not in {names[0] for names in ways(*route.pose(route.bounds[1] + 0.29 * 16.75), blind)}


def test_a_vehicle_on_no_lane_goes_straight_on():
    x, y, heading = 30.0, 40.0, 0.7
    assert ways(x, y, heading) == {(): 0.0}
    ahead = pose_on_lane(GRAPH.lanes, len(GRAPH.lanes) - 1, 10.0)
    assert ahead == pytest.approx((x + 10 * np.cos(heading), y + 10 * np.sin(heading), heading))


@pytest.mark.parametrize(("speed", "acceleration"), [(5.0, 0.0), (5.0, 3.0), (9.0, 4.0), (5.0, -1.0), (3.0, -6.0)])
def test_the_distance_traveled_agrees_with_small_steps(speed, acceleration):
    limit, step, distance, v = 11.0, 1e-4, 0.0, speed
    for i in range(int(6 / step)):
        after = np.clip(v + acceleration * step, 0.0, limit) if i * step < 2.0 else v
        distance += (v + after) / 2 * step
        v = after
    assert traveled(speed, acceleration, 2.0, limit, 6.0) == pytest.approx(distance, abs=1e-2)


def test_the_reach_spans_keeping_the_speed_and_keeping_the_acceleration():
    near, far = reach(5.0, -2.0, 2.0, 11.0, 1.0, 3.0)
    assert (near, far) == pytest.approx((4.0, 15.0))
