"""Whatever a driving system does in a worker, it is recorded, and no other execution is lost for it."""

from pathlib import Path

import pytest

from behavexplor.campaign.campaign import Campaign, search_method
from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.store import Store
from behavexplor.data.target import Target
from behavexplor.execution.simulation import Simulation
from behavexplor.execution.start import start_executor
from tests.confining import confines
from tests.faults import DROVE, FAULTS, table

DOCS = Path(__file__).parent.parent / "docs" / "robustness.md"
LOGICAL = Simulation("lane-follow", "constant").logical
BUDGET = 2


def records(folder, ads):
    """The records of a short campaign in a worker, which has little time and memory."""
    config = CampaignConfig(env="lane-follow", ads=ads, method="uniform", budget=str(BUDGET), seed=1)
    store = Store.create(folder, config.to_yaml())
    executor = start_executor(Target(config.env, ads, time_limit=4.0, memory_limit=2.0), 1)
    try:
        Campaign(config, search_method(config, LOGICAL), LOGICAL, store, executor).run(lambda _: None)
        return [record.to_dict() for record in store.records()]
    finally:
        executor.shutdown(wait=False)
        store.close()


@pytest.fixture(scope="module")
def healthy(tmp_path_factory):
    return records(tmp_path_factory.mktemp("healthy") / "run", "tests.drivers:Cruiser")


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.ads)
def test_a_fault_is_recorded_and_costs_no_other_execution(fault, healthy, tmp_path):
    if fault.message == "PermissionError" and not confines():
        pytest.skip("this system cannot confine a process")
    found = records(tmp_path / "run", f"tests.faults:{fault.ads}")
    assert [record["id"] for record in found] == list(range(BUDGET))
    assert [record["scenario"] for record in found] == [record["scenario"] for record in healthy]
    if fault.outcome == DROVE:
        assert found == healthy
        return
    for record in found:
        assert record["violated"] == ["error"]
        assert record["error"]["kind"] == fault.outcome
        assert fault.message in record["error"]["message"]


def test_the_table_in_the_documentation_is_that_of_the_faults():
    """If this fails, put what tests.faults.table() gives into docs/robustness.md."""
    assert table() in DOCS.read_text()
