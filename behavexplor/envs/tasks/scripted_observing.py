"""The `Scene` and `Kinematics` observations of all egos."""

import math

import numpy as np
from numpy.typing import NDArray

from behavexplor.data import scene
from behavexplor.envs.engine.lane_geometry import closest_lane
from behavexplor.envs.engine.lane_network import Network
from behavexplor.envs.engine.observing import LONG_OFF, View, observe
from behavexplor.envs.engine.state import Scene, Scratch, Vehicle
from behavexplor.envs.tasks.scripted_slots import ScriptedSlots
from behavexplor.envs.tasks.scripted_world import ScriptedWorld
from behavexplor.jit import kernel_in_place, kernel_inner

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]


@kernel_in_place
def observe_scene(slots: ScriptedSlots, chosen: Bools, observations: Floats) -> None:
    """Fill the `Scene` observations of the chosen slots, shape (B, 1 + N, 8); see `behavexplor.data.scene`."""
    for b in range(len(chosen)):
        if not chosen[b]:
            continue
        observations[b] = 0.0
        vehicles, traits = slots.state.vehicles[b], slots.state.traits[b]
        for i in range(slots.state.episodes[b].n_vehicles):
            row, vehicle, size = observations[b, i], vehicles[i], traits[i]
            row[scene.PRESENT] = 1.0
            row[scene.X], row[scene.Y], row[scene.HEADING] = vehicle.x, vehicle.y, vehicle.heading
            row[scene.SPEED], row[scene.ACCELERATION] = vehicle.speed, vehicle.acceleration
            row[scene.LENGTH], row[scene.WIDTH] = size.length, size.width


@kernel_in_place
def observe_kinematics(
    world: ScriptedWorld, slots: ScriptedSlots, view: View, scratch: Scratch, chosen: Bools, observations: Singles
) -> None:
    """Fill the Kinematics observations of the chosen slots, shape (B, vehicles_count, features)."""
    shows_lanes = False
    for k in range(len(view.columns)):
        shows_lanes |= view.columns[k].feature >= LONG_OFF
    state = slots.state
    for b in range(len(chosen)):
        if not chosen[b]:
            continue
        watched = Scene(state.episodes[b], state.vehicles[b], state.traits[b], state.routes[b], scratch)
        _update_lane(world.network, watched.vehicles[0])
        for i in range(1, watched.episode.n_vehicles):
            npc = watched.vehicles[i]
            npc.cos, npc.sin = math.cos(npc.heading), math.sin(npc.heading)
            if shows_lanes:
                _update_lane(world.network, npc)
        observe(world.network, view, watched, observations[b])


@kernel_inner
def _update_lane(network: Network, vehicle: Vehicle) -> None:
    vehicle.lane = closest_lane(network, vehicle.lane, vehicle.x, vehicle.y, vehicle.heading)[0]
