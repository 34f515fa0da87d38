"""Roads as OpenDRIVE: valid, read by another library, and linked as they drive."""

import warnings
from functools import cache

import numpy as np
import pytest
from highway_env.road.lane import PolyLane, PolyLaneFixedWidth, StraightLane
from highway_env.road.road import RoadNetwork
from lxml import etree
from scipy.integrate import quad

from behavexplor.data.road_plan import SineLane, part_of, plan_of_map
from behavexplor.data.roadmap import Lane
from behavexplor.envs.highway.course import road_plan, road_shape
from behavexplor.envs.making import make_registered
from behavexplor.errors import InputError
from behavexplor.exchange.axes import mirrored_lane, mirrored_points
from behavexplor.exchange.opendrive import MAX_ERROR, NOWHERE, road_layout, sine_pieces, write_road
from behavexplor.execution.simulation import logical_scenario
from tests.exchange.exported import schema_errors

OURS = ("intersection-straight", "lane-change")
STOCK = (
    *("highway-v0", "merge-v0", "roundabout-v0", "intersection-v0", "exit-v0", "two-way-v0", "u-turn-v0"),
    *("racetrack-v0", "lane-keeping-v0", "parking-v0"),
)
POINTS = 1000
GREATEST_GAP = 0.01  # [m]


@cache
def plan_of(name):
    """The plan of an environment's road, and the points of its lanes by station, as the environment has them."""
    if name in OURS:
        roadmap = logical_scenario(name).roadmap
        return plan_of_map(roadmap), [(lane.length, lambda s, lane=lane: lane.pose(s)[:2]) for lane in roadmap.lanes]
    env = make_registered(name, {})
    env.reset(seed=0)
    network = env.unwrapped.road.network
    env.close()
    points = [(lane.length, lambda s, lane=lane: lane.position(s, 0.0)) for lane in network.lanes_list()]
    return road_plan(network), points


@pytest.mark.parametrize("name", [*OURS, *STOCK])
def test_a_road_is_valid(name, tmp_path):
    path = tmp_path / "road.xodr"
    write_road(plan_of(name)[0], name, path)
    assert schema_errors(path) == []
    assert "+lat_0=0 +lon_0=0 " in etree.parse(path).findtext("header/geoReference")


