"""Plain highway-env on the same scenarios, as the reference for benchmarks.

The road is the scenario's, built from highway-env's own lanes and network. The NPCs are highway-env's `IDMVehicle` with
the routes and first speeds of the scenario. The ego is its `Vehicle` at a constant speed. This package's simulation
engine is not used.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle

from behavexplor.data.roadmap import RoadMap
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.envs.road_objects import road_network

FREQUENCY, DECISIONS = 20, 10  # [Hz]


def stock_road(scenario: ScriptedScenario, roadmap: RoadMap) -> tuple[Road, Vehicle]:
    """Return a scenario as a road with highway-env's objects, and the ego."""
    ours = road_network(roadmap)
    network = RoadNetwork()
    network.graph = ours.graph
    road = Road(network, np_random=np.random.RandomState(0))
    x, y, heading = roadmap.start_pose
    ego = Vehicle(road, np.array([x, y]), heading=heading, speed=0.0)
    road.vehicles = [ego]
    for npc in scenario.npcs:
        route = roadmap.routes[npc.route]
        first = npc.waypoints[0]
        x, y, heading = route.pose(first.position)
        vehicle = IDMVehicle(road, np.array([x, y]), heading=heading, speed=first.speed, target_speed=first.speed)
        vehicle.route = ours.indexes(route)
        road.vehicles.append(vehicle)
    return road, ego


def drive_objects(scenario: ScriptedScenario, roadmap: RoadMap, seconds: float, policy: Any = None) -> None:
    """Simulate a scenario for a time [s] without observations. A policy is called with zeros ten times a second."""
    road, ego = stock_road(scenario, roadmap)
    for step in range(round(seconds * FREQUENCY)):
        if policy is not None and step % (FREQUENCY // DECISIONS) == 0:
            policy.predict(np.zeros(policy.observation_space.shape, dtype=np.float32), deterministic=True)
        ego.act({"acceleration": 1.0 if ego.speed < 10 else 0.0, "steering": 0.0})
        road.act()
        road.step(1 / FREQUENCY)


class StockEnv(AbstractEnv):  # type: ignore[misc]
    """The same scenarios as a gymnasium environment with highway-env's Kinematics observation."""

    scenario: ScriptedScenario
    roadmap: RoadMap

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        """Return highway-env's default configuration with this package's frequencies."""
        own = {"simulation_frequency": FREQUENCY, "policy_frequency": DECISIONS}
        return {**super().default_config(), "action": {"type": "ContinuousAction"}, **own}

    def _reset(self) -> None:
        self.road, ego = stock_road(self.scenario, self.roadmap)
        self.controlled_vehicles = [ego]

    def _reward(self, action: Any) -> float:  # noqa: ARG002 - highway-env's signature
        return 0.0

    def _is_terminated(self) -> bool:
        return False

    def _is_truncated(self) -> bool:
        return False


def drive_env(scenarios: Sequence[ScriptedScenario], roadmap: RoadMap, seconds: Sequence[float]) -> None:
    """Run scenarios in `StockEnv`, each for its time [s]."""
    StockEnv.scenario, StockEnv.roadmap = scenarios[0], roadmap
    env = StockEnv()
    for scenario, time in zip(scenarios, seconds, strict=True):
        StockEnv.scenario = scenario
        env.reset()
        for _ in range(round(time * DECISIONS)):
            env.step(np.array([0.2 if env.vehicle.speed < 10 else 0.0, 0.0]))
    env.close()
