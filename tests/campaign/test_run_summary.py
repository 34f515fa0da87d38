"""The figures of a run as they are read from its folder."""

from contextlib import closing

import pytest

from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.confirmation import Confirmation, keep
from behavexplor.campaign.run_summary import by_class, summarize, words_of_others_faults
from behavexplor.campaign.store import Store
from behavexplor.campaign.uniform_rate import UniformRate
from tests.campaign.test_store import execution

CLASSES = ["R1/b", None, "R2/a", "R1/b", None, "R2/a", "R3/c"]  # of executions, the last of which was told after 9 s


@pytest.fixture
def made(tmp_path):
    """Makes a run of seven executions with a budget, three of whose classes are failures."""

    def stored(budget="750", ended=""):
        config = CampaignConfig(env="lane-follow", ads="constant", method="random", seed=5, budget=budget)
        with closing(Store.create(tmp_path / budget, config.to_yaml())) as store:
            for number, kind in enumerate(CLASSES):
                store.add(execution(number, ["collision"] if kind else [], kind))
            store.commit()
            UniformRate(4, 1).note(store)
            if ended:
                store.note_end(ended)
        return tmp_path / budget

    return stored


def test_figures_of_a_run(made):
    folder = made()
    for number, state in ((0, "confirmed"), (3, "disagrees"), (5, "confirmed")):
        keep(folder, number, Confirmation(state, "they differ"))
    found = summarize(folder)
    assert (found.env, found.ads, found.method) == ("lane-follow", "constant", "random")
    assert (found.seed, found.budget) == (5, "750")
    assert (found.executions, found.failed, found.elapsed) == (7, 5, 9.0)
    assert (found.failure_rate, found.rate) == (5 / 7, 7 / 9)
    assert [(one.id, one.count, one.first) for one in found.classes] == [("R1/b", 2, 0), ("R2/a", 2, 2), ("R3/c", 1, 6)]
    assert found.violations == {"collision": 5}
    assert found.uniform == UniformRate(4, 1)
    assert (found.confirmed, len(found.not_confirmed)) == (2, 1)
    assert "the failure in execution 3" in found.not_confirmed[0]
    assert found.words.startswith("5 failed (71.4%) in 3 classes")


@pytest.mark.parametrize(
    ("budget", "ended", "complete"),
    [("7", "", True), ("8", "", False), ("9s", "", True), ("10s", "", False), ("8", "The search is exhausted", True)],
)
def test_a_run_is_complete_when_its_budget_is_used_up_or_its_search_has_ended(made, budget, ended, complete):
    assert summarize(made(budget, ended)).complete is complete


def test_a_run_that_has_just_begun_has_no_rates(tmp_path):
    Store.create(tmp_path / "run", CampaignConfig().to_yaml()).close()
    found = summarize(tmp_path / "run")
    assert (found.executions, found.failure_rate, found.at_fault_rate, found.rate) == (0, 0.0, 0.0, 0.0)
    assert found.uniform is None


def test_failures_by_class_come_with_the_most_frequent_first_then_the_oldest(made):
    with closing(Store.read(made())) as store:
        groups = by_class(store.records())
    numbers = {kind: [record.id for record in group] for kind, group in groups.items()}
    assert list(numbers.items()) == [("R1/b", [0, 3]), ("R2/a", [2, 5]), ("R3/c", [6])]


def test_faults_of_others_are_said_if_there_are_any():
    assert words_of_others_faults(0) == ""
    assert words_of_others_faults(1) == "; 1 of the failures by another vehicle's fault"