def read_centers(path):
    """The segments of all lane centers, as the library pyxodr reads them, shape (n, 2, 2)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        network_module = pytest.importorskip("pyxodr.road_objects.network")
        network = network_module.RoadNetwork(str(path), resolution=0.5)
        lanes = [lane for road in network.get_roads() for section in road.lane_sections for lane in section.lanes]
        lines = [lane.centre_line[:, :2] for lane in lanes if lane.id != 0]
    return np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in lines])


@pytest.mark.parametrize("name", ["intersection-straight", "roundabout-v0", "lane-keeping-v0"])
def test_another_library_reads_the_same_lanes(name, tmp_path):
    plan, lanes = plan_of(name)
    path = tmp_path / "road.xodr"
    write_road(plan, name, path)
    segments = read_centers(path)
    start, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    squared = np.maximum(np.einsum("ij,ij->i", along, along), 1e-18)
    rng = np.random.default_rng(0)
    gaps = []
    for i in rng.integers(len(lanes), size=POINTS):
        length, position = lanes[i]
        point = mirrored_points(position(rng.uniform(0.0, length)))
        share = np.clip(np.einsum("ij,ij->i", point - start, along) / squared, 0.0, 1.0)
        gaps.append(np.hypot(*(start + share[:, None] * along - point).T).min())
    assert max(gaps) < GREATEST_GAP


def test_a_cubic_is_never_shorter_than_its_length(tmp_path):
    path = tmp_path / "road.xodr"
    write_road(plan_of("lane-keeping-v0")[0], "lane-keeping-v0", path)
    lengths = []
    for geometry in etree.parse(path).iter("geometry"):
        cubic = geometry.find("paramPoly3")
        if cubic is not None:
            slopes = [[i * float(cubic.get(name + axis)) for i, name in enumerate("abcd")][1:] for axis in "UV"]
            arc = quad(lambda p, slopes=slopes: np.hypot(*(np.polyval(row[::-1], p) for row in slopes)), 0, 1)[0]
            lengths.append(arc - float(geometry.get("length")))
    assert len(lengths) > 0
    assert 0.5e-9 < min(lengths) <= max(lengths) < 2e-9


@pytest.mark.parametrize("lane", [planned.lane for planned in plan_of("lane-keeping-v0")[0]][:1])
def test_pieces_of_a_sine_are_within_the_stated_error(lane):
    """The greatest error, measured across the axis, is near its bound, so the bound is not idle."""
    share = np.linspace(0.0, 1.0, 21)
    powers = share[:, None] ** np.arange(4)
    errors = []
    for piece in sine_pieces(lane):
        x, y, heading = piece.pose
        u, v = powers @ piece.u, powers @ piece.v
        dx, dy = x + u * np.cos(heading) - v * np.sin(heading), y + u * np.sin(heading) + v * np.cos(heading)
        station = (dx - lane.x) * np.cos(lane.heading) + (dy - lane.y) * np.sin(lane.heading)
        errors.append(np.hypot(*(lane.pose(station)[:, :2] - np.stack([dx, dy], axis=-1)).T).max())
    assert 0.2 * MAX_ERROR < max(errors) <= MAX_ERROR


def test_a_part_of_a_lane_lies_on_it():
    lanes = [
        Lane("a", "b", "c", 3.0, 4.0, 0.3, 50.0, 3.5, curvature=-0.02),
        SineLane("a", "b", "c", 3.0, 4.0, 0.3, 50.0, 3.5, amplitude=2.0, pulsation=0.1, phase=0.4),
    ]
    for lane in lanes:
        part = part_of(lane, 10.0, 30.0)
        assert part.length == pytest.approx(20.0)
        np.testing.assert_allclose(part.pose(np.arange(20.0)), lane.pose(10.0 + np.arange(20.0)), atol=1e-12)
        mirror = mirrored_lane(lane).pose(np.arange(20.0))
        np.testing.assert_allclose(mirror * [1, -1, -1], lane.pose(np.arange(20.0)), atol=1e-12)


@pytest.mark.parametrize("name", [*OURS, *STOCK])
def test_connecting_roads_lead_from_one_road_outside_to_another(name):
    layout = road_layout(plan_of(name)[0])
    for i, junction in enumerate(layout.junction):
        before, after = (
            [one for one, other in layout.links if other == i],
            [other for one, other in layout.links if one == i],
        )
        if junction == NOWHERE:
            for others in (before, after):
                assert len(others) <= 1 or len({layout.junction[other] for other in others} - {NOWHERE}) == 1
        else:
            assert len(before) == len(after) == 1
            assert layout.junction[before[0]] == layout.junction[after[0]] == NOWHERE
    for (i, j), pairs in layout.links.items():
        for a, b in pairs:
            first, second = layout.roads[i].lanes[a].lane, layout.roads[j].lanes[b].lane
            assert np.hypot(*(first.pose(first.length) - second.pose(0.0))[:2]) <= GREATEST_GAP


@pytest.mark.parametrize(
    ("name", "roads", "junctions", "connecting"),
    [
        ("intersection-straight", 28, 1, 12),
        ("lane-change", 3, 0, 0),
        ("merge-v0", 6, 1, 2),  # the end of the main road is cut off as a connecting road
        ("exit-v0", 6, 1, 2),
        ("intersection-v0", 20, 1, 12),
        ("roundabout-v0", 24, 0, 0),  # highway-env's entries and exits do not meet the circle
    ],
)
def test_lanes_become_roads_and_junctions(name, roads, junctions, connecting):
    layout = road_layout(plan_of(name)[0])
    assert len(layout.roads) == roads
    assert len({*layout.junction} - {NOWHERE}) == junctions
    assert sum(junction != NOWHERE for junction in layout.junction) == connecting


def test_a_lane_of_another_shape_is_named():
    network = RoadNetwork()
    line = [(0, 0), (10, 1), (20, 0)]
    network.add_lane("a", "b", PolyLane(line, [(x, y - 2) for x, y in line], [(x, y + 2) for x, y in line]))
    with pytest.raises(InputError, match="is a PolyLane, and only straight, sine and circular lanes can be exported"):
        road_plan(network)


def test_a_lane_of_points_may_have_no_lines():
    network = RoadNetwork()
    network.add_lane("a", "b", PolyLaneFixedWidth([(0.0, 0.0), (10.0, 1.0), (20.0, 0.0)]))
    shape = road_shape(network)
    assert (len(shape.surfaces), shape.striped, shape.borders) == (1, (), ())


def test_a_lane_whose_geometry_was_changed_is_named():
    class Bent(StraightLane):
        def position(self, longitudinal, lateral):
            return super().position(longitudinal, lateral + 0.01 * longitudinal)

    network = RoadNetwork()
    network.add_lane("a", "b", Bent([0, 0], [20, 0]))
    with pytest.raises(InputError, match="is a Bent"):
        road_plan(network)
