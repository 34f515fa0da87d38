"""Plain highway-env on the same scenarios: what our figures are compared with.

The road is ours, of highway-env's own lanes and network; the NPCs are highway-env's `IDMVehicle` with the routes and
first speeds of the scenario, the ego is its `Vehicle` at a constant speed. Nothing of our engine is used.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle

from behavexplor.data.roadmap import RoadMap
from behavexplor.data.scenario import Scenario
from behavexplor.envs.network import road_network

FREQUENCY, DECISIONS = 20, 10  # [Hz]


def stock_road(scenario: Scenario, roadmap: RoadMap) -> tuple[Road, Vehicle]:
    """A scenario as highway-env's objects, and the ego among them."""
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


def drive_objects(scenario: Scenario, roadmap: RoadMap, seconds: float, policy: Any = None) -> None:
    """Simulate a scenario for a time [s], without any observation; a policy is shown zeros ten times a second."""
    road, ego = stock_road(scenario, roadmap)
    for step in range(round(seconds * FREQUENCY)):
        if policy is not None and step % (FREQUENCY // DECISIONS) == 0:
            policy.predict(np.zeros(policy.observation_space.shape, dtype=np.float32), deterministic=True)
        ego.act({"acceleration": 1.0 if ego.speed < 10 else 0.0, "steering": 0.0})
        road.act()
        road.step(1 / FREQUENCY)


class StockEnv(AbstractEnv):  # type: ignore[misc]
    """The same as a gymnasium environment with highway-env's own Kinematics observation."""

    scenario: Scenario
    roadmap: RoadMap

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        """highway-env's own, at our frequencies."""
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


def drive_env(scenarios: Sequence[Scenario], roadmap: RoadMap, seconds: Sequence[float]) -> None:
    """Run scenarios in `StockEnv`, each for its time [s]."""
    StockEnv.scenario, StockEnv.roadmap = scenarios[0], roadmap
    env = StockEnv()
    for scenario, time in zip(scenarios, seconds, strict=True):
        StockEnv.scenario = scenario
        env.reset()
        for _ in range(round(time * DECISIONS)):
            env.step(np.array([0.2 if env.vehicle.speed < 10 else 0.0, 0.0]))
    env.close()
