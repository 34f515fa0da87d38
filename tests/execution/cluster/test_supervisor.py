"""The executor on a cluster that is none: its nodes answer, are lost and come back as each test says."""

import json
from concurrent.futures import Future

import pytest

from behavexplor.campaign.campaign import Campaign, ExecutionError, search_method
from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.store import Store
from behavexplor.errors import InputError
from behavexplor.execution.cluster.supervisor import LOSSES, ClusterError, ClusterExecutor
from behavexplor.execution.executor import ADSError
from behavexplor.execution.fingerprint import FINGERPRINT, fingerprint
from behavexplor.execution.messages import ADS_FAILED, FAILED, RESULT
from behavexplor.execution.simulation import logical_scenario

PATIENCE = 20.0  # for what comes at once [s]


class Node:
    """Has begun with `greeting`, holds the calls that it was given, and answers when it is told to."""

    def __init__(self, greeting):
        self.greeting, self.calls = greeting, []

    def answer(self, answer=None):
        """Answer all calls, each with its data if with nothing else."""
        calls, self.calls = self.calls, []
        for future, data in calls:
            future.set_result(answer or RESULT + data)

    def lose(self):
        calls, self.calls = self.calls, []
        for future, _ in calls:
            future.set_exception(OSError("the node has gone"))


class Nodes:
    """A cluster; `greetings` are those of its nodes, in their order, the last of them that of all others."""

    cores = 2

    def __init__(self, *greetings):
        self.greetings = list(greetings) or [RESULT + fingerprint(b'["constant"]')]
        self.nodes, self.ended, self.left = [], [], False
        self.refuses = False

    def start(self, *arguments):
        assert arguments == ("settings", "folder")
        self.nodes.append(Node(self.greetings[min(len(self.nodes), len(self.greetings) - 1)]))
        return self.nodes[-1]

    def ask(self, node, function, data):
        if self.refuses and function != FINGERPRINT:
            raise LookupError("no such node")
        future = Future()
        if function != FINGERPRINT:
            node.calls.append((future, data))
        elif isinstance(node.greeting, Future):
            return node.greeting
        elif isinstance(node.greeting, Exception):
            future.set_exception(node.greeting)
        else:
            future.set_result(node.greeting)
        return future

    def end(self, node):
        self.ended.append(node)

    def close(self):
        self.left = True


@pytest.fixture
def make():
    executors = []

    def made(cluster, count=2, patience=PATIENCE):
        executors.append(ClusterExecutor(cluster, count, ("constant",), ("settings", "folder"), patience))
        return executors[-1]

    yield made
    for executor in executors:
        executor.shutdown(wait=False)


def settle(executor):
    """Wait until the executor has taken in everything that has happened so far."""
    done = Future()
    executor._events.put(lambda: done.set_result(None))
    done.result(PATIENCE)


def test_answers_are_results_failures_of_the_ads_and_other_failures(make):
    cluster = Nodes()
    executor = make(cluster, count=1)
    failure = json.dumps({"kind": "hang", "message": "no answer"}).encode()
    for answer in (RESULT + b"trace", ADS_FAILED + failure, FAILED + b"LookupError: no road"):
        future = executor.submit("execute", b"scenario")
        settle(executor)
        cluster.nodes[0].answer(answer)
        if answer.startswith(RESULT):
            assert future.result(PATIENCE) == b"trace"
            continue
        error = future.exception(PATIENCE)
        if answer.startswith(ADS_FAILED):
            assert (type(error), error.kind, error.message) == (ADSError, "hang", "no answer")
        else:
            assert (type(error), str(error)) == (RuntimeError, "LookupError: no road")
    assert cluster.ended == []


def test_calls_go_to_the_node_that_has_the_least_to_do(make):
    late = Future()
    cluster = Nodes(RESULT + fingerprint(b'["constant"]'), late)
    executor = make(cluster)
    futures = [executor.submit("execute", b"%d" % i) for i in range(3)]
    settle(executor)
    assert [len(node.calls) for node in cluster.nodes] == [3, 0]
    late.set_result(RESULT + fingerprint(b'["constant"]'))
    futures += [executor.submit("execute", b"%d" % i) for i in range(3, 9)]
    settle(executor)
    assert sorted(len(node.calls) for node in cluster.nodes) == [4, 5]
    for node in cluster.nodes:
        node.answer()
    assert [future.result(PATIENCE) for future in futures] == [b"%d" % i for i in range(9)]


