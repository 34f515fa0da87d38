"""Count the episodes of EnvPool that leave highway-env's: `python -m benchmarks.envpool_episodes [EPISODES]`.

EnvPool draws the starts of episodes with its own generator. So each of its starts is built in highway-env, and both
take the same random actions until either ends. It needs `pip install envpool`.
"""

import logging
import sys
import warnings
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle

from benchmarks.highway import ENVPOOL

IDS = ("highway-fast-v0", "merge-v0", "roundabout-v0", "exit-v0", "two-way-v0", "u-turn-v0", "highway-v0")
EPISODES = 40
EQUAL = 1e-6  # [m]


class Comparison(NamedTuple):
    """How an episode of EnvPool differs from highway-env's from the same start.

    Attributes:
        gap: the largest difference of a coordinate of a vehicle's position [m].
        ends_alike: whether both ended after the same decision.
    """

    gap: float
    ends_alike: bool


def compared(name: str, episodes: int) -> list[Comparison]:
    """Compare episodes of random actions in an environment, given by highway-env's id."""
    import envpool  # noqa: PLC0415 - not a dependency

    theirs = envpool.make_gymnasium(ENVPOOL[name], num_envs=1, num_threads=1, seed=0)
    env: Any = gymnasium.make(name).unwrapped
    rng = np.random.default_rng(0)
    found = []
    for episode in range(episodes):
        theirs.reset()
        env.reset(seed=episode)
        _load(env, theirs.debug_states([0])[0].vehicles)
        found.append(_drive(env, theirs, rng))
    return found


def _load(env: AbstractEnv, vehicles: Any) -> None:
    """Replace the vehicles of an environment with those of EnvPool. The first one is the ego."""
    ego, *others = vehicles
    built = _built(env, ego, type(env.vehicle), target_speeds=env.vehicle.target_speeds)
    built.speed_index, built.target_speed = ego.speed_index, ego.target_speed
    env.road.vehicles[:] = [built]
    for other in others:
        one = _built(env, other, IDMVehicle, enable_lane_change=other.enable_lane_change, timer=other.timer)
        one.DELTA, one.check_collisions = other.idm_delta, other.check_collisions
        env.road.vehicles.append(one)
    env.controlled_vehicles = [built]
    env.action_type.controlled_vehicle = env.observation_type.observer_vehicle = built


def _built(env: AbstractEnv, given: Any, kind: type[Any], **settings: Any) -> Any:
    lanes = zip(given.route_from, given.route_to, given.route_id, strict=True)
    return kind(
        env.road,
        np.array([given.x, given.y]),
        given.heading,
        given.speed,
        target_lane_index=(given.target_lane_from, given.target_lane_to, given.target_lane_index),
        target_speed=given.target_speed,
        route=[(start, end, None if lane < 0 else lane) for start, end, lane in lanes] or None,
        **settings,
    )


def _drive(env: AbstractEnv, theirs: Any, rng: np.random.Generator) -> Comparison:
    """Take the same random actions in both environments until either ends."""
    gap = 0.0
    while True:
        action = rng.integers(env.action_space.n)
        *_, terminated, truncated, _ = env.step(action)
        *_, their_termination, their_truncation, _ = theirs.step(np.array([action]))
        over, is_theirs_over = terminated or truncated, bool(their_termination[0] or their_truncation[0])
        if over or is_theirs_over:
            return Comparison(gap, over == is_theirs_over)
        gap = max(gap, _gap(env.road.vehicles, theirs.debug_states([0])[0].vehicles))


def _gap(ours: list[Vehicle], theirs: Any) -> float:
    if len(ours) != len(theirs):
        return np.inf
    return float(np.abs([(a.position[0] - b.x, a.position[1] - b.y) for a, b in zip(ours, theirs, strict=True)]).max())


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    logging.disable(logging.WARNING)  # highway-env's, about routes
    for name in IDS:
        found = compared(name, int(sys.argv[1]) if len(sys.argv) > 1 else EPISODES)
        left, others = sum(one.gap > EQUAL for one in found), sum(not one.ends_alike for one in found)
        worst = max(one.gap for one in found)
        print(f"{name}: {left} of {len(found)} leave highway-env's, {others} end otherwise; up to {worst:.2g} m apart")
