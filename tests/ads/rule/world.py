"""A few lines of world for the planner: highway-env's bicycle model among NPCs whose motion is a function."""

import math
from collections.abc import Callable

import numpy as np

from behavexplor.ads.rule import Parameters, RulePlanner
from behavexplor.ads.rule.memory import MEMORY
from behavexplor.data.conventions import EGO_SIZE
from behavexplor.data.roadmap import RoadMap

SEDAN = (4.57, 2.08)


def memory_with(**values):
    """The planner's memory; what is not given is 0."""
    memory = np.zeros(1, MEMORY)[0]
    for name, value in values.items():
        memory[name] = value
    return memory


def scene(ego, npcs=()):
    """The scene of an ego (x, y, heading, speed) and NPCs (x, y, heading, speed, acceleration)."""
    rows = [[1.0, *ego, 0.0, *EGO_SIZE], *([1.0, *npc, *SEDAN] for npc in npcs)]
    return np.array(rows)


def drive(
    roadmap: RoadMap,
    npcs: Callable[[float], list] = lambda _: [],
    seconds=60.0,
    speed=0.0,
    station=None,
    offset=None,
    parameters=Parameters(),  # noqa: B008
    states=False,
):
    """Drive until the destination or the end of the time; returns the ego's frames and the decisions.

    Returns:
        Frames (time, x, y, heading, speed, acceleration, steering), 10 per second, the decision codes, and with
        `states` the whole decision log.
    """
    planner = RulePlanner(roadmap, parameters)
    offset = roadmap.ego_offset if offset is None else offset
    x, y, heading = roadmap.ego_route.pose(roadmap.ego_start if station is None else station)
    x, y = x - offset * math.sin(heading), y + offset * math.cos(heading)
    frames, log, state = [], [], None
    for step in range(int(seconds * 10)):
        observation = scene((x, y, heading, speed), npcs(step / 10))
        actions, state = planner.predict(observation[None], state)
        acceleration, steering = -8 + (actions[0, 0] + 1) * 6, -0.6 + (actions[0, 1] + 1) * 0.6
        frames.append((step / 10, x, y, heading, speed, acceleration, steering))
        log.append({name: values[0] for name, values in planner.log(state).items()})
        for _ in range(2):
            slip = math.atan(0.5 * math.tan(steering))
            x += speed * math.cos(heading + slip) * 0.05
            y += speed * math.sin(heading + slip) * 0.05
            heading += speed * math.sin(slip) / (EGO_SIZE[0] / 2) * 0.05
            speed += acceleration * 0.05
        if math.hypot(x - roadmap.destination_point[0], y - roadmap.destination_point[1]) <= 1.0:
            break
    columns = {name: np.array([entry[name] for entry in log]) for name in log[0]}
    return (np.array(frames), columns["decision"], columns) if states else (np.array(frames), columns["decision"])
