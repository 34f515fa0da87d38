"""Simulation on highway-env's objects, frame by frame, of what the compiled engine does not support."""

from typing import Any

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.road.road import Road

from behavexplor.data.conventions import ARRIVAL_DISTANCE, PASSED_DISTANCE, STANDING_SPEED, STANDSTILL_TIME
from behavexplor.data.npc_motion import motion_table
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.data.scripted_logical import ScriptedLogicalScenario
from behavexplor.data.trace import Trace
from behavexplor.data.vehicle_sizes import VEHICLE_SIZES
from behavexplor.envs.network import road_network
from behavexplor.envs.recorder import Recorder
from behavexplor.envs.vehicles import ScriptedVehicle, place_ego


class PlainSimulation(AbstractEnv):  # type: ignore[misc]
    """An environment of highway-env whose NPCs play back a scenario, and which records its episodes."""

    logical: ScriptedLogicalScenario
    config: dict[str, Any]
    action_type: Any  # highway-env has no annotations
    _recorder: Recorder
    _end: str | None = None
    _terms: dict[str, float]

    def _place(self, scenario: ScriptedScenario) -> None:
        """Put the ego and the NPCs of a scenario on a new road, and begin their record."""
        roadmap = self.logical.roadmap
        network = road_network(roadmap)
        self.road = Road(network, np_random=self.np_random)
        ego = place_ego(
            self.action_type.vehicle_class, self.road, roadmap.start_pose, network.indexes(roadmap.ego_route)
        )
        n_frames = int(self.config["duration"] * self.config["simulation_frequency"]) + 1
        time = np.arange(n_frames + 1) / self.config["simulation_frequency"]
        motion = motion_table(scenario, roadmap, time)
        npcs = [
            ScriptedVehicle(
                self.road, VEHICLE_SIZES[npc.type], motion[:, i], network.indexes(roadmap.routes[npc.route])
            )
            for i, npc in enumerate(scenario.npcs)
        ]
        self.controlled_vehicles = [ego]
        self.road.vehicles = [ego, *npcs]
        self._recorder = Recorder(roadmap, time, motion, [(v.LENGTH, v.WIDTH) for v in self.road.vehicles])
        self._recorder.frame(ego)

    def _simulate(self, action: Any = None) -> None:
        """Simulate until the next decision, or until the episode ends."""
        self._recorder.action(action)
        self.action_type.act(action)
        substeps = self.config["simulation_frequency"] // self.config["policy_frequency"]
        for substep in range(substeps):
            self.road.act()
            self.road.step(1 / self.config["simulation_frequency"])
            self.steps += 1
            self._recorder.frame(self.vehicle)
            self._end = self._find_end()
            if self._end is not None:
                break
            if substep < substeps - 1:
                self._automatic_rendering()
        self.enable_auto_render = False
        self._terms = self._recorder.reward_terms(self.config["reward"], self._end)

    def _find_end(self) -> str | None:
        roadmap = self.logical.roadmap
        if self._recorder.touched_npcs():
            return "collision"
        gap = self.vehicle.position - roadmap.destination_point
        if np.hypot(*gap) <= ARRIVAL_DISTANCE:
            return "arrived"
        if gap @ roadmap.destination_direction > PASSED_DISTANCE:
            return "passed"
        if self._recorder.standing_frames(STANDING_SPEED) >= STANDSTILL_TIME * self.config["simulation_frequency"]:
            return "standstill"
        if self.steps >= self.config["duration"] * self.config["simulation_frequency"]:
            return "timeout"
        return None

    def _trace(self, end: str) -> Trace:
        return self._recorder.trace(end)
