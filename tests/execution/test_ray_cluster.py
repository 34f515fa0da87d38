"""The executor on a cluster that is none, whose nodes answer as each test says, and a node without Ray."""

import asyncio
import json
import os
import socket
import subprocess
import sys
from concurrent.futures import CancelledError, Future
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from behavexplor.campaign.campaign import Campaign, ExecutionError, search_method
from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.store import Store
from behavexplor.commands import BAD_INPUT, main
from behavexplor.data.target import Target
from behavexplor.errors import InputError
from behavexplor.execution import ray_cluster
from behavexplor.execution.evaluator import EXECUTE, evaluator_recipe
from behavexplor.execution.executor import ADSError
from behavexplor.execution.fingerprint import FINGERPRINT, machine_fingerprint
from behavexplor.execution.messages import ADS_FAILED, FAILED, REFUSED, RESULT
from behavexplor.execution.ray_cluster import LOSSES, ClusterError, Limits, Node, RayExecutor, parse_cluster
from behavexplor.execution.service import Recipe
from behavexplor.execution.simulation import Simulation, logical_scenario

PATIENCE = 20.0  # for what comes at once [s]
ENV = "lane-follow"


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("ray", ""),
        ("ray:auto", "auto"),
        ("ray:10.0.0.5:6379", "10.0.0.5:6379"),
        ("ray:[fe80::1]:6379", "[fe80::1]:6379"),
        ("ray://head.example:10001", "ray://head.example:10001"),
        ("ray:ray://head.example:10001", "ray://head.example:10001"),
    ],
)
def test_names_of_clusters(text, address):
    assert parse_cluster(text) == address


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("spark", "Unknown cluster .*'spark': known are ray"),
        ("rai", "did you mean 'ray'"),
        ("", "Unknown cluster"),
        ("ray:", "--cluster ray: has an invalid address: write ray:10.0.0.5:6379"),
        ("ray:somewhere", "has an invalid address"),
        ("ray:tcp://10.0.0.5:6379", "has an invalid address"),
        ("ray:10.0.0.5:87860", "has an invalid address"),
        ("ray:10.0.0.5:0", "has an invalid address"),
    ],
)
def test_wrong_names_are_refused(text, message):
    with pytest.raises(InputError, match=message):
        parse_cluster(text)


def fuzz(capsys, *flags):
    code = main(["fuzz", "--env", ENV, "--ads", "constant", "--budget", "3", *flags])
    return code, capsys.readouterr().err.splitlines()[-1]


def test_a_library_that_is_not_installed_is_named(capsys, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "ray", None)
    code, said = fuzz(capsys, "--cluster", "ray", "--out", str(tmp_path / "run"))
    assert code == BAD_INPUT
    assert "--cluster ray needs ray: install the extra 'ray'" in said
    assert not (tmp_path / "run").exists()


def test_a_cluster_that_does_not_answer_is_named(capsys, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "ray", SimpleNamespace())  # it is not even asked
    with socket.socket() as unused:  # bound, but not listening
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
        code, said = fuzz(capsys, "--cluster", f"ray:127.0.0.1:{port}", "--out", str(tmp_path / "run"))
    assert code == BAD_INPUT
    assert f"The Ray cluster 127.0.0.1:{port} cannot be joined: [Errno" in said
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--cluster", "slurm"], "Unknown cluster"),
        (["--cluster", "ray", "--workers", "0"], "--workers 0 must lie between 1 and 256 on a cluster"),
        (["--workers", "65"], "--workers 65 must lie between 0 and 64"),
    ],
)
def test_wrong_flags_are_refused_in_a_sentence(flags, message, capsys):
    code, said = fuzz(capsys, *flags)
    assert code == BAD_INPUT
    assert message in said


def test_nobody_who_has_no_cluster_imports_ray():
    code = "import sys, behavexplor.commands.fuzz; print('ray' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "False"


