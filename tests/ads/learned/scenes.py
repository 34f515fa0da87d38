"""Scenes for the tests of learned drivers."""

import numpy as np

from behavexplor.ads.learned.route_table import make_course
from behavexplor.envs.logical_scenarios import LOGICAL_SCENARIOS

LOGICALS = LOGICAL_SCENARIOS
COURSES = {name: make_course(logical.roadmap) for name, logical in LOGICALS.items()}


def vehicle(pose, speed=0.0, acceleration=0.0, size=(4.7, 2.06)):
    """A row of a scene."""
    return [1.0, *pose, speed, acceleration, *size]


def ego(name, station, offset=0.0, speed=0.0):
    """The ego on its course."""
    x, y, heading = LOGICALS[name].roadmap.ego_route.pose(station)
    return vehicle((x - np.sin(heading) * offset, y + np.cos(heading) * offset, heading), speed)


def on_route(name, route, station, speed=0.0, acceleration=0.0, size=(4.57, 2.08)):
    """An NPC on its route."""
    return vehicle(LOGICALS[name].roadmap.routes[route].pose(station), speed, acceleration, size)
