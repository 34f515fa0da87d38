"""Fault in traffic that reacts."""

import json
from dataclasses import replace

import numpy as np
import pytest

from behavexplor.campaign.record import Record
from behavexplor.data.conventions import MANEUVERS
from behavexplor.data.trace import OBSTACLE, PARTNER
from behavexplor.envs.making import make_env
from behavexplor.execution.simulation import Simulation
from behavexplor.judge.fault import contact_fault, is_at_fault
from behavexplor.judge.specs import judge
from behavexplor.triage import blame as blame_module
from behavexplor.triage import closed_loop, examination
from behavexplor.triage.blame import blame
from behavexplor.triage.closed_loop import (
    CONSTANT,
    RANDOM,
    OtherDrivers,
    ScriptedDriver,
    drive_again,
    find_driver,
    last_chance,
)
from behavexplor.triage.findings import LastChance, witness_from, witness_values
from tests.envs.highway import strange


@pytest.fixture(scope="module")
def merging():
    return Simulation("merge-v0", "constant:FASTER")


def test_a_driver_that_does_not_crash_is_named(merging):
    scenario = merging.logical.sample(np.random.default_rng(1))
    trace = merging.run(scenario)
    assert trace.end == "collision"
    driver, tried, found = find_driver(scenario, None, None, np.random.default_rng(0))
    assert found == "preventable"
    assert driver.name == "careful"
    assert tried == 1 + len(CONSTANT) + RANDOM
    careful = Simulation("merge-v0", "careful")
    assert careful.run(replace(scenario, setup=careful.logical.setup)).end != "collision"
    verdict = blame(merging, scenario, trace, np.random.default_rng(0))
    assert (verdict.kind, verdict.witness) == ("preventable", driver)
    assert verdict.at_fault
    again = drive_again(scenario, witness_from(json.loads(json.dumps(witness_values(driver)))))
    assert not again.signals["crashed"].any()
    assert again.actions[:, 0].tolist() == list(driver.actions)


def test_where_all_others_crash_the_last_chance_of_the_ego_itself_is_driven(merging, monkeypatch):
    scenario = merging.logical.sample(np.random.default_rng(1))
    crash = merging.run_compiled(scenario)
    monkeypatch.setattr(closed_loop, "_driven", lambda *_: [crash] * (1 + len(CONSTANT) + RANDOM))
    chance = last_chance(merging, scenario, crash)
    verdict = blame(merging, scenario, crash, np.random.default_rng(0), chance)
    assert verdict.kind == "preventable"
    assert verdict.witness.name == f"the last chance ({chance.saving[0]}, then always SLOWER)"
    assert verdict.tried == 1 + len(CONSTANT) + RANDOM + len(CONSTANT) * len(chance.saving)
    again = drive_again(scenario, verdict.witness)
    assert not judge(again).failed
    frame = crash.action_frame[-chance.back]
    assert np.array_equal(again.position[: frame + 1, 0], crash.position[: frame + 1, 0])
    assert again.actions[len(crash.actions) - chance.back, 0] == MANEUVERS.index(chance.saving[0])
    elsewhere = replace(crash, position=crash.position + [0.0, 0.5])  # as if the ego drove on another road
    assert find_driver(scenario, elsewhere, chance, np.random.default_rng(0)).answer == "unpreventable"


def driven_by_others(monkeypatch, traces):
    """The witness of a scenario of the roundabout in which other drivers do what their traces say."""
    simulation = Simulation("roundabout-v0", "constant:SLOWER")
    scenario = simulation.logical.sample(np.random.default_rng(0))
    careful = Simulation("roundabout-v0", "careful")
    waits, goes = simulation.run(scenario), careful.run(replace(scenario, setup=careful.logical.setup))
    assert not waits.signals["arrived"].any()
    assert not judge(goes).failed
    monkeypatch.setattr(
        closed_loop, "_driven", lambda *_: [*traces(waits, goes), *[waits] * (len(CONSTANT) + RANDOM - 1)]
    )
    driver, _, found = find_driver(scenario, None, None, np.random.default_rng(0))
    return found if driver is None else driver.name