class Actor:
    """Begins at once with a greeting, or not with None. Holds its calls until it is told to answer."""

    def __init__(self, greeting):
        self.begun, self.calls, self.told = [], [], []
        self.ask = SimpleNamespace(options=self._ask)
        self._greeting = greeting

    def begins(self, greeting=RESULT):
        """Let Ray have started or restarted it."""
        if isinstance(greeting, Exception):
            self.begun[-1].set_exception(greeting)
        elif greeting is not None:
            self.begun[-1].set_result(greeting)

    def answer(self, answer=None):
        """Answer all calls, each with its data if with nothing else."""
        calls, self.calls = self.calls, []
        for future, data in calls:
            future.set_result(answer or RESULT + data)

    def lose(self):
        calls, self.calls = self.calls, []
        for future, _ in calls:
            future.set_exception(OSError("Traceback:\n  the node has gone\n"))

    def _ask(self, *, max_task_retries):
        assert max_task_retries == 0  # Ray would wait for the lost actor
        return SimpleNamespace(remote=lambda function, data: self.take(data))

    def take(self, data):
        self.calls.append((Future(), data))
        return SimpleNamespace(future=lambda: self.calls[-1][0])

    def __getattr__(self, name):
        return SimpleNamespace(remote=self._begin if name == "begin" else lambda: self.told.append(name))

    def _begin(self):
        self.begun.append(Future())
        if len(self.begun) == 1:
            self.begins(self._greeting)
        return SimpleNamespace(future=lambda: self.begun[-1])


class Ray:
    """A cluster without machines: what the executor uses of Ray."""

    def __init__(self, *greetings):
        self.starting, self.actors, self.has_waited, self.left = [*map(Actor, greetings)], [], False, False

    def init(self, **options):
        assert (options["address"], options["log_to_driver"], options["include_dashboard"]) == ("local", False, False)
        assert os.environ["RAY_USAGE_STATS_ENABLED"] == "0"

    def cluster_resources(self):
        return {"CPU": float(len(self.starting))}

    def remote(self, **options):
        assert (options["num_cpus"], options["max_restarts"]) == (1, -1)
        return lambda _: SimpleNamespace(remote=self._start)

    def wait(self, ends, **_):
        self.has_waited = bool(ends)

    def shutdown(self):
        self.left = True

    def _start(self, *_):
        self.actors.append(self.starting[len(self.actors)])
        return self.actors[-1]


@pytest.fixture
def make(monkeypatch):
    executors = []

    def made(*greetings, long_calls=False):
        """An executor, and the actors of its cluster."""
        made.cluster = Ray(*greetings)
        monkeypatch.delenv("RAY_USAGE_STATS_ENABLED", raising=False)
        monkeypatch.setitem(sys.modules, "ray", made.cluster)
        recipe = Recipe("tests.faults:NoService", long_calls=long_calls)
        executors.append(RayExecutor("ray", 0, recipe, Limits(1.0, 1.0), ("constant",)))
        return executors[-1], made.cluster.actors

    yield made
    for executor in executors:
        executor.shutdown(wait=False)


def catch_up(executor):
    """Wait until the executor has taken in everything that has happened so far, and what followed from it."""
    for _ in range(3):
        executor._thread.submit(lambda: None).result(PATIENCE)


def submitted(executor, count):
    calls = [executor.submit("execute", b"%d" % i) for i in range(count)]
    catch_up(executor)
    return calls


def test_answers_are_results_failures_of_the_ads_and_other_failures(make):
    executor, (actor,) = make(RESULT)
    failure = json.dumps({"kind": "hang", "message": "no answer"}).encode()
    calls = []
    for answer in (RESULT + b"trace", ADS_FAILED + failure, FAILED + b"LookupError: no road"):
        calls += submitted(executor, 1)
        actor.answer(answer)
    assert calls[0].result(PATIENCE) == b"trace"
    error = calls[1].exception(PATIENCE)
    assert (type(error), error.kind, error.message) == (ADSError, "hang", "no answer")
    assert repr(calls[2].exception(PATIENCE)) == "RuntimeError('LookupError: no road')"


def test_calls_go_to_the_node_that_has_the_least_to_do(make):
    executor, (first, late) = make(RESULT, None)
    calls = submitted(executor, 3)
    assert [len(first.calls), len(late.calls)] == [3, 0]
    late.begins()
    calls += submitted(executor, 6)
    assert sorted([len(first.calls), len(late.calls)]) == [4, 5]
    first.answer(RESULT)
    late.answer(RESULT)
    assert [call.result(PATIENCE) for call in calls] == [b""] * 9


def test_a_node_has_one_long_call_at_a_time(make):
    executor, (first, late) = make(RESULT, None, long_calls=True)
    calls = submitted(executor, 3)
    assert [len(first.calls), len(late.calls)] == [1, 0]
    late.begins()
    catch_up(executor)
    assert [len(first.calls), len(late.calls)] == [1, 1]
    late.answer()
    catch_up(executor)
    assert [data for _, data in first.calls + late.calls] == [b"0", b"2"]
    executor.stop()
    late.answer()
    first.answer()
    assert [call.result(PATIENCE) for call in calls] == [b"0", b"1", b"2"]


