"""Rewards and ends: highway-env's `_rewards` term by term, `_reward`, and `_is_terminated`."""

import sys
from typing import Any, Final

import numpy as np
from highway_env.vehicle.controller import MDPVehicle

from behavexplor.data.array_types import Floats
from behavexplor.envs.engine.lane_geometry import is_on_road, lane_coordinates
from behavexplor.envs.engine.lane_keeping import clip, nearest_speed
from behavexplor.envs.engine.state import MDP, NO_LANE, PLAIN, Records, Scene, Vehicle
from behavexplor.envs.engine.world import World
from behavexplor.envs.tasks.task import FLOAT, INTEGER, NO_TERM, NUMPY
from behavexplor.jit import kernel_inner

# Codes of terms. Those up to DEFAULT_SPEED_CHOICE are of the speed, those up to GOAL_LANE of the lane; see `_value`.
SPEED: Final = 0  # the ego's speed as a share of `reward_speed_range`, clipped to [0, 1]
SPEED_AHEAD: Final = 1  # the same of its speed along the x axis
FREE_SPEED: Final = 2  # the same of its speed, not clipped
SPEED_CHOICE: Final = 3  # the index of its target speed as a share of those of the actions
DEFAULT_SPEED_CHOICE: Final = 4  # the same of highway-env's default speeds; without a target, the nearest to its speed
LANE: Final = 5  # the number of its lane as a share of those of its road
TARGET_LANE: Final = 6  # the same of the lane to which it changes
LANE_NUMBER: Final = 7  # the number of its lane
TARGET_LANE_NUMBER: Final = 8  # the number of the lane to which it changes
LEFT_LANE: Final = 9  # how far to the left the lane is to which it changes, as a share
GOAL_LANE: Final = 10  # whether the lane to which it changes is a goal
SLOW_ON_GOAL: Final = 11  # how much slower than they want the vehicles on a goal lane are, as a sum of shares
CRASHED: Final = 12  # whether the ego has crashed
ON_ROAD: Final = 13  # whether it is on the road
ARRIVED: Final = 14  # whether it has arrived
LANE_CHANGE: Final = 15  # whether highway-env takes the action for a change of lane

_IS_SUM_COMPENSATED: Final = sys.version_info >= (3, 12)  # that of floats by Python's `sum`
_DEFAULT_SPEEDS: Floats = MDPVehicle.DEFAULT_TARGET_SPEEDS.astype(np.float64)


@kernel_inner
def put_terms(world: World, rules: Any, terms: Records, scene: Scene, changes_lane: bool, values: Floats) -> None:
    """Compute the terms of the reward into `values`, shape (terms,).

    `rules` is a `TASK` record. `changes_lane` says whether highway-env takes the action for a change of lane.
    """
    for k in range(len(terms)):
        values[k] = _value(world, rules, terms[k].code, scene, changes_lane)


@kernel_inner
def _value(world: World, rules: Any, code: int, scene: Scene, changes_lane: bool) -> float:
    """Return the value of a term."""
    if code <= DEFAULT_SPEED_CHOICE:
        return _speed_term(world, rules, code, scene)
    if code <= GOAL_LANE:
        return _lane_term(world, code, scene.vehicles[scene.episode.ego])
    if code == SLOW_ON_GOAL:
        return _slowness_on_goal(world, scene)
    return 1.0 if _is_true(world, rules, code, scene, changes_lane) else 0.0


@kernel_inner
def _speed_term(world: World, rules: Any, code: int, scene: Scene) -> float:
    """Return the value of a term of the ego's speed."""
    ego = scene.vehicles[scene.episode.ego]
    if code == SPEED_CHOICE:
        return float(ego.speed_index / (len(world.speeds) - 1))
    if code == DEFAULT_SPEED_CHOICE:
        is_mdp = scene.traits[scene.episode.ego].kind == MDP
        choice = int(ego.speed_index) if is_mdp else nearest_speed(_DEFAULT_SPEEDS, ego.speed)
        return choice / (len(_DEFAULT_SPEEDS) - 1)
    speed = ego.speed * ego.cos if code == SPEED_AHEAD else ego.speed
    share = 0 + (speed - rules.low_speed) * 1 / (rules.high_speed - rules.low_speed)
    return float(share if code == FREE_SPEED else clip(share, 0.0, 1.0))