def test_a_crash_that_all_others_share_excuses_the_ego_only_without_a_last_chance_and_with_a_vehicle(
    merging, monkeypatch
):
    scenario = merging.logical.sample(np.random.default_rng(1))
    trace, chance = merging.run(scenario), LastChance(1, "FASTER", ("SLOWER",))
    monkeypatch.setattr(blame_module, "find_driver", lambda *_: OtherDrivers(None, 17, "unpreventable"))
    wall = replace(trace, signals={**trace.signals, PARTNER: np.full(len(trace.time), OBSTACLE)})

    def verdict(trace, chance=None):
        return blame(merging, scenario, trace, np.random.default_rng(0), chance)

    assert (verdict(trace).kind, verdict(trace).at_fault) == ("unpreventable", False)
    for excused in (verdict(trace, chance), verdict(wall), verdict(wall, chance)):
        assert excused.kind == contact_fault(trace) == "other"
        assert is_at_fault(excused.kind)


def test_the_last_chance_of_a_failure_is_part_of_its_verdict(merging, monkeypatch):
    scenario = merging.logical.sample(np.random.default_rng(1))
    trace, given = merging.run_compiled(scenario), []
    monkeypatch.setattr(examination, "blame", lambda *args: given.append(args[-1]))
    record = Record(
        id=0,
        origin="uniform",
        parent=None,
        end="collision",
        violated=("collision",),
        degrees={},
        scenario=scenario.to_dict(),
    )
    finding, _ = examination.examined(merging, record, trace, seed=0)
    assert given == [finding.last_chance]
    assert finding.last_chance is not None


def test_a_witness_keeps_every_requirement(monkeypatch):
    assert driven_by_others(monkeypatch, lambda waits, goes: [waits, goes]) == "always SLOWER"
    assert driven_by_others(monkeypatch, lambda waits, _: [waits, waits]) == "standing_still_avoids_it"


def test_a_witness_that_only_stands_still_is_called_that(monkeypatch):
    def nowhere(trace):
        return replace(trace, signals={name: one for name, one in trace.signals.items() if name != "arrived"})

    only = driven_by_others(monkeypatch, lambda waits, _: [waits, nowhere(waits)])
    assert only == "standing still (always SLOWER)"
    both = driven_by_others(monkeypatch, lambda waits, goes: [nowhere(waits), nowhere(goes)])
    assert both == "always SLOWER"


@pytest.mark.parametrize("actions", [[], [5], [-1], ["left"], None])
def test_actions_that_cannot_be_driven_are_refused(actions):
    with pytest.raises((ValueError, TypeError)):
        witness_from({"name": "careful", "actions": actions})


def test_the_same_generator_gives_the_same_verdict(merging):
    scenario = merging.logical.sample(np.random.default_rng(2))
    assert len({find_driver(scenario, None, None, np.random.default_rng(5)) for _ in range(2)}) == 1


def test_an_environment_without_meta_actions_has_no_witness():
    simulation = Simulation("racetrack-v0", f"{__name__}:Straight", env_config={"duration": 2})
    scenario = simulation.logical.sample(np.random.default_rng(0))
    assert find_driver(scenario, None, None, np.random.default_rng(0)) == (None, 0, None)


def test_an_environment_that_shows_something_else_has_no_witness():
    env = make_env(strange.registered(strange.flattened), {})
    scenario = env.logical.sample(np.random.default_rng(0))
    assert find_driver(scenario, None, None, np.random.default_rng(0)) == (None, 0, None)


class Straight:
    """A driver that never steers."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.zeros((len(observation), 1)), state


def test_a_scripted_driver_holds_its_last_action():
    driver = ScriptedDriver(np.array([[1, 2], [3, 4]]))
    state, taken = None, []
    for _ in range(4):
        actions, state = driver.predict(np.zeros((2, 5)), state)
        taken.append(actions.tolist())
    assert taken == [[1, 3], [2, 4], [2, 4], [2, 4]]
