"""Drawn actions in episodes: another driver than the most probable actions, and the same in every execution."""

import hashlib
import json
from types import SimpleNamespace

import numpy as np
import pytest

from behavexplor.ads.interface import StochasticADS
from behavexplor.commands import BAD_INPUT, OK, main
from behavexplor.errors import InputError
from behavexplor.execution.rollout import DrawnActions
from behavexplor.execution.simulation import Simulation

ENV, POLICY = "lane-follow", "learned:lane-follow"


@pytest.fixture(scope="module")
def simulation():
    return Simulation(ENV, POLICY, stochastic=True)


@pytest.fixture(scope="module")
def scenarios(simulation):
    generator = np.random.default_rng(5)
    return [simulation.logical.sample(generator) for _ in range(6)]


def test_an_episode_is_the_same_alone_in_lock_step_and_in_any_order(simulation, scenarios):
    alone = [simulation.run(scenario).to_bytes() for scenario in scenarios]
    for batch in (2, 6):
        together = dict(simulation.run_all(scenarios, batch))
        assert [together[i].to_bytes() for i in range(6)] == alone
    backwards = dict(simulation.run_all(scenarios[::-1], 3))
    assert [backwards[5 - i].to_bytes() for i in range(6)] == alone


def test_the_stream_of_an_episode_is_the_same_in_all_versions_of_a_revision(scenarios):
    """It begins with the word "draw" and half of the scenario's SHA-256; other streams have other words."""
    noises = []
    policy = SimpleNamespace(noise=3, draw=lambda *given: noises.append(given[-1]) or (None, None))
    drawn, expected = DrawnActions(policy, 2), []
    for row, scenario in enumerate(scenarios[:2]):
        drawn.begin(row, scenario)
        half = hashlib.sha256(scenario.to_json().encode()).digest()[:16]
        expected.append(np.random.default_rng([int.from_bytes(b"draw"), int.from_bytes(half)]).random((4, 3)))
    for _ in range(4):
        drawn.predict(None)
    np.testing.assert_array_equal(np.array(noises), np.stack(expected, axis=1))


def test_drawn_actions_are_not_the_most_probable_ones(simulation, scenarios):
    chosen = Simulation(ENV, POLICY)
    assert isinstance(chosen.ads, StochasticADS)
    assert all(chosen.run(one).to_bytes() != simulation.run(one).to_bytes() for one in scenarios[:2])


def test_a_driver_that_cannot_draw_is_named():
    with pytest.raises(InputError, match="'rule' cannot draw its actions"):
        Simulation(ENV, "rule", stochastic=True)


def test_a_campaign_with_drawn_actions_is_reproducible(tmp_path, capsys):
    def records(name, *more):
        arguments = ["fuzz", "--env", ENV, "--ads", POLICY, "--stochastic", "--budget", "12", "--quiet"]
        assert main([*arguments, "--out", str(tmp_path / name), *more]) == OK
        capsys.readouterr()
        assert main(["records", str(tmp_path / name)]) == OK
        return capsys.readouterr().out

    assert records("one", "--workers", "0") == records("two", "--workers", "1")
    assert main(["replay", str(tmp_path / "one"), "3"]) == OK
    assert "was reproduced" in capsys.readouterr().out


def test_evaluate_shows_drawn_actions_beside_the_most_probable_ones(tmp_path, capsys):
    arguments = ["evaluate", "--env", ENV, "--scenarios", "40", "--workers", "0", "--quiet"]
    assert main([*arguments, "--ads", POLICY, "--json", str(tmp_path / "rates.json")]) == OK
    out = capsys.readouterr().out
    assert "drawn actions" in out
    assert "With drawn actions, as in training" in out
    values = json.loads((tmp_path / "rates.json").read_text())
    assert main([*arguments, "--ads", POLICY, "--stochastic", "--json", str(tmp_path / "drawn.json")]) == OK
    assert "drawn actions" not in capsys.readouterr().out
    drawn = json.loads((tmp_path / "drawn.json").read_text())
    assert values["beside"]["drawn actions"].items() <= drawn.items()
    assert main([*arguments, "--ads", "rule", "--stochastic"]) == BAD_INPUT
