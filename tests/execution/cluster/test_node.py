"""A node without a cluster: the process that it starts, what comes back from it, and that it ends."""

import asyncio
import gc
import json
import os
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from behavexplor.data.target import Target
from behavexplor.execution.cluster.node import Node, NodeLostError
from behavexplor.execution.evaluator import EXECUTE, evaluator_recipe
from behavexplor.execution.fingerprint import FINGERPRINT
from behavexplor.execution.messages import ADS_FAILED, FAILED, REFUSED, RESULT
from behavexplor.execution.simulation import Simulation, logical_scenario

ROOT = Path(__file__).parents[3]
ENV = "lane-follow"


def started(ads, folder=ROOT):
    recipe = evaluator_recipe(Target(ENV, ads))
    settings = {"recipe": recipe.to_json(), "time_limit": 60.0, "memory_limit": 8.0}
    return Node(json.dumps(settings), str(folder))


def asked(node, *calls):
    async def all_answers():
        return await asyncio.gather(*(node.ask(*call) for call in calls), return_exceptions=True)

    return asyncio.run(all_answers())


def is_gone(process, seconds=20.0):
    """Whether a process, which is no child of ours or is waited for, ends soon."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        try:
            if Path(f"/proc/{process}/stat").read_text().rpartition(") ")[2].startswith("Z"):
                return True
        except FileNotFoundError:
            return True
        time.sleep(0.02)
    return False


def descendants(process):
    children = [
        int(child) for task in Path(f"/proc/{process}/task").glob("*/children") for child in task.read_text().split()
    ]
    return children + [descendant for child in children for descendant in descendants(child)]


def scenarios(count):
    logical = logical_scenario(ENV)
    return [logical.sample(np.random.default_rng(seed)) for seed in range(count)]


def test_answers_are_those_of_a_worker_whatever_the_ads_prints():
    chosen = scenarios(5)
    simulation = Simulation(ENV, "tests.drivers:Cruiser")
    expected = [RESULT + simulation.run(scenario).to_bytes() for scenario in chosen]
    node = started("tests.faults:Printing")
    calls = [(EXECUTE, scenario.to_json().encode()) for scenario in chosen]
    assert asked(node, *calls) == expected
    asyncio.run(node.end())


def test_failures_have_their_tags_and_say_where():
    node = started("tests.faults:Segfaulting")
    calls = [(EXECUTE, scenario.to_json().encode()) for scenario in scenarios(1)]
    failed, refused, unknown = asked(node, *calls, (EXECUTE, b"{}"), ("nonsense", b""))
    assert failed[:1] == ADS_FAILED
    assert json.loads(failed[1:])["kind"] == "crash"
    assert refused[:1] == REFUSED
    assert "functional: missing" in refused.decode()
    assert unknown[:1] == FAILED
    assert f"(on the node {os.uname().nodename})" in unknown.decode()
    asyncio.run(node.end())


def test_an_ads_that_is_not_there_is_named(tmp_path):
    """Also in a folder that only the campaign's machine has: the node works where it was started then."""
    node = started("model.npz", tmp_path / "elsewhere")
    answer = asked(node, (FINGERPRINT, b'["model.npz"]'))[0]
    assert answer[:1] == REFUSED
    assert "model.npz" in answer.decode()
    asyncio.run(node.end())


def test_a_process_that_was_killed_is_lost_with_all_its_calls():
    node = started("constant")
    assert asked(node, (FINGERPRINT, b'["constant"]'))[0][:1] == RESULT
    threading.Timer(0.2, os.kill, [node._process.pid, signal.SIGKILL]).start()
    calls = [(EXECUTE, scenario.to_json().encode()) for scenario in scenarios(30)]
    assert any(isinstance(answer, NodeLostError) for answer in asked(node, *calls * 20))
    assert isinstance(asked(node, (FINGERPRINT, b'["constant"]'))[0], NodeLostError)
    asyncio.run(node.end())


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="it looks for processes in /proc")
def test_a_node_that_is_forgotten_leaves_no_process():
    """Ray and Dask forget a node when the campaign that asked for it has gone."""
    node = started("constant")
    asked(node, (FINGERPRINT, b'["constant"]'))
    process = node._process.pid
    family = descendants(process)
    assert len(family) >= 2  # what starts workers, and a worker
    del node
    gc.collect()
    assert all(map(is_gone, [process, *family]))


def test_ctrl_c_is_the_campaigns():
    node = started("constant")
    asked(node, (FINGERPRINT, b'["constant"]'))
    assert os.getpgid(node._process.pid) != os.getpgrp()
    os.kill(node._process.pid, signal.SIGINT)
    assert asked(node, (FINGERPRINT, b'["constant"]'))[0][:1] == RESULT
    asyncio.run(node.end())