@kernel_inner
def _lane_term(world: World, code: int, ego: Vehicle) -> float:
    """Return the value of a term of the ego's lane, or of the lane to which it changes."""
    lane = world.network.lanes[ego.lane]
    target = world.network.lanes[ego.lane if ego.target_lane == NO_LANE else ego.target_lane]
    n_lanes = world.network.roads[lane.road].n_lanes
    if code == GOAL_LANE:
        return 1.0 if target.is_goal else 0.0
    if code == LEFT_LANE:  # highway-env divides by 0 if there is one lane
        return float((n_lanes - 1 - target.number) / (n_lanes - 1)) if n_lanes > 1 else 0.0
    number = target.number if code in (TARGET_LANE, TARGET_LANE_NUMBER) else lane.number
    return float(number / max(n_lanes - 1, 1)) if code in (LANE, TARGET_LANE) else float(number)


@kernel_inner
def _is_true(world: World, rules: Any, code: int, scene: Scene, changes_lane: bool) -> bool:
    """Return the value of a term that is true or false."""
    ego = scene.vehicles[scene.episode.ego]
    if code == CRASHED:
        return bool(ego.crashed)
    if code == ON_ROAD:
        return is_on_road(world.network, ego)
    if code == LANE_CHANGE:
        return changes_lane
    return has_arrived(world, rules, scene)


@kernel_inner
def _slowness_on_goal(world: World, scene: Scene) -> float:
    """Return how much slower than they want the vehicles on a goal lane are, as a sum of shares."""
    total, compensation, kind = 0.0, 0.0, INTEGER
    for i in range(scene.episode.n_vehicles):
        vehicle = scene.vehicles[i]
        if world.network.lanes[vehicle.lane].is_goal and scene.traits[i].kind != PLAIN:
            share = (vehicle.target_speed - vehicle.speed) / vehicle.target_speed
            kind_of_share = NUMPY if scene.traits[i].kind == MDP else FLOAT
            total, compensation, kind = plus(total, compensation, kind, share, kind_of_share)
    return total + compensation


@kernel_inner
def reward_of(world: World, rules: Any, terms: Records, scene: Scene, values: Floats) -> float:
    """Compute the reward from the values of its terms."""
    reward, compensation, kind = 0.0, 0.0, INTEGER
    for k in range(len(terms)):
        item = terms[k].weight * values[k]
        reward, compensation, kind = plus(reward, compensation, kind, item, _number_of(world, terms[k], scene))
    reward += compensation
    if rules.arrival != NO_TERM and values[rules.arrival] != 0.0:
        reward = rules.arrived_reward
    if rules.first_gate != NO_TERM:
        reward *= values[rules.first_gate]
    if rules.is_normalized:
        reward = 0 + (reward - rules.worst) * 1 / (rules.best - rules.worst)
    if rules.is_clipped and rules.is_normalized:
        reward = clip(reward, 0.0, 1.0)
    if rules.gate != NO_TERM:
        reward *= values[rules.gate]
    return reward


@kernel_inner
def _number_of(world: World, term: Any, scene: Scene) -> int:
    """Return what kind of number a weighted term is in highway-env, where target speeds of the ego are numpy's."""
    ego = scene.episode.ego
    is_mdp_on_goal = scene.traits[ego].kind == MDP and world.network.lanes[scene.vehicles[ego].lane].is_goal
    return NUMPY if term.code == SLOW_ON_GOAL and is_mdp_on_goal else int(term.number_kind)


@kernel_inner
def plus(total: float, compensation: float, kind: int, item: float, kind_of_item: int) -> tuple[float, float, int]:
    """Add an item as Python's `sum` does: since Python 3.12, floats by Neumaier's compensated summation.

    Return the sum, its compensation, and its kind of number. The caller adds the compensation at the end. Here it is
    added where a number of numpy follows floats of Python.
    """
    if _IS_SUM_COMPENSATED and kind == FLOAT and kind_of_item == FLOAT:
        rounded = total + item
        compensation += (total - rounded) + item if abs(total) >= abs(item) else (item - rounded) + total
    elif kind_of_item == NUMPY:
        total += compensation
        compensation = 0.0
    return total + item, compensation, max(kind, kind_of_item)


@kernel_inner
def is_terminated(world: World, rules: Any, scene: Scene) -> bool:
    """Return whether the episode has ended by what happened in it."""
    ego = scene.vehicles[scene.episode.ego]
    if ego.crashed or ego.x > rules.end_x or has_arrived(world, rules, scene):
        return True
    return bool(rules.ends_off_road) and not is_on_road(world.network, ego)


@kernel_inner
def has_arrived(world: World, rules: Any, scene: Scene) -> bool:
    """Return whether the ego is past `arrival_station` on a goal lane: `IntersectionEnv.has_arrived`."""
    ego = scene.vehicles[scene.episode.ego]
    lane = world.network.lanes[ego.lane]
    return bool(lane.is_goal and lane_coordinates(lane, ego.x, ego.y)[0] >= rules.arrival_station)
