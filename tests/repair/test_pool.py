"""The pool of a retraining follows the policy."""

import numpy as np
import pytest

from behavexplor.data.scenario import read_scenarios
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.envs.functional import LaneChangeEnv
from behavexplor.repair.retraining import FULL, MOST, Pool

LOGICAL = LaneChangeEnv.logical


def scenarios(count, seed=0):
    generator = np.random.default_rng(seed)
    return [LOGICAL.sample(generator) for _ in range(count)]


def test_a_share_of_the_episodes_comes_from_the_pool():
    known = [ScriptedScenario(f"place-{i}", ()) for i in range(FULL)]
    for count, low, high in ((FULL, 0.55, 0.75), (FULL // 2, 0.22, 0.43)):
        pool, rng = Pool(LOGICAL, 0.65, known[:count]), np.random.default_rng(1)
        assert low < np.mean([pool.sample(rng) in known for _ in range(150)]) < high


def test_without_scenarios_every_episode_is_ordinary():
    rng, other = np.random.default_rng(2), np.random.default_rng(2)
    assert Pool(LOGICAL, 0.5).sample(rng) == LOGICAL.sample(other)


def test_a_scenario_enters_once_and_leaves_when_it_is_passed():
    first, second = scenarios(2)
    pool = Pool(LOGICAL, 0.5, [first, second, first])
    assert len(pool) == 2
    digest = pool.digest
    pool.discard(first)
    pool.discard(first)
    assert len(pool) == 1
    assert pool.digest != digest
    pool.add(second)
    assert len(pool) == 1


def test_the_oldest_leaves_a_full_pool():
    many = [ScriptedScenario(f"place-{i}", ()) for i in range(MOST + 1)]
    pool = Pool(LOGICAL, 0.5, many)
    assert len(pool) == MOST
    pool.add(many[0])
    assert len(pool) == MOST


def test_it_is_the_same_when_it_is_read_again(tmp_path):
    pool = Pool(LOGICAL, 0.5, scenarios(4))
    pool.write(tmp_path / "pool.jsonl")
    assert Pool(LOGICAL, 0.5, read_scenarios(tmp_path / "pool.jsonl", LOGICAL)).digest == pool.digest


@pytest.mark.parametrize("share", [0.0, 0.9])
def test_its_draws_depend_on_the_generator_alone(share):
    pool = Pool(LOGICAL, share, scenarios(5))
    assert pool.sample(np.random.default_rng(7)) == pool.sample(np.random.default_rng(7))
