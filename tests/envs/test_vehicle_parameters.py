"""The parameters of highway-env's classes of vehicles: read, and kept apart for each environment."""

import pytest
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.behavior import AggressiveVehicle, DefensiveVehicle, IDMVehicle, LinearVehicle
from highway_env.vehicle.controller import MDPVehicle
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import Obstacle

from behavexplor.envs.engine.vehicle_parameters import (
    VehicleClasses,
    kept_parameters,
    kind_of,
    parameters,
    set_parameters,
    traits_of,
)


class Own(IDMVehicle):
    POLITENESS = 0.5


class Wide(LinearVehicle):
    WIDTH, MAX_SPEED, LANE_CHANGE_DELAY = 2.5, 30.0, 2.0


@pytest.mark.parametrize(
    "cls", [Vehicle, MDPVehicle, IDMVehicle, LinearVehicle, AggressiveVehicle, DefensiveVehicle, Own, Wide, Obstacle]
)
def test_the_traits_of_a_class_are_those_of_its_new_vehicles(cls):
    vehicle = cls(Road(RoadNetwork.straight_road_network(2)), [0.0, 0.0])
    traits = traits_of(cls, kind_of(cls))
    assert traits.tolist() == traits_of(vehicle, kind_of(cls)).tolist()
    assert (traits.length, traits.width, traits.diameter) == (vehicle.LENGTH, vehicle.WIDTH, vehicle.diagonal)
    assert traits.checks_collisions == vehicle.check_collisions
    assert traits.changes_lanes == getattr(vehicle, "enable_lane_change", False)


def test_a_vehicle_s_own_flags_are_read():
    vehicle = IDMVehicle(Road(RoadNetwork.straight_road_network(2)), [0.0, 0.0], enable_lane_change=False)
    vehicle.check_collisions = False
    traits = traits_of(vehicle, kind_of(IDMVehicle))
    assert (traits.changes_lanes, traits.checks_collisions) == (False, False)


@pytest.mark.parametrize("name", ["DISTANCE_WANTED", "DELTA_RANGE"])
def test_parameters_are_given_back(name):
    """Those that have changed, those that are new and those that are gone, also of subclasses."""
    value, before = getattr(IDMVehicle, name), parameters()
    try:
        setattr(IDMVehicle, name, 77)
        setattr(Own, name, 88)
        del Own.POLITENESS
        assert parameters()[IDMVehicle][name] == 77
        assert parameters()[Own] == {name: 88}
    finally:
        set_parameters(before)
    assert vars(IDMVehicle)[name] is value
    assert name not in vars(Own)
    assert Own.POLITENESS == 0.5
    assert parameters() == before


@pytest.mark.parametrize("error", [None, ZeroDivisionError])
def test_what_an_environment_does_to_the_parameters_is_undone(error):
    own, other, value = VehicleClasses(), VehicleClasses(), IDMVehicle.TIME_WANTED

    def change(manager, new):
        with manager:
            IDMVehicle.TIME_WANTED = new
            if error:
                raise error

    for manager, new in ((kept_parameters(), 66.0), (own.applied(), 77.0), (other.applied(), 88.0)):
        if error:
            with pytest.raises(error):
                change(manager, new)
        else:
            change(manager, new)
        assert value == IDMVehicle.TIME_WANTED
    for classes, left in ((own, 77.0), (other, 88.0), (own, 77.0), (VehicleClasses(), value)):
        with classes.applied():
            assert left == IDMVehicle.TIME_WANTED
    assert value == IDMVehicle.TIME_WANTED
