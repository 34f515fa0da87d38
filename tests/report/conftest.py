"""Small runs to report on."""

import json
from dataclasses import replace

import pytest

from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.record import Record
from behavexplor.campaign.store import Execution, Store
from behavexplor.commands import OK, main

EVIL = "</script><script>document.title='broken'</script><img src=x onerror=alert(1)>"


@pytest.fixture(scope="session")
def run(tmp_path_factory):
    """A run of a driver that sees nothing, with failures; nobody has triaged it."""
    folder = tmp_path_factory.mktemp("report") / "cruiser-run"
    arguments = ["--ads", "tests.drivers:cruiser", "--method", "behavexplor", "--budget", "24", "--seed", "5"]
    assert main(["fuzz", *arguments, "--workers", "0", "--unconfined", "--quiet", "--out", str(folder)]) == OK
    return folder


def changed(record, change):
    """The record with other JSON values; None if there are none."""
    values = change(record.to_dict())
    return None if values is None else Record.from_json(json.dumps(values))


def copied(run, folder, config=None, change=lambda record: record):
    """Another run with the same executions, or changed ones, or some of them, numbered anew."""
    store = Store.read(run)
    executions = list(store.executions())
    store.close()
    copy = Store.create(folder, (config or CampaignConfig(ads="tests.drivers:cruiser", seed=5)).to_yaml())
    kept = [(changed(execution.record, change), execution) for execution in executions]
    for number, (record, execution) in enumerate((r, e) for r, e in kept if r is not None):
        copy.add(Execution(replace(record, id=number), execution.trace, execution.elapsed))
    copy.commit()
    copy.close()
    return folder


@pytest.fixture(scope="session")
def evil_run(run, tmp_path_factory):
    """The same, but every name in it would break a page that does not escape."""
    config = replace(CampaignConfig(), env=f"env {EVIL}", ads=f"ads {EVIL}", options={f"option {EVIL}": EVIL})

    def change(record):
        npcs = [{**npc, "type": EVIL, "route": "__proto__"} for npc in record["scenario"]["npcs"]]
        return {**record, "end": EVIL, "scenario": {**record["scenario"], "npcs": npcs}}

    return copied(run, tmp_path_factory.mktemp("evil") / "run <b>&amp;", config, change)


@pytest.fixture(scope="session")
def harmless_run(run, tmp_path_factory):
    """Only the executions that violate nothing."""
    return copied(run, tmp_path_factory.mktemp("harmless") / "harmless", change=lambda r: None if r["violated"] else r)
