"""The compiled episode of a single environment, and the objects of highway-env that show it."""

from typing import Any, Final

import numpy as np
from highway_env.vehicle.controller import MDPVehicle
from highway_env.vehicle.kinematics import Vehicle
from numpy.typing import NDArray

from behavexplor.data.scripted import ScriptedScenario
from behavexplor.data.trace import ENDS, Trace
from behavexplor.envs.tasks.scripted_episodes import WHOLE, ScriptedEpisodes
from behavexplor.envs.tasks.scripted_reward import TERMS

_ALL: Final = np.ones(1, dtype=bool)


class OneSlot:
    """An episode in the only slot of the engine.

    Args:
        env: the `behavexplor.envs.driving.DrivingEnv`, which has vehicles.
    """

    def __init__(self, env: Any) -> None:
        self._episodes = ScriptedEpisodes(env, 1)
        self.observes = self._episodes.observes  # whether the engine knows the observation

    @property
    def frame(self) -> int:
        """Number of frames since the episode began."""
        return int(self._episodes.slots.runs["frame"][0])

    @property
    def end(self) -> str | None:
        """Kind of the episode's end; None if it goes on."""
        end = int(self._episodes.ends[0])
        return ENDS[end] if end >= 0 else None

    @property
    def speed(self) -> float:
        """Speed of the ego [m/s]."""
        return float(self._episodes.speeds[0])

    def begin(self, scenario: ScriptedScenario) -> None:
        """Begin an episode."""
        self._episodes.begin(np.zeros(1, dtype=np.int64), [scenario])

    def decide(self, action: Any, n_frames: int = WHOLE) -> None:
        """Simulate a decision, or a part of it; see `ScriptedEpisodes.decide`."""
        self._episodes.decide(np.asarray(action)[None], _ALL, n_frames)

    def observation(self) -> NDArray[Any]:
        """Return the observation of the current state."""
        self._episodes.observe(_ALL)
        return np.array(self._episodes.observations[0])

    def terms(self) -> dict[str, float]:
        """Return the terms of the reward of the latest decision."""
        return dict(zip(TERMS, self._episodes.terms(_ALL)[:, 0].tolist(), strict=True))

    def trace(self) -> Trace:
        """Return the trace of the episode, which has ended."""
        return self._episodes.trace(0)

    def show(self, env: Any) -> None:
        """Give an environment's vehicles the state of the episode."""
        vehicles, slots = env.road.vehicles, self._episodes.slots
        ego, row, network = env.vehicle, slots.state.vehicles[0, 0], env.road.network
        _show_motion(ego, row)
        ego.lane_index = network.get_closest_lane_index(ego.position, ego.heading)
        ego.lane = network.get_lane(ego.lane_index)
        if isinstance(ego, MDPVehicle):
            lanes = list(network.lanes_dict())
            ego.target_lane_index, ego.speed_index = lanes[row.target_lane], int(row.speed_index)
            ego.target_speed = float(row.target_speed)
            ego.route = network.indexes(env.logical.roadmap.ego_route)[row.route_position :]
        for npc, motion in zip(vehicles[1:], slots.state.vehicles[0, 1:], strict=False):
            _show_motion(npc, motion)

    def take(self, env: Any) -> None:
        """Take over what a user has changed of the ego."""
        ego, row = env.vehicle, self._episodes.slots.state.vehicles[0, 0]
        (row.x, row.y), row.heading, row.speed = ego.position, ego.heading, ego.speed
        row.cos, row.sin = np.cos(row.heading), np.sin(row.heading)
        if isinstance(ego, MDPVehicle):
            lanes = list(env.road.network.lanes_dict())
            row.target_lane, row.speed_index = lanes.index(tuple(ego.target_lane_index)), ego.speed_index
            row.target_speed = ego.target_speed


def _show_motion(vehicle: Vehicle, row: Any) -> None:
    vehicle.position = np.array([row.x, row.y])
    vehicle.heading, vehicle.speed = float(row.heading), float(row.speed)
    vehicle.action = {"steering": float(row.steering), "acceleration": float(row.acceleration)}
