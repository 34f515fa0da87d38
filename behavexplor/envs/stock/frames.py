"""Simulate one decision of every episode: the ego's command, then frames of decisions, motion and collisions."""

import numpy as np
from numpy.typing import NDArray

from behavexplor.envs.engine.bicycle import move
from behavexplor.envs.engine.contact import collide
from behavexplor.envs.engine.frame_log import FrameLog, log_frame
from behavexplor.envs.engine.lane_geometry import coordinates_on, lane_coordinates, note_places, update_lane
from behavexplor.envs.engine.lane_keeping import keep_lane_and_speed, take_maneuver
from behavexplor.envs.engine.lane_network import Network
from behavexplor.envs.engine.reactive_traffic import UNKNOWN, drive
from behavexplor.envs.engine.regulation import enforce_rules
from behavexplor.envs.engine.state import IDM, LINEAR, MDP, NO_ROUTE, PLAIN, Records, Scene, Scratch, Slots
from behavexplor.envs.stock.stock_world import Rules, World
from behavexplor.jit import kernel_inner

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@kernel_inner
def step(world: World, slots: Slots, scratch: Scratch, commands: Floats, active: Bools, log: FrameLog) -> None:
    """Simulate one decision of many episodes.

    Args:
        world: the environment's road and rules.
        slots: the episodes, changed in place.
        scratch: memory that is used within a frame.
        commands: acceleration [m/s2] and steering [rad], shape (B, 2). For meta-actions, the first column is the index
            of the maneuver in `behavexplor.data.conventions.MANEUVERS`.
        active: whether each slot is stepped, shape (B,).
        log: filled with the frames, as far as it has room for them.
    """
    for b in range(len(active)):
        if active[b]:
            scene = Scene(slots.episodes[b], slots.vehicles[b], slots.traits[b], slots.routes[b], scratch)
            give_command(world, scene, commands[b, 0], commands[b, 1])
            run_frames(world.network, world.rules[0], scene, world.rules[0].n_frames, log.frames[b], log.things[b])


@kernel_inner
def give_command(world: World, scene: Scene, first: float, second: float) -> None:
    """Begin a decision: count it, and give the ego its command.

    Args:
        world: the environment's road and rules.
        scene: the episode, changed in place.
        first: first number of the ego's command; see `step`.
        second: second number of the ego's command.
    """
    rules, episode = world.rules[0], scene.episode
    episode.time += rules.policy_period
    episode.frames += rules.n_frames
    ego = scene.vehicles[episode.ego]
    if scene.traits[episode.ego].kind == MDP:
        take_maneuver(world.network, world.speeds, ego, scene.routes[episode.ego], int(first))
    else:
        ego.acceleration, ego.steering = first, second


@kernel_inner
def run_frames(network: Network, rules: Rules, scene: Scene, n_frames: int, frames: Records, things: Records) -> None:
    """Simulate some frames: `Road.act` and `Road.step`.

    Args:
        network: the road network.
        rules: the record of `World.rules`.
        scene: the episode, changed in place.
        n_frames: number of frames.
        frames: row of `FrameLog.frames`; frames beyond its length are not logged.
        things: row of `FrameLog.things`.
    """
    episode = scene.episode
    note_places(network, scene)
    for k in range(n_frames):
        scene.scratch.n_on_lane[:] = UNKNOWN
        for i in range(episode.n_vehicles):
            kind, vehicle = scene.traits[i].kind, scene.vehicles[i]
            if kind == MDP:
                station, offset = coordinates_on(network, scene, i, vehicle.target_lane)
                keep_lane_and_speed(network, vehicle, scene.routes[i], scene.traits[i].length, station, offset)
            elif kind != PLAIN and not vehicle.crashed:
                drive(network, scene, i)
        if rules.regulation_period > 0:
            episode.road_frames += 1
            if episode.road_frames % rules.regulation_period == 0:
                enforce_rules(network, scene)
        for i in range(episode.n_vehicles):
            vehicle, traits = scene.vehicles[i], scene.traits[i]
            if traits.kind in (IDM, LINEAR):
                vehicle.timer += rules.dt
            move(vehicle, traits, rules.dt)
            update_lane(network, scene, i)
        collide(scene.vehicles, scene.traits, episode.n_vehicles, episode.n_obstacles, rules.dt, scene.scratch.xs)
        if k < len(frames):
            log_frame(network, scene, frames[k], things[k])


@kernel_inner
def clear_vehicles(network: Network, scene: Scene) -> None:
    """Remove the traffic that leaves an intersection, in its order: `IntersectionEnv._clear_vehicles`.

    The scene has no obstacles.
    """
    kept = 0
    for i in range(scene.episode.n_vehicles):
        is_ego = scene.traits[i].kind in (PLAIN, MDP)
        if not is_ego and _is_leaving(network, scene, i):
            continue
        if kept != i:
            scene.vehicles[kept], scene.traits[kept] = scene.vehicles[i], scene.traits[i]
            for k in range(scene.vehicles[i].route_length):
                scene.routes[kept, k] = scene.routes[i, k]
            if scene.episode.ego == i:
                scene.episode.ego = kept
        kept += 1
    scene.episode.n_vehicles = kept


@kernel_inner
def _is_leaving(network: Network, scene: Scene, i: int) -> bool:
    vehicle = scene.vehicles[i]
    if vehicle.route_length == NO_ROUTE:
        return True
    lane = network.lanes[vehicle.lane]
    station, _ = lane_coordinates(lane, vehicle.x, vehicle.y)
    return bool(lane.is_goal and station >= lane.length - 4 * scene.traits[i].length)
