"""The policies that come with the package drive, and the good ones drive better than the others."""

import numpy as np
import pytest
import yaml

from behavexplor import FUNCTIONAL_SCENARIOS
from behavexplor.ads.learned.shipped import FOLDER
from behavexplor.ads.loading import load_ads
from behavexplor.ads.sb3.description import trained_in
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.data.target import Target
from behavexplor.errors import InputError
from behavexplor.evaluation import estimate_rates, start_judge
from behavexplor.execution.simulation import Simulation, logical_scenario
from tests.ads.learned.scenes import LOGICALS

EVERYWHERE = pytest.mark.parametrize("name", sorted(FUNCTIONAL_SCENARIOS))
POLICIES = sorted(path.stem for path in FOLDER.glob("*.npz"))


def card(name):
    return yaml.safe_load((FOLDER / f"{name}.yaml").read_text())


def test_there_is_a_good_and_an_undertrained_one_for_each_scenario():
    assert sorted(f"{name}{grade}" for name in FUNCTIONAL_SCENARIOS for grade in ("", "-undertrained")) == POLICIES


@pytest.mark.parametrize("name", POLICIES)
def test_each_has_a_card_that_says_how_it_was_made_and_how_it_drives(name):
    told = card(name)
    training = told["training"]
    assert name.startswith(training["env"])
    flags = "--env {env} --algo {algo} --steps {steps} --seed {seed} --envs {envs}".format(**training)
    assert told["trained_by"] == f"behavexplor train {flags}"
    again = f"behavexplor retrain runs/{training['env']}-ppo-0/policy.npz --env {training['env']} "
    assert told.get("retrained_by", again).startswith(again)
    assert told["evaluation"]["scenarios"] == 1000
    assert {"arrived", "collision", "lines", "destination"} <= set(told["evaluation"]["rates"])
    assert (FOLDER / f"{name}.npz").stat().st_size < 300_000


@pytest.mark.parametrize("name", POLICIES)
def test_without_an_environment_each_drives_where_it_was_trained(name):
    env = card(name)["training"]["env"]
    assert trained_in(f"learned:{name}") == trained_in(str(FOLDER / f"{name}.npz")) == env


@pytest.mark.parametrize("text", ["[", "training: 3", "training: {env: 3}", "training: {env: 'os:path'}"])
def test_a_card_that_names_no_functional_scenario_names_nothing(text, tmp_path):
    (tmp_path / "policy.yaml").write_text(text)
    assert trained_in(str(tmp_path / "policy.npz")) is None


def rates(env, ads, n, seed):
    with start_judge(Target(env, ads), 0) as executor:
        return estimate_rates(executor, logical_scenario(env), n, seed)


@EVERYWHERE
def test_without_traffic_the_good_one_arrives(name):
    simulation = Simulation(name, f"learned:{name}")
    assert simulation.run(ScriptedScenario(name, ())).end == "arrived"
    simulation.close()


@EVERYWHERE
def test_the_good_one_is_told_from_the_undertrained_one(name):
    good, poor = (rates(name, f"learned:{name}{grade}", 60, 7) for grade in ("", "-undertrained"))
    assert good.rate("arrived") > 0.85
    assert good.rate("arrived") > poor.rate("arrived")
    assert good.interval("arrived")[0] > card(name)["evaluation"]["rates"]["arrived"] - 0.2


@pytest.mark.slow
@pytest.mark.parametrize("name", POLICIES)
def test_the_cards_figures_are_seen_again(name):
    told = card(name)
    found = rates(told["training"]["env"], f"learned:{name}", 1000, 0)
    for outcome, rate in told["evaluation"]["rates"].items():
        assert found.rate(outcome) == pytest.approx(rate, abs=0.005)  # another processor may turn a decision or two


def test_an_unknown_policy_is_refused_with_the_nearest_one():
    with pytest.raises(InputError, match="did you mean 'lane-change'"):
        load_ads("learned:lane-chang", LOGICALS["lane-change"].roadmap)
    with pytest.raises(InputError, match="known are intersection-left"):
        load_ads("learned", LOGICALS["lane-change"].roadmap)


def test_a_policy_drives_on_another_map_too():
    driver = load_ads("learned:lane-follow", LOGICALS["intersection-left"].roadmap)
    scene = np.array([[[1.0, *LOGICALS["intersection-left"].roadmap.start_pose, 0, 0, 4.7, 2.06]]])
    assert np.isfinite(driver.predict(scene)[0]).all()
