"""Campaigns on Ray: the same records, also when one of two nodes is killed. Ray takes its time to start."""

import secrets

import pytest

from behavexplor.execution.cluster.on_ray import RayCluster
from tests.execution.cluster.two_nodes import (
    BUDGET,
    KILLED_AT,
    SHORT,
    Killing,
    is_over,
    processes_of_nodes,
    records,
    starts_of,
)

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]  # Ray's own, of its Python and its libraries


@pytest.fixture(autouse=True, scope="module")
def token():
    """No cluster that others can use, and no file of Ray's at home; it reads this when it is imported."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_AUTH_MODE", "token")
        patch.setenv("RAY_AUTH_TOKEN", secrets.token_hex(32))
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        pytest.importorskip("ray")
        yield


@pytest.fixture
def machines():
    """A head that executes nothing, and two nodes of one core."""
    cluster = pytest.importorskip("ray.cluster_utils").Cluster(
        initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False}
    )
    nodes = [cluster.add_node(num_cpus=1) for _ in range(2)]
    cluster.wait_for_nodes()
    yield cluster, nodes
    cluster.shutdown()


@pytest.fixture
def starts(monkeypatch):
    """What is started on the cluster while the test runs."""
    return starts_of(RayCluster, monkeypatch)


def test_a_node_that_is_killed_costs_no_record(machines, starts, tmp_path):
    cluster, (mortal, _) = machines
    alone = records(tmp_path / "alone", 1)
    killing = Killing(lambda: cluster.remove_node(mortal, allow_graceful=False))
    found = records(tmp_path / "cluster", 2, f"ray:{cluster.address}", killing)
    assert KILLED_AT <= killing.killed_at < BUDGET
    assert found == alone
    assert len(starts) == 3  # two, and one for which there is no room any more
    assert is_over(processes_of_nodes)


def test_a_cluster_on_this_machine_gives_the_same_records(tmp_path):
    alone = records(tmp_path / "alone", 0, config=SHORT)
    assert records(tmp_path / "cluster", 0, "ray", config=SHORT) == alone
    assert is_over(processes_of_nodes)
