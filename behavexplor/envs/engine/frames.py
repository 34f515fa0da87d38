"""Simulate one decision of every episode: the ego's command, then frames of decisions, motion and collisions."""

from behavexplor.envs.engine.bicycle import move
from behavexplor.envs.engine.contact import collide
from behavexplor.envs.engine.frame_log import log_frame
from behavexplor.envs.engine.lane_geometry import coordinates_on, note_places, update_lane
from behavexplor.envs.engine.lane_keeping import keep_lane_and_speed, take_maneuver
from behavexplor.envs.engine.lane_network import Network
from behavexplor.envs.engine.reactive_traffic import UNKNOWN, drive
from behavexplor.envs.engine.regulation import enforce_rules
from behavexplor.envs.engine.state import IDM, LINEAR, MDP, PLAIN, Records, Scene
from behavexplor.envs.engine.world import Rules, World
from behavexplor.jit import kernel_inner


@kernel_inner
def give_command(world: World, scene: Scene, first: float, second: float) -> None:
    """Begin a decision: count it, and give the ego its command.

    Args:
        world: the environment's road and rules.
        scene: the episode, changed in place.
        first: the ego's acceleration [m/s2]; for meta-actions, the index of the maneuver in
            `behavexplor.data.conventions.MANEUVERS`.
        second: its steering [rad].
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
