"""The log of the compiled engine beside highway-env's own vehicles after each frame.

In a process of its own (`compare_in_child`) numpy computes as the C library does, and nothing may differ at all. As a
script, this module is that process.
"""

import json
import logging
import sys
from dataclasses import asdict, dataclass, field

import numpy as np

from behavexplor.envs.engine.lane_network import lane_indexes
from behavexplor.envs.highway.highway_vector_env import HighwayVectorEnv
from tests.envs.highway.comparison import make, results_of_child
from tests.envs.highway.side_by_side import deviation

VALUES = ("x", "y", "heading", "speed", "lane", "target_lane")


@dataclass
class Comparison:
    """What differs between the log and highway-env."""

    decisions: int = 0
    frames: int = 0
    obstacles: int = 0  # logged, over all frames
    numbers: int = 0  # different things that were logged
    worst: float = 0.0  # deviation of positions, headings, speeds, observations and rewards
    different: list[str] = field(default_factory=list)


class Player:
    """Plays given numbers in the place of a generator: a row for each decision."""

    def __init__(self, rows):
        self.rows = iter(rows)

    def next_decision(self):
        self.share, *self.choices, station, speed, self.delta = next(self.rows)
        self.normals = iter([station, speed])

    def uniform(self, low=None, high=None):
        return self.share if low is None else low + (high - low) * self.delta

    def choice(self, values, size, replace):
        return np.array([values[int(choice)] for choice in self.choices])

    def normal(self):
        return next(self.normals)


def standard_forms(draws):
    """Return rows of draws as the compiled engine takes them: choices as places in [0, 1)."""
    rows = []
    for share, first, second, *others in draws:
        place = second - (second > first)  # among the three that are left
        rows.append([share, (first + 0.5) / 4, (place + 0.5) / 3, *others])
    return np.ravel(rows)


def compare(env_id, config=None, *, decisions, seed=0, is_given=False, draws=()):
    """Drive highway-env and the second of two compiled episodes from the same start with the same random actions.

    The start is drawn with the same seed, or it is given. The first numbers after it may be given as well.
    """
    env = make(env_id, config)
    compiled = HighwayVectorEnv(type(env), 2, config, autoreset_mode="Disabled", log_frames=True)
    expected, _ = env.reset(seed=seed)
    options = {"starts": {1: env}} | ({"draws": {1: standard_forms(draws)}} if draws else {})
    shown, _ = compiled.reset(seed=[seed + 1, None if is_given else seed], options=options if is_given else None)
    env.action_space.seed(seed)
    return drive(env, compiled, decisions, Comparison(worst=deviation(expected, shown[1])), draws)


def drive(env, compiled, decisions, result, draws):
    seen, numbers, player, generator = recorded(env), {}, Player(draws), env.np_random
    for k in range(decisions):
        seen.clear()
        if draws:
            env.np_random = env.road.np_random = player if k < len(draws) else generator
        if k < len(draws):
            player.next_decision()
        action = env.action_space.sample()
        expected, reward, terminated, truncated, _ = env.step(action)
        shown, rewards, *_ = compiled.step(np.array([action, action]))
        result.worst = max(result.worst, deviation(expected, shown[1]), abs(reward - float(rewards[1])))
        note_differences(compiled.frame_log, seen, numbers, result)
        result.decisions += 1
        if terminated or truncated or result.different:
            break
    result.numbers = len(numbers)
    if len(set(numbers.values())) < len(numbers):
        result.different.append("numbers")
    return result


def recorded(env):
    """Return a list to which every step of the road will append its things and their lanes."""
    seen, step = [], env.road.step

    def recording_step(dt):
        step(dt)
        things = [*env.road.vehicles, *env.road.objects]
        lanes = {index: lane for lane, index in enumerate(lane_indexes(env.road.network))}
        values = [
            (thing, *thing.position, thing.heading, thing.speed, *lanes_of(thing, lanes), thing.crashed)
            for thing in things
        ]
        seen.append((values, things.index(env.vehicle), bool(env.vehicle.on_road)))

    env.road.step = recording_step
    return seen


def lanes_of(thing, lanes):
    """The numbers of the closest lane of a vehicle and of the one at which it aims; -1 where there is none."""
    if type(thing).__name__ == "Obstacle":
        return -1, -1
    return lanes[thing.lane_index], lanes.get(getattr(thing, "target_lane_index", None), -1)


def note_differences(log, seen, numbers, result):
    """Note what differs, and the number of every thing."""
    if len(seen) != log.frames.shape[1]:
        result.different.append("number of frames")
    for (values, *others), frame, row in zip(seen, log.frames[1], log.things[1], strict=True):
        if frame.tolist() != (len(values), *others):
            result.different.append("frame")
            return
        for (thing, *numbered, crashed), logged in zip(values, row, strict=False):
            deviations = [abs(value - logged[name]) for value, name in zip(numbered, VALUES, strict=True)]
            result.worst = max(result.worst, *map(float, deviations))
            result.different += ["crashed"] if logged.crashed != crashed else []
            result.different += ["number"] if numbers.setdefault(thing, int(logged.number)) != logged.number else []
            result.obstacles += type(thing).__name__ == "Obstacle"
        result.frames += 1


def compare_in_child(*calls):
    """Compare in a process in which numpy computes as the C library does; arguments of `compare` by name."""
    return [Comparison(**result) for result in results_of_child("tests.envs.highway.frame_by_frame", calls)]


if __name__ == "__main__":
    logging.disable(logging.WARNING)  # highway-env's, about routes
    sys.stdout.write(json.dumps([asdict(compare(**call)) for call in json.loads(sys.argv[1])]))