def test_the_calls_of_a_lost_node_are_made_on_one_that_is_ready(make):
    executor, (lost, other) = make(RESULT, RESULT)
    calls = submitted(executor, 4)
    assert [len(lost.calls), len(other.calls)] == [2, 2]
    lost.lose()
    catch_up(executor)
    assert [len(lost.calls), len(other.calls)] == [0, 4]
    other.answer()
    assert [call.result(PATIENCE) for call in calls] == [b"0", b"1", b"2", b"3"]
    lost.begins()  # Ray has restarted it
    again = submitted(executor, 2)
    assert [len(lost.calls), len(other.calls)] == [1, 1]
    lost.answer()
    other.answer()
    assert [call.result(PATIENCE) for call in again] == [b"0", b"1"]


def test_calls_wait_for_the_only_node_to_be_restarted(make):
    executor, (actor,) = make(RESULT)
    calls = submitted(executor, 2)
    actor.lose()
    calls += submitted(executor, 1)
    assert not actor.calls
    actor.begins()
    catch_up(executor)
    assert [data for _, data in actor.calls] == [b"0", b"1", b"0"]
    actor.answer()
    assert [call.result(PATIENCE) for call in calls] == [b"0", b"1", b"0"]


def test_a_call_that_is_lost_with_every_node_fails_and_the_others_go_on(make):
    executor, (actor,) = make(RESULT)
    (lost,) = submitted(executor, 1)
    for _ in range(LOSSES):
        assert not lost.done()
        actor.lose()
        catch_up(executor)
        actor.begins()
        catch_up(executor)
    with pytest.raises(
        ClusterError, match=f"^a node was lost in attempt {LOSSES} of the call: OSError: the node has gone$"
    ):
        lost.result(PATIENCE)
    (after,) = submitted(executor, 1)
    actor.answer()
    assert after.result(PATIENCE) == b"0"


def test_a_node_that_never_begins_ends_the_campaign_at_once(make):
    error = ImportError("Traceback\n  ...\nModuleNotFoundError: No module named 'behavexplor'")
    with pytest.raises(ClusterError, match="cannot begin: ImportError: ModuleNotFoundError: No module named"):
        make(error)
    assert make.cluster.left


def test_no_room_on_the_cluster_is_said_after_a_while(make, monkeypatch):
    monkeypatch.setattr(ray_cluster, "BEGIN_SECONDS", 0.2)
    with pytest.raises(ClusterError, match=r"no node of the cluster has been ready for 0\.2 s"):
        make(None)


def test_a_cluster_without_nodes_is_given_up_after_a_while(make, monkeypatch):
    executor, (actor,) = make(RESULT)
    monkeypatch.setattr(ray_cluster, "BEGIN_SECONDS", 0.2)
    (call,) = submitted(executor, 1)
    actor.lose()
    with pytest.raises(ClusterError, match=r"no node of the cluster has been ready for 0\.2 s"):
        call.result(PATIENCE)


def test_a_refusal_ends_the_campaign(make):
    with pytest.raises(InputError, match="no such file"):
        make(REFUSED + b"model.zip: no such file")


def test_a_refusal_later_on_fails_what_comes_after_it(make):
    executor, (_, late) = make(RESULT, None)
    (running,) = submitted(executor, 1)
    late.begins(REFUSED + b"no such file")
    for call in (running, executor.submit("execute", b"")):
        with pytest.raises(InputError, match="no such file"):
            call.result(PATIENCE)


def test_leaving_waits_for_what_was_submitted(make):
    executor, (actor,) = make(RESULT)
    (call,) = submitted(executor, 1)
    executor._thread.submit(actor.answer)
    executor.shutdown()
    assert call.result(0) == b"0"
    assert make.cluster.left
    assert make.cluster.has_waited
    assert actor.told[-1] == "end"
    with pytest.raises(RuntimeError, match="has been left"):
        executor.submit("execute", b"")


def test_leaving_at_once_fails_what_was_submitted(make):
    executor, _ = make(RESULT)
    (running,) = submitted(executor, 1)
    executor.shutdown(wait=False)
    with pytest.raises(ClusterError, match="has been left"):
        running.result(0)