def test_what_a_lost_node_had_is_done_by_another_and_first(make):
    cluster = Nodes()
    executor = make(cluster, count=1)
    futures = [executor.submit("execute", b"%d" % i) for i in range(4)]
    settle(executor)
    first = cluster.nodes[0]
    stale, first.calls = first.calls[1:], first.calls[:1]
    first.lose()
    settle(executor)
    settle(executor)
    second = cluster.nodes[1]
    assert cluster.ended == [first]
    assert [data for _, data in second.calls] == [b"0", b"1", b"2", b"3"]
    for future, _ in stale:  # it was not as lost as it seemed
        future.set_result(RESULT + b"too late")
    second.answer()
    assert [future.result(PATIENCE) for future in futures] == [b"0", b"1", b"2", b"3"]


def test_a_call_that_is_lost_with_every_node_fails_and_the_others_go_on(make):
    cluster = Nodes()
    executor = make(cluster, count=1)
    lost = executor.submit("execute", b"dangerous")
    for count in range(LOSSES):
        settle(executor)
        settle(executor)
        assert len(cluster.nodes) == count + 1
        cluster.nodes[count].lose()
    with pytest.raises(ClusterError, match=f"{LOSSES} nodes were lost .* OSError: the node has gone"):
        lost.result(PATIENCE)
    after = executor.submit("execute", b"harmless")
    settle(executor)
    settle(executor)
    cluster.nodes[-1].answer()
    assert after.result(PATIENCE) == b"harmless"


def test_a_node_that_cannot_even_be_asked_is_lost(make):
    cluster = Nodes()
    executor = make(cluster, count=1)
    cluster.refuses = True
    with pytest.raises(ClusterError, match="LookupError: no such node"):
        executor.submit("execute", b"").result(PATIENCE)


def test_nodes_that_never_begin_end_the_campaign_at_once(make):
    cluster = Nodes(ImportError("Traceback\n  ...\nModuleNotFoundError: No module named 'behavexplor'"))
    with pytest.raises(
        ClusterError, match="can begin: ImportError: ModuleNotFoundError: No module named 'behavexplor'"
    ):
        make(cluster)
    assert cluster.left
    assert set(cluster.ended) == set(cluster.nodes)


def test_one_false_start_is_made_good(make):
    cluster = Nodes(OSError("gone"), RESULT + fingerprint(b'["constant"]'))
    executor = make(cluster, count=1)
    future = executor.submit("examine", b"")
    settle(executor)
    cluster.nodes[1].answer(RESULT + b"[]")
    assert future.result(PATIENCE) == b"[]"


def test_no_room_on_the_cluster_is_said_after_a_while(make):
    with pytest.raises(ClusterError, match=r"no node of the cluster has been ready for 0\.2 s"):
        make(Nodes(Future()), patience=0.2)


def test_a_node_that_cannot_load_the_ads_says_so(make):
    with pytest.raises(InputError, match="no such file"):
        make(Nodes(FAILED + b"model.zip: no such file (on the node far)"))


@pytest.mark.parametrize("name", ["behavexplor", "numpy", "kind of processor"])
def test_a_node_that_would_give_other_results_is_refused(make, name):
    theirs = {**json.loads(fingerprint(b'["constant"]')), "node": "far", name: "other"}
    with pytest.raises(InputError, match=rf"The node far has a different {name} \(other\) than this machine"):
        make(Nodes(RESULT + json.dumps(theirs).encode()))


def test_a_refusal_later_on_fails_what_comes_after_it(make):
    late = Future()
    executor = make(Nodes(RESULT + fingerprint(b'["constant"]'), late))
    running = executor.submit("execute", b"")
    late.set_result(FAILED + b"no such file")
    for future in (running, executor.submit("execute", b"")):
        with pytest.raises(InputError, match="no such file"):
            future.result(PATIENCE)


def test_leaving_waits_for_what_was_submitted_or_does_not(make):
    cluster = Nodes()
    executor = make(cluster, count=1)
    future = executor.submit("execute", b"")
    future.add_done_callback(lambda _: None)
    settle(executor)
    cluster.nodes[0].answer()
    executor.shutdown()
    assert future.result(PATIENCE) == b""
    assert (cluster.left, cluster.ended) == (True, cluster.nodes)
    with pytest.raises(RuntimeError, match="has been left"):
        executor.submit("execute", b"")

    executor = make(Nodes(), count=1)
    running = executor.submit("execute", b"")
    settle(executor)
    executor.shutdown(wait=False)
    with pytest.raises(ClusterError, match="has been left"):
        running.result(PATIENCE)


def test_lost_nodes_are_no_finding(make, tmp_path):
    config = CampaignConfig(env="lane-follow", ads="constant", method="uniform", budget="3")
    logical = logical_scenario(config.env)
    cluster = Nodes()
    executor = make(cluster)
    cluster.refuses = True
    store = Store.create(tmp_path / "run", config.to_yaml())
    campaign = Campaign(config, search_method(config, logical), logical, store, executor)
    with pytest.raises(ExecutionError, match="Execution 0 could not be carried out: ClusterError: 3 nodes were lost"):
        campaign.run(lambda _: None)
    assert len(store) == 0
    store.close()
