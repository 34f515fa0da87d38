"""State is copied from highway-env, and what the engine cannot copy is refused by name."""

import numpy as np
import pytest
from highway_env.road.lane import PolyLaneFixedWidth, StraightLane
from highway_env.road.road import RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.controller import ControlledVehicle
from highway_env.vehicle.objects import Landmark

from behavexplor.envs.engine.lane_network import lane_indexes, make_network, road_numbers
from behavexplor.envs.engine.state import IDM, LINEAR, MDP, OBSTACLE, PLAIN, make_slots
from behavexplor.envs.engine.vehicle_parameters import kind_of
from behavexplor.envs.engine.world import EGO, OTHER
from behavexplor.envs.highway.conversion import load_state
from behavexplor.errors import InputError
from tests.envs.highway.comparison import N_PLACES, N_STEPS, make, world_of

LINEAR_TRAFFIC = {"other_vehicles_type": "highway_env.vehicle.behavior.LinearVehicle"}
CONTINUOUS = {"action": {"type": "ContinuousAction", "speed_range": [0, 20]}}


def test_the_impact_of_a_collision_and_yielding_are_copied():
    env = make("intersection-v0")
    env.reset(seed=0)
    hit, yielding = env.road.vehicles[:2]
    hit.impact, hit.crashed = np.array([0.5, -0.25]), True
    yielding.is_yielding, yielding.yield_timer, yielding.color = True, 0, None
    slots = make_slots(1, N_PLACES, N_STEPS)
    load_state(env, world_of(env), slots, 0)
    hit, yielding = slots.vehicles[0, :2]
    assert (hit.has_impact, hit.impact_x, hit.impact_y, hit.crashed) == (True, 0.5, -0.25, True)
    assert (yielding.is_yielding, yielding.has_impact, yielding.crashed) == (True, False, False)


def test_the_network_is_highway_env_s():
    env = make("roundabout-v1")
    network, lanes = make_network(env.road.network, connected_lanes=True), env.road.network.lanes_dict()
    assert len(network.lanes) == len(lanes)
    for row, (index, lane) in zip(network.lanes, lanes.items(), strict=True):
        road = network.roads[row.road]
        assert (row.length, row.width, row.speed_limit) == (lane.length, lane.width, lane.speed_limit)
        assert lane_indexes(env.road.network)[road.first_lane + row.number] == index
        assert road_numbers(env.road.network)[index[:2]] == row.road
        following = network.exits[road.first_exit : road.first_exit + road.n_exits]
        assert list(following) == [
            road_numbers(env.road.network)[index[1], to] for to in env.road.network.graph.get(index[1], {})
        ]
        links = network.links[row.first_link : row.first_link + row.n_links]
        assert links[0].offset == 0
        assert all(link.offset in (row.length, -network.lanes[link.lane].length) for link in links[1:])


def test_a_network_has_neither_goals_nor_links_unless_they_are_asked_for():
    network = make_network(make("roundabout-v1").road.network)
    assert not network.lanes["is_goal"].any()
    assert network.links.tolist() == [(lane, 0.0) for lane in range(len(network.lanes))]


def test_goals_are_those_of_the_environment():
    for env_id, goals in {
        "merge-v0": {("b", "c", 2)},
        "exit-v0": {("1", "2", 6), ("2", "exit", 0)},
        "intersection-v0": {(f"il{k}", f"o{k}", 0) for k in range(4)},
        "highway-fast-v0": set(),
    }.items():
        env = make(env_id)
        marked = world_of(env).network.lanes["is_goal"]
        indexes = lane_indexes(env.road.network)
        assert {indexes[i] for i in np.flatnonzero(marked)} == goals


def test_the_traffic_s_parameters_are_those_of_its_class_at_the_time():
    env = make("intersection-v0")
    other = world_of(env).templates[OTHER]
    assert (other.distance_wanted, other.comfort_acceleration, other.comfort_braking) == (7, 6, -3)
    assert other.gap_divisor == 2 * np.sqrt(18)
    env = make("highway-fast-v0", CONTINUOUS)
    ego = world_of(env).templates[EGO]
    assert (ego.kind, ego.min_speed, ego.max_speed) == (PLAIN, 0, 20)


class Hasty(IDMVehicle):
    """The same behavior with other parameters."""

    TIME_WANTED = 0.5


