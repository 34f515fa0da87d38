"""The reward: R1-R3 and progress, term by term."""

import math
from functools import reduce
from operator import add

import gymnasium
import numpy as np
import pytest

from behavexplor.data.scripted import NPC, ScriptedScenario, Waypoint
from behavexplor.data.trace import ENDS
from behavexplor.envs.functional import IntersectionStraightEnv
from behavexplor.envs.tasks.scripted_outcome import TERMS, WEIGHTS, reward_terms
from behavexplor.envs.tasks.scripted_slots import RUN, RUNNING
from behavexplor.judge.specs import judge

S1 = "behavexplor/intersection-straight-v0"
CONTINUOUS = {"type": "ContinuousAction", "acceleration_range": [-8.0, 4.0], "steering_range": [-0.6, 0.6]}
GO, HOLD = np.array([1.0, 0.0]), np.array([1 / 3, 0.0])


def terms(**changes):
    """The terms of three slots, of which the last is not active."""
    runs = np.zeros(3, RUN)
    runs["end"] = RUNNING
    for name, value in changes.items():
        runs[name] = ENDS.index(value) if name == "end" else value
    many = reward_terms(WEIGHTS, runs, np.array([True, True, False]))
    assert (many[:, 0] == many[:, 1]).all()
    assert not many[:, 2].any()
    return dict(zip(TERMS, many[:, 0], strict=True))


@pytest.mark.parametrize(
    ("happened", "expected"),
    [
        ({"progress": 1.1}, {"progress": 0.11}),
        ({"mean_acceleration": -3.0}, {"effort": -0.018}),
        ({"touched": True}, {"lines": -8.0}),
        ({"end": "collision"}, {"collision": -20.0}),
        ({"end": "collision", "rear_end": True}, {"rear_end": -2.0}),
        ({"end": "arrived"}, {"arrived": 10.0}),
        ({"end": "passed"}, {"missed": -4.0}),
        ({"end": "standstill"}, {"missed": -4.0}),
        ({"end": "timeout"}, {"missed": -4.0}),
    ],
)
def test_terms(happened, expected):
    assert terms(**happened) == pytest.approx({**dict.fromkeys(WEIGHTS, 0.0), "step": -0.02, **expected})


def episode(scenario, policy, **config):
    """Rewards and terms of all decisions of an episode."""
    env = gymnasium.make(S1, config={"action": CONTINUOUS, **config}).unwrapped
    env.reset(options={"scenario": scenario})
    rewards, log = [], []
    while True:
        _, reward, terminated, truncated, info = env.step(policy(env.vehicle))
        rewards.append(reward)
        log.append(info["rewards"])
        if terminated or truncated:
            return np.array(rewards), log


def cruise(vehicle):
    return GO if vehicle.speed < 10 else HOLD


def test_an_arrival_is_worth_its_way():
    rewards, log = episode(ScriptedScenario("intersection-straight", ()), cruise)
    assert rewards.tolist() == [reduce(add, terms.values()) for terms in log]
    driven = sum(terms["progress"] for terms in log) / WEIGHTS["progress"]
    assert driven == pytest.approx(160, abs=1.1)  # arrival is within a meter of the destination
    assert log[-1]["arrived"] == 10
    assert all(terms["arrived"] == terms["collision"] == terms["lines"] == 0 for terms in log[:-1])


def test_a_line_counts_once():
    def drift(vehicle):
        steering = -0.05 if vehicle.heading > -math.pi / 2 - 0.1 else 0.05
        return np.array([1.0 if vehicle.speed < 8 else 1 / 3, steering])

    _, log = episode(ScriptedScenario("intersection-straight", ()), drift, duration=15.0)
    assert sum(terms["lines"] for terms in log) == WEIGHTS["lines"]


def test_standing_in_front_of_a_fast_car_is_a_rear_end():
    ranges = IntersectionStraightEnv.logical.position_ranges(
        IntersectionStraightEnv.logical.roadmap.routes["south-inner-straight"]
    )
    chaser = [Waypoint(2.6, 11.0)] + [Waypoint(float(high), 11.0) for _, high in ranges[1:-1]]
    npc = NPC("sedan", "south-inner-straight", (*chaser, Waypoint(float(ranges[-1, 1]), 0.0)))
    _, log = episode(ScriptedScenario("intersection-straight", (npc,)), lambda _: HOLD)
    assert (log[-1]["rear_end"], log[-1]["collision"]) == (-2.0, 0.0)


def test_weights_are_config():
    weights = {"arrived": 100.0, "progress": 0.0}
    rewards, log = episode(ScriptedScenario("intersection-straight", ()), cruise, reward=weights)
    assert log[-1]["arrived"] == 100
    assert all(terms["progress"] == 0 for terms in log)
    assert rewards[-1] > 99


def test_the_line_term_agrees_with_the_spec():
    env = gymnasium.make(S1, config={"duration": 8.0, "logical": {"n_npcs": 0}}).unwrapped
    rng = np.random.default_rng(0)
    touched = []
    for _ in range(25):
        env.reset()
        steering, lines = rng.normal(0, 0.005), 0.0
        while True:
            *_, terminated, truncated, info = env.step(np.array([0.6, steering]))
            lines += info["rewards"]["lines"]
            if terminated or truncated:
                break
        touched.append("lines" in judge(info["trace"]).violated)
        assert lines == (WEIGHTS["lines"] if touched[-1] else 0.0)
    assert 5 < sum(touched) < 20
