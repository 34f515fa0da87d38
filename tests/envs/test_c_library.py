"""The ego's motion does not depend on numpy's trigonometry, which differs from processor to processor."""

import math

import gymnasium
import highway_env.road.lane
import highway_env.vehicle.controller
import highway_env.vehicle.kinematics
import numpy as np
import pytest
from highway_env.road.lane import CircularLane
from highway_env.vehicle.controller import MDPVehicle
from highway_env.vehicle.dynamics import BicycleVehicle
from highway_env.vehicle.kinematics import Vehicle
from hypothesis import given
from hypothesis import strategies as st

from behavexplor.envs import road_objects as c_library
from behavexplor.envs.functional import IntersectionLeftEnv
from behavexplor.envs.road_objects import EgoVehicle, MetaEgoVehicle, road_network, with_c_library

TRIGONOMETRY = ("sin", "cos", "tan", "arcsin", "arctan", "arctan2")
angles = st.floats(-1.5, 1.5)


class Coarse:
    """numpy on another processor, with trigonometry that is wrong in the sixth digit."""

    def __getattr__(self, name):
        function = getattr(np, name)
        return (lambda *values: function(*values) * (1 + 1e-6)) if name in TRIGONOMETRY else function


@pytest.mark.parametrize("action", ["ContinuousAction", "DiscreteAction", "DiscreteMetaAction"])
def test_an_episode_is_the_same_whatever_numpy_s_trigonometry_is(action, monkeypatch):
    def episode():
        env = IntersectionLeftEnv({"action": {"type": action}, "observation": {"type": "Scene"}, "duration": 30.0})
        env.reset(seed=3)
        env.action_space.seed(3)
        while True:
            *_, terminated, truncated, info = env.step(env.action_space.sample())
            if terminated or truncated:
                return info["trace"].to_bytes()

    expected = episode()
    for module in (highway_env.vehicle.kinematics, highway_env.vehicle.controller, highway_env.road.lane):
        monkeypatch.setattr(module, "np", Coarse())
    assert episode() == expected


@given(st.floats(0, 20), st.floats(-7, 7), angles, st.floats(-5, 5))
def test_the_ego_s_step_is_the_c_library_s_to_the_last_bit(speed, heading, steering, acceleration):
    ego = EgoVehicle(None, [1.0, 2.0], heading, speed)
    ego.act({"steering": steering, "acceleration": acceleration})
    ego.step(0.05)
    slip = math.atan(0.5 * math.tan(steering))
    x, y = 1.0 + speed * math.cos(heading + slip) * 0.05, 2.0 + speed * math.sin(heading + slip) * 0.05
    turned = heading + speed * math.sin(slip) / (EgoVehicle.LENGTH / 2) * 0.05
    assert (*ego.position, ego.heading, ego.speed) == (x, y, turned, speed + acceleration * 0.05)


@given(st.floats(-30, 30), st.floats(-30, 30))
def test_curved_lanes_are_highway_env_s_but_for_the_last_bits(x, y):
    lanes = road_network(IntersectionLeftEnv.logical.roadmap).lanes_list()
    for lane in (lane for lane in lanes if isinstance(lane, CircularLane)):
        station, offset = lane.local_coordinates(np.array([x, y]))
        expected = CircularLane.local_coordinates(lane, np.array([x, y]))
        assert (station, offset) == pytest.approx(expected, abs=1e-9)
        assert lane.position(station, 1.0) == pytest.approx(CircularLane.position(lane, station, 1.0), abs=1e-12)


@pytest.mark.parametrize(
    ("action", "expected"),
    [
        ({"type": "ContinuousAction"}, EgoVehicle),
        ({"type": "DiscreteAction"}, EgoVehicle),
        ({"type": "DiscreteMetaAction", "target_speeds": [0, 3, 6]}, MetaEgoVehicle),
        ({"type": "ContinuousAction", "dynamical": True}, BicycleVehicle),
    ],
)
def test_the_ego_s_class_follows_the_action_type(action, expected):
    env = IntersectionLeftEnv({"action": action})
    assert type(env.vehicle) is expected
    if expected is MetaEgoVehicle:
        assert env.vehicle.target_speeds.tolist() == [0, 3, 6]


def test_highway_env_itself_is_left_alone():
    assert Vehicle.step.__globals__["np"] is MDPVehicle.steering_control.__globals__["np"] is np
    assert with_c_library(Vehicle.step).__globals__["np"] is not np
    assert with_c_library(Vehicle.step).__code__ is Vehicle.step.__code__


def test_what_a_program_replaces_is_called(monkeypatch):
    env = gymnasium.make("behavexplor/intersection-straight-v0").unwrapped
    env.reset(seed=0)
    monkeypatch.setattr(Vehicle, "step", lambda vehicle, dt: setattr(vehicle, "speed", 3.0))
    env.reset(seed=0)
    env.step(np.array([0.0, 0.0]))
    assert env.vehicle.speed == 3.0
    assert with_c_library(abs) is abs


def test_defaults_and_closures_are_kept():
    scale = 2.0

    def scaled(value, offset=1.0):
        return scale * np.sin(value) + offset

    assert with_c_library(scaled)(0.3) == 2.0 * math.sin(0.3) + 1.0
    assert with_c_library(scaled)(0.3, offset=0.0) == 2.0 * math.sin(0.3)
    for name, ours in zip(TRIGONOMETRY, ("sin", "cos", "tan", "asin", "atan", "atan2"), strict=True):
        assert getattr(c_library._NUMPY, name) is getattr(math, ours)