def test_stopping_cancels_what_waits_and_tells_the_nodes(make):
    executor, (actor,) = make(RESULT)
    (running,) = submitted(executor, 1)
    executor.stop()
    catch_up(executor)
    assert actor.told == ["stop"]
    actor.answer(RESULT + b"half")
    assert running.result(PATIENCE) == b"half"
    (running,) = submitted(executor, 1)
    actor.lose()  # it is not made again
    with pytest.raises(ClusterError, match="a node was lost in attempt 1 of the call"):
        running.result(PATIENCE)
    (waiting,) = submitted(executor, 1)
    executor.stop()
    with pytest.raises(CancelledError):
        waiting.result(PATIENCE)


def test_lost_nodes_are_no_finding(make, tmp_path):
    config = CampaignConfig(env=ENV, ads="constant", method="uniform", budget="3")
    logical = logical_scenario(config.env)
    executor, (actor,) = make(RESULT)
    actor.take = lambda *_: 1 / 0
    store = Store.create(tmp_path / "run", config.to_yaml())
    campaign = Campaign(config, search_method(config, logical), logical, store, executor)
    with pytest.raises(ExecutionError, match="Execution 0 could not be carried out: ClusterError: the cluster cannot"):
        campaign.run(lambda _: None)
    assert len(store) == 0
    store.close()


@pytest.fixture
def start(monkeypatch):
    """Starts nodes in this process, which is not changed for good."""
    monkeypatch.setattr(sys.modules["__main__"], "__file__", None, raising=False)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.chdir(Path.cwd())
    nodes = []

    def started(ads, *, checked=(), ours=None, folder="/nowhere"):
        names = json.dumps(checked).encode()
        recipe = evaluator_recipe(Target(ENV, ads))
        nodes.append(Node(recipe, Limits(60.0, 8.0), names, ours or machine_fingerprint(checked), str(folder)))
        return nodes[-1]

    yield started
    for node in nodes:
        asyncio.run(node.end())


def asked(node, *calls):
    async def all_answers():
        return await asyncio.gather(*(node.ask(*call) for call in calls))

    return asyncio.run(all_answers())


def scenarios(count):
    logical = logical_scenario(ENV)
    return [logical.sample(np.random.default_rng(seed)) for seed in range(count)]


def test_the_answers_of_a_node_are_those_of_a_worker(start):
    chosen = scenarios(5)
    simulation = Simulation(ENV, "tests.drivers:Cruiser")
    expected = [RESULT + simulation.run(scenario).to_bytes() for scenario in chosen]
    node = start("tests.drivers:Cruiser", checked=("tests.drivers:Cruiser",))
    assert asyncio.run(node.begin()) == RESULT
    assert asked(node, *((EXECUTE, scenario.to_json().encode()) for scenario in chosen)) == expected


def test_failures_have_their_tags_and_say_where(start):
    node = start("tests.faults:Segfaulting")
    calls = [(EXECUTE, scenario.to_json().encode()) for scenario in scenarios(1)]
    failed, refused, unknown = asked(node, *calls, (EXECUTE, b"{}"), ("nonsense", b""))
    assert failed[:1] == ADS_FAILED
    assert json.loads(failed[1:])["kind"] == "crash"
    assert refused[:1] == REFUSED
    assert "functional: missing" in refused.decode()
    assert unknown[:1] == FAILED
    assert f"(on the node {os.uname().nodename})" in unknown.decode()


def test_a_node_that_would_give_other_results_refuses_every_call(start):
    ours = {**json.loads(machine_fingerprint(())), "node": "far", "numpy": "other"}
    node = start("constant", ours=json.dumps(ours).encode())
    problem = asyncio.run(node.begin())
    assert problem.startswith(REFUSED + b"The node ")
    assert b"has a different numpy (" + np.__version__.encode() + b") than this machine (other)" in problem
    assert asked(node, (EXECUTE, scenarios(1)[0].to_json().encode())) == [problem]


def test_a_node_that_cannot_load_the_ads_says_so(start):
    problem = asyncio.run(start("model.npz").begin())
    assert problem[:1] == REFUSED
    assert b"model.npz" in problem


def test_a_node_works_in_the_folder_of_the_campaign_if_it_has_one(start, tmp_path):
    (tmp_path / "own_driver.py").write_text("from tests.drivers import Cruiser as Driver")
    node = start("own_driver:Driver", folder=tmp_path)
    assert asked(node, (FINGERPRINT, b"[]"))[0][:1] == RESULT
    assert Path.cwd() == tmp_path
