"""Scenes with a known verdict: drivers that see little, among NPCs placed by hand."""

import numpy as np

from behavexplor.data.scripted import NPC, ScriptedScenario, Waypoint
from behavexplor.data.scripted_logical import ScriptedLogicalScenario
from behavexplor.execution.simulation import Simulation
from tests.drivers import Cruiser
from tests.triage.crossing import NAME as CROSSING
from tests.triage.crossing import register


class Stopper(Cruiser):
    """Drives at 8 m/s into the middle of the junction, and stops there for good."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        state = np.zeros(len(observation)) if state is None else state
        arrived = np.maximum(state, observation[:, 0, 2] < 6.0)
        speed = observation[:, 0, 4]
        wanted = np.where(arrived == 1.0, -8.0, 4.0)
        wanted = np.maximum(np.where((arrived == 0.0) & (speed >= 8.0), 0.0, wanted), -speed / 0.1)
        return np.stack([(wanted + 8.0) / 6.0 - 1.0, 0 * speed], axis=1), arrived


def steady(logical: ScriptedLogicalScenario, kind: str, route: str, start: float, speed: float) -> NPC:
    """An NPC that drives at one speed to the end of its route."""
    ranges = logical.position_ranges(logical.roadmap.routes[route])
    places = np.maximum.accumulate(np.maximum(ranges[:, 0], start))
    places[-1] = ranges[-1, 1]
    speeds = [speed] * (len(places) - 1) + [0.0]
    return NPC(kind, route, tuple(Waypoint(float(p), float(v)) for p, v in zip(places, speeds, strict=True)))


def scene(env: str, ads: str, *npcs: tuple[str, str, float, float]):
    """A simulation, a scenario with steady NPCs (kind, route, start, speed), and what happens in it."""
    simulation = Simulation(env, ads)
    scenario = ScriptedScenario(env, tuple(steady(simulation.logical, *npc) for npc in npcs))
    return simulation, scenario, simulation.run(scenario)


def slow_leader():
    """The ego drives into a car that creeps ahead of it: its own fault."""
    return scene("lane-follow", "constant:1,0", ("sedan", "lane-3", 70.0, 0.5))


def rear_ended():
    """The ego sets out slowly, and is struck from behind by a faster car."""
    return scene("intersection-straight", "constant:0.5,0", ("sedan", "south-inner-straight", 4.0, 9.0))


def struck_standing():
    """The ego stands in the junction, and is struck from the side."""
    ads = "tests.triage.scenes:Stopper"
    return scene("intersection-straight", ads, ("sedan", "west-inner-straight", 20.0, 6.0))


def boxed_in():
    """The ego drives into a creeping car, but whatever it did, one of those behind would strike it."""
    return scene(
        "intersection-straight",
        "constant:2,0",
        ("sedan", "south-inner-straight", 36.0, 0.2),
        ("school-bus", "south-outer-straight", 37.0, 0.2),
        ("sedan", "south-inner-straight", 4.0, 4.0),
        ("sedan", "south-outer-straight", 4.5, 4.0),
    )


def cut_off(kind: str, start: float):
    """The ego sets out, and a vehicle that comes from the left as fast as it may crosses its way at once."""
    register()
    simulation = Simulation(CROSSING, "constant:2,0")
    scenario = ScriptedScenario("crossing", (steady(simulation.logical, kind, "across", start, 11.0),))
    return simulation, scenario, simulation.run(scenario)


def way_blocked(ads: str):
    """Cars creep along in all four lanes, so that nobody could arrive in time."""
    lanes = [("sedan", f"lane-{lane}", 40.0, 0.2) for lane in (1, 2, 3, 4)]
    return scene("lane-follow", ads, *lanes)