class Random(IDMVehicle):
    """Another behavior."""

    def mobil(self, lane_index):
        return True


class Agile(IDMVehicle):
    """Another controller."""

    KP_HEADING = 9.0


def traffic(cls):
    return {"other_vehicles_type": f"{cls.__module__}.{cls.__qualname__}"}


def test_subclasses_with_other_parameters_are_known():
    env = make("highway-fast-v0", traffic(Hasty))
    assert kind_of(Hasty) == IDM
    assert world_of(env).templates[OTHER].time_wanted == 0.5
    kinds = [kind_of(type(vehicle)) for vehicle in make("merge-v0", LINEAR_TRAFFIC).road.vehicles]
    assert kinds == [MDP, *[LINEAR] * 4]
    assert kind_of(type(make("merge-v0").road.objects[0])) == OBSTACLE


class Moody(IDMVehicle):
    TIME_WANTED = property(lambda self: 0.5 + abs(self.position[0]) % 2)


class Shy:
    """A descriptor: the class has another value than its vehicles."""

    def __get__(self, vehicle, cls):
        return 10.0 if vehicle is None else 20.0


class Distant(IDMVehicle):
    DISTANCE_WANTED = Shy()


class Limited(type(IDMVehicle)):
    MAX_SPEED = 21.0  # of the class, not of its vehicles


class Slow(IDMVehicle, metaclass=Limited):
    pass


@pytest.mark.parametrize(
    ("cls", "words"),
    [
        (Random, "how a Random drives"),
        (Agile, "KP_HEADING"),
        (ControlledVehicle, "ControlledVehicle"),
        (Moody, "its TIME_WANTED, which is computed"),
        (Distant, "its DISTANCE_WANTED, which is computed"),
        (Slow, "its metaclass"),
    ],
)
def test_other_behavior_is_refused_by_name(cls, words):
    env = make("highway-fast-v0")
    env.config |= traffic(cls)
    with pytest.raises(InputError, match=words):
        world_of(env)


def test_lanes_of_another_geometry_are_refused_by_name():
    class Wider(StraightLane):
        def width_at(self, longitudinal):
            return 2 * self.width

    network = RoadNetwork()
    network.add_lane("a", "b", StraightLane([0, 0], [9, 0]))
    network.add_lane("a", "b", PolyLaneFixedWidth([(0.0, 4.0), (5.0, 4.0), (9.0, 5.0)]))
    with pytest.raises(InputError, match=r"'a', 'b', 1.*PolyLaneFixedWidth.*vectorization_mode='sync'"):
        make_network(network)
    network.graph["a"]["b"][1] = Wider([0, 4], [9, 4])
    with pytest.raises(InputError, match="Wider"):
        make_network(network)


def test_a_lane_without_a_speed_limit_has_none():
    network = RoadNetwork()
    network.add_lane("a", "b", StraightLane([0, 0], [9, 0], speed_limit=None))
    assert np.isnan(make_network(network).lanes[0].speed_limit)


def test_what_does_not_fit_into_a_slot_is_refused():
    env = make("roundabout-v0")
    world = world_of(env)
    with pytest.raises(InputError, match="5 vehicles and obstacles, but a slot holds 4"):
        load_state(env, world, make_slots(1, 4, N_STEPS), 0)
    with pytest.raises(InputError, match="a slot holds 2; make longer"):
        load_state(env, world, make_slots(1, N_PLACES, 2), 0)
    env.road.vehicles[1].route[0] = ("nowhere", "se", 0)
    with pytest.raises(InputError, match="nowhere"):
        load_state(env, world, make_slots(1, N_PLACES, N_STEPS), 0)


def test_landmarks_and_ghosts_are_refused():
    env = make("merge-v0")
    world, slots = world_of(env), make_slots(1, N_PLACES, N_STEPS)
    env.road.vehicles[1].collidable = False
    with pytest.raises(InputError, match="collidable"):
        load_state(env, world, slots, 0)
    env.reset()
    env.road.objects.append(Landmark(env.road, [0, 0]))
    with pytest.raises(InputError, match="Landmark"):
        load_state(env, world, slots, 0)


def test_actions_of_another_type_are_refused_by_name():
    env = make("highway-fast-v0")
    env.action_type = object()
    with pytest.raises(InputError, match="the action object"):
        world_of(env)
