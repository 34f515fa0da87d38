"""The compiled vector environment beside gymnasium's `SyncVectorEnv` of highway-env's own environments.

In a process of its own (`compare_in_child`) numpy computes as the C library does, and nothing may differ at all. As a
script, this module is that process.
"""

import hashlib
import json
import logging
import sys
import warnings
from dataclasses import asdict, dataclass, field

import gymnasium
import highway_env  # noqa: F401 - registers the environments
import numpy as np
from gymnasium.envs.registration import load_env_creator
from gymnasium.vector import SyncVectorEnv
from gymnasium.wrappers import TimeLimit

import behavexplor
from behavexplor.envs.highway.highway_vector_env import HighwayVectorEnv
from tests.envs.highway.comparison import results_of_child

IDS = [name for name in behavexplor.HIGHWAY_ENV if name != "intersection-v1"]  # whose vehicle is dynamical


@dataclass
class Comparison:
    """What differs between the two."""

    decisions: int = 0
    episodes: int = 0
    worst: float = 0.0  # deviation of observations and rewards
    different: list[str] = field(default_factory=list)  # ends and infos
    digest: str = ""  # of our observations, rewards and ends


def original(env_id, config, num_envs, mode):
    spec = None if ":" in env_id else gymnasium.spec(env_id)
    env_class = load_env_creator(spec.entry_point if spec else env_id)
    limit = spec.max_episode_steps if spec else None

    def single():
        return TimeLimit(env_class(config), limit) if limit else env_class(config)

    return SyncVectorEnv([single] * num_envs, autoreset_mode=mode), limit


def loaded(policy):
    from stable_baselines3 import PPO  # noqa: PLC0415 - most comparisons need no torch

    return PPO.load(policy, device="cpu")


def compare(env_id, config=None, *, mode="NextStep", num_envs=2, decisions=20, episodes=10**9, seed=0, policy=None):
    """Drive both with the same actions: random ones, or those of a stored policy."""
    model = None if policy is None else loaded(policy)
    theirs, limit = original(env_id, config, num_envs, mode)
    env_class = type(theirs.envs[0].unwrapped)
    ours = HighwayVectorEnv(env_class, num_envs, config, autoreset_mode=mode, max_episode_steps=limit)
    result, digest = Comparison(), hashlib.sha256()
    if (ours.observation_space, ours.action_space) != (theirs.observation_space, theirs.action_space):
        result.different.append("spaces")
    expected, shown = theirs.reset(seed=seed), ours.reset(seed=seed)
    result.worst = deviation(expected[0], shown[0])
    note_infos(result, expected[1], shown[1], np.ones(num_envs, dtype=bool))
    theirs.action_space.seed(seed)
    while result.decisions < decisions and result.episodes < episodes and not result.different:
        ended = theirs._autoreset_envs.copy()
        actions = theirs.action_space.sample() if model is None else model.predict(expected[0], deterministic=True)[0]
        expected, shown = theirs.step(actions), ours.step(actions)
        result.worst = max(result.worst, deviation(expected[0], shown[0]), deviation(expected[1], shown[1]))
        done = expected[2] | expected[3]
        for name, these, those in zip(("terminated", "truncated"), expected[2:4], shown[2:4], strict=True):
            result.different += [name] if (these != those).any() else []
        note_infos(result, expected[4], shown[4], ended if mode == "NextStep" else done)
        result.decisions += 1
        result.episodes += int(done.sum())
        for part in shown[:4]:
            digest.update(part.tobytes())
    result.digest = digest.hexdigest()
    return result


def deviation(expected, shown):
    if expected.dtype != shown.dtype or (np.isnan(expected) != np.isnan(shown)).any():
        return np.inf
    return float(np.nanmax(np.abs(expected - shown), initial=0.0))


def note_infos(result, expected, shown, reset, path=""):
    """Note the entries of infos that differ. After a reset, highway-env draws an action for them without a seed."""
    for key in expected.keys() | shown.keys():
        name, these, those = f"{path}{key}", expected.get(key), shown.get(key)
        if these is None or those is None:
            result.different.append(f"missing {name}")
        elif isinstance(these, dict):
            note_infos(result, these, those, reset & (key != "final_info"), f"{name}.")
        elif key == "merging_speed_reward" and these.dtype == np.int64:
            continue  # gymnasium takes the type of the first value, and cuts off the others
        elif these.dtype != those.dtype or not alike(these, those, reset & (key in ("action", "lane_change_reward"))):
            result.different.append(name)


def alike(these, those, left_out):
    kept = ~left_out
    if these.dtype != object:
        return np.array_equal(these[kept], those[kept], equal_nan=True)
    pairs = zip(these[kept], those[kept], strict=True)
    return all((a is None and b is None) or np.array_equal(a, b, equal_nan=True) for a, b in pairs)


def compare_in_child(*calls):
    """Compare in a process in which numpy computes as the C library does; arguments of `compare` by name."""
    return [Comparison(**result) for result in results_of_child("tests.envs.highway.side_by_side", calls)]


def assert_equal(result):
    assert not result.different
    assert result.worst == 0.0
    assert result.decisions > 0


if __name__ == "__main__":
    logging.disable(logging.WARNING)  # highway-env's, about routes
    warnings.simplefilter("ignore")  # gymnasium's, about old versions
    sys.stdout.write(json.dumps([asdict(compare(**call)) for call in json.loads(sys.argv[1])]))
