"""Rewards and ends of each environment: highway-env's `_rewards`, `_reward`, `_is_terminated` and `_is_truncated`."""

from typing import Final

import numpy as np
from highway_env.vehicle.controller import MDPVehicle
from numpy.typing import NDArray

from behavexplor.envs.engine.lane_geometry import is_on_road, lane_coordinates
from behavexplor.envs.engine.lane_keeping import clip, nearest_speed
from behavexplor.envs.engine.state import MDP, NO_LANE, PLAIN, Scene
from behavexplor.envs.stock.stock_world import World
from behavexplor.envs.stock.task import (
    EXIT,
    HIGHWAY,
    INTERSECTION,
    MERGE,
    ROUNDABOUT,
    TWO_WAY,
    U_TURN,
    Task,
)
from behavexplor.jit import kernel_inner

Floats = NDArray[np.float64]

MERGE_END: Final = 370.0  # x beyond which the merge ends [m]
ARRIVED_AT: Final = 25.0  # station on a lane out of the intersection [m]
_DEFAULT_SPEEDS: Floats = MDPVehicle.DEFAULT_TARGET_SPEEDS.astype(np.float64)


@kernel_inner
def put_terms(world: World, task: Task, scene: Scene, changes_lane: bool, terms: Floats) -> None:
    """Compute the terms of the reward, in the order of `behavexplor.envs.stock.task.TERMS`.

    Args:
        world: the environment's road.
        task: the environment's rewards.
        scene: the episode.
        changes_lane: whether highway-env takes the action for a change of lane.
        terms: the terms, shape (5,).
    """
    network, rules, kind = world.network, task.rules[0], task.rules[0].kind
    ego = scene.vehicles[scene.episode.ego]
    lane = network.lanes[ego.lane]
    target = network.lanes[ego.lane if ego.target_lane == NO_LANE else ego.target_lane]
    n_lanes = network.roads[lane.road].n_lanes
    speed = ego.speed * ego.cos if kind == HIGHWAY else ego.speed
    share = 0 + (speed - rules.low_speed) * 1 / (rules.high_speed - rules.low_speed)
    if kind != MERGE:
        share = clip(share, 0.0, 1.0)
    if kind == TWO_WAY:
        terms[0] = ego.speed_index / (len(world.speeds) - 1)
        terms[1] = (n_lanes - 1 - target.number) / (n_lanes - 1) if n_lanes > 1 else 0.0  # highway-env divides by 0
        return
    terms[0] = 1.0 if ego.crashed else 0.0
    on_road = 1.0 if is_on_road(network, ego) else 0.0
    if kind in (HIGHWAY, U_TURN):
        terms[1] = (target if kind == HIGHWAY else lane).number / max(n_lanes - 1, 1)
        terms[2], terms[3] = share, on_road
    elif kind == MERGE:
        terms[1], terms[2], terms[3] = lane.number / 1, share, 1.0 if changes_lane else 0.0
        terms[4] = _slowness_on_ramp(world, scene)
    elif kind == ROUNDABOUT:
        terms[1] = _speed_index(scene) / (len(_DEFAULT_SPEEDS) - 1)
        terms[2], terms[3] = 1.0 if changes_lane else 0.0, on_road
    elif kind == EXIT:
        terms[1], terms[2], terms[3] = 1.0 if target.is_goal else 0.0, share, target.number
    elif kind == INTERSECTION:
        terms[1], terms[2], terms[3] = share, 1.0 if has_arrived(world, scene) else 0.0, on_road


@kernel_inner
def reward_of(task: Task, terms: Floats) -> float:
    """Compute the reward from its terms."""
    rules, kind = task.rules[0], task.rules[0].kind
    reward = 0.0
    for k in range(len(task.weights)):
        reward += task.weights[k] * terms[k]
    if kind == INTERSECTION:
        reward = (rules.arrived_reward if terms[2] != 0.0 else reward) * terms[3]
    if rules.is_normalized:
        reward = 0 + (reward - rules.worst) * 1 / (rules.best - rules.worst)
    if kind == EXIT and rules.is_normalized:
        reward = clip(reward, 0.0, 1.0)
    if kind in (HIGHWAY, ROUNDABOUT, U_TURN):
        reward *= terms[3]
    return reward


@kernel_inner
def is_terminated(world: World, task: Task, scene: Scene) -> bool:
    """Return whether the episode has ended by what happened in it."""
    rules, ego = task.rules[0], scene.vehicles[scene.episode.ego]
    if ego.crashed:
        return True
    if rules.kind == MERGE:
        return bool(ego.x > MERGE_END)
    if rules.kind == INTERSECTION and has_arrived(world, scene):
        return True
    return bool(rules.ends_off_road) and not is_on_road(world.network, ego)


@kernel_inner
def has_arrived(world: World, scene: Scene) -> bool:
    """Return whether the ego has left the intersection: `IntersectionEnv.has_arrived`."""
    ego = scene.vehicles[scene.episode.ego]
    lane = world.network.lanes[ego.lane]
    return bool(lane.is_goal and lane_coordinates(lane, ego.x, ego.y)[0] >= ARRIVED_AT)


@kernel_inner
def _speed_index(scene: Scene) -> int:
    """Return the index of the ego's target speed, or of the default one that is nearest to its speed."""
    ego = scene.vehicles[scene.episode.ego]
    if scene.traits[scene.episode.ego].kind == MDP:
        return int(ego.speed_index)
    return nearest_speed(_DEFAULT_SPEEDS, ego.speed)


@kernel_inner
def _slowness_on_ramp(world: World, scene: Scene) -> float:
    """Return how much slower than they want the vehicles on the merging lane are, as a sum of shares."""
    total = 0.0
    for i in range(scene.episode.n_vehicles):
        vehicle = scene.vehicles[i]
        if world.network.lanes[vehicle.lane].is_goal and scene.traits[i].kind != PLAIN:
            total += (vehicle.target_speed - vehicle.speed) / vehicle.target_speed
    return total
