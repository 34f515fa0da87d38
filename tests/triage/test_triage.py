"""The command: what it finds out about a run, keeps in its folder, and says."""

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.confirmation import read_confirmations
from behavexplor.campaign.record import Record
from behavexplor.campaign.store import Execution, Store
from behavexplor.commands import BAD_INPUT, CHECK_FAILED, EXECUTION_FAILED, OK, main
from behavexplor.commands.triage import report
from behavexplor.data.scenario import parse_scenario
from behavexplor.errors import InputError
from behavexplor.execution.simulation import Simulation
from behavexplor.judge.specs import judge
from behavexplor.triage.examination import repeat
from behavexplor.triage.findings import TRIAGE, Finding, Sighting, Triage, WeaknessRecord, read_witness, witness_path
from behavexplor.triage.witness import replay_witness
from tests.drivers import Cruiser

SCENARIOS = Path(__file__).parent.parent / "ads" / "scenarios"


class Wavering(Cruiser):
    """Drives otherwise whenever it is asked again."""

    asked = 0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        if state is None:
            type(self).asked += 1
        actions, _ = super().predict(observation)
        return actions * 0.9**self.asked, True


def fuzz(folder, ads, budget, *more, code=OK):
    arguments = ["fuzz", "--ads", ads, "--method", "uniform", "--budget", str(budget), "--workers", "0", "--quiet"]
    assert main([*arguments, "--unconfined", "--out", str(folder), *more]) == code


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of the rule planner with two failures, the same one twice, triaged."""
    folder = tmp_path_factory.mktemp("triage") / "run"
    config = CampaignConfig(env="intersection-straight", ads="rule:hardened+R1-1", method="uniform")
    simulation = Simulation(config.env, config.ads)
    store = Store.create(folder, config.to_yaml())
    for number, name in enumerate(["R1-1", "R1-3", "R1-1"]):
        scenario = parse_scenario((SCENARIOS / f"{name}.json").read_text())
        trace = simulation.run(scenario)
        record = Record(id=number, end=trace.end, violated=judge(trace).violated, scenario=scenario.to_dict())
        store.add(Execution(record, trace.to_bytes(), 0.0))
    store.commit()
    store.close()
    assert main(["triage", str(folder), "--workers", "0", "--quiet"]) == OK
    return folder


def failed(folder):
    store = Store.read(folder)
    executions = [execution for execution in store.executions() if execution.record.failed]
    store.close()
    return executions


def test_every_failure_has_a_finding_and_happened_again(run):
    found = Triage.read(run)
    assert [finding.id for finding in found.findings] == [execution.id for execution in failed(run)] == [0, 2]
    assert all(finding.same_verdict and finding.same_trace for finding in found.findings)
    assert [(f.spec, f.cause, f.signature, f.fault) for f in found.findings] == [
        ("R1", "R1-1", "R1-1", "preventable")
    ] * 2
    assert (found.env, found.ads, found.executions) == ("intersection-straight", "rule:hardened+R1-1", 3)


def test_witnesses_are_files_that_anyone_can_replay(run):
    preventable = [finding for finding in Triage.read(run).findings if finding.fault == "preventable"]
    assert preventable
    simulation = Simulation("intersection-straight", "rule")
    store = Store.read(run)
    for finding in preventable:
        witness = read_witness(witness_path(run, finding.id))
        assert witness.name == finding.avoidance
        again = replay_witness(simulation, store.execution(finding.id).scenario, witness)
        assert "collision" not in judge(again).violated
    store.close()


def test_a_witness_is_replayed_to_pictures(run, tmp_path, capsys):
    assert main(["replay", str(run), "2", "--avoided", "--out", str(tmp_path)]) == OK
    witness = read_witness(witness_path(run, 2))
    assert f": {witness.name} from {witness.begin:.2f} s on" in capsys.readouterr().out
    with Image.open(tmp_path / "000002-avoided.gif") as animation:
        assert animation.n_frames > 10
    assert (tmp_path / "000002-avoided.png").is_file()


def test_without_a_collision_there_is_nothing_to_avoid(run, tmp_path, capsys):
    assert main(["replay", str(run), "1", "--avoided", "--out", str(tmp_path)]) == BAD_INPUT
    assert "Execution 1 has no collision that could be avoided" in capsys.readouterr().err


def test_a_witness_that_avoids_nothing_is_said_so(run, tmp_path, capsys):
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    path = witness_path(folder, 0)
    values = json.loads(path.read_text())
    path.write_text(json.dumps({**values, "commands": [[4.0, 0.0]] * len(values["commands"])}))
    assert main(["replay", str(folder), "0", "--avoided"]) == CHECK_FAILED
    assert "does NOT avoid the collision" in capsys.readouterr().err
    assert not (folder / "replays").exists()


def test_weaknesses_are_counted_over_all_executions(run):
    found = Triage.read(run)
    record = found.weaknesses["R1-1"]
    assert record.reached == Sighting(3, 0)
    assert record.triggered == Sighting(3, 0)
    assert record.detected == Sighting(2, 0)
    assert all(found.weaknesses[name].reached == Sighting() for name in found.weaknesses if name != "R1-1")


def test_what_is_known_is_not_found_out_again(run, tmp_path, capsys):
    copy = tmp_path / "copy"
    shutil.copytree(run, copy)
    values = json.loads((copy / TRIAGE).read_text())
    values["findings"][0]["words"] = "as it was"
    dropped = values["findings"].pop()
    (copy / TRIAGE).write_text(json.dumps(values))
    assert main(["triage", str(copy), "--workers", "0", "--quiet"]) == OK
    found = Triage.read(copy)
    assert found.findings[0].words == "as it was"
    assert found.findings[-1].id == dropped["id"]
    assert replace(found, findings=found.findings[1:]) == replace(
        Triage.read(run), findings=Triage.read(run).findings[1:]
    )
    assert main(["triage", str(copy), "--workers", "0", "--quiet", "--afresh"]) == OK
    assert (copy / TRIAGE).read_bytes() == (run / TRIAGE).read_bytes()
    assert f"{len(found.findings)} failures in 3 executions" in capsys.readouterr().out


def test_no_finding_is_lost_with_a_confirmation_and_the_confirmation_is_made_up_for(tmp_path, monkeypatch, capsys):
    def refuse(*_):
        raise RuntimeError("no more")

    folder = tmp_path / "run"
    fuzz(folder, "constant:IDLE", 4, "--env", "merge-v0")
    confirmed = read_confirmations(folder)
    assert confirmed
    shutil.rmtree(folder / "confirmations")
    arguments = ["triage", str(folder), "--workers", "0", "--quiet"]
    with monkeypatch.context() as patch:
        patch.setattr(Simulation, "run", refuse)
        assert main(arguments) == EXECUTION_FAILED
    assert "A failure could not be examined or confirmed: no more" in capsys.readouterr().err
    findings = (folder / TRIAGE).read_bytes()
    assert [finding.id for finding in Triage.read(folder).findings] == [one.record.id for one in failed(folder)]
    assert read_confirmations(folder) == {}
    assert main(arguments) == OK
    assert read_confirmations(folder) == confirmed
    assert (folder / TRIAGE).read_bytes() == findings


def test_worker_processes_find_out_the_same(run, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(run, copy)
    assert main(["triage", str(copy), "--workers", "1", "--quiet", "--afresh"]) == OK
    assert (copy / TRIAGE).read_bytes() == (run / TRIAGE).read_bytes()


def test_other_systems_have_classes_and_faults_but_no_causes(tmp_path, capsys):
    fuzz(tmp_path / "run", "constant:1,0", 6, "--env", "lane-follow")
    assert main(["triage", str(tmp_path / "run"), "--workers", "0", "--quiet"]) == OK
    found = Triage.read(tmp_path / "run")
    assert {finding.fault for finding in found.findings if finding.spec == "R1"} & {"preventable"}
    assert not found.weaknesses
    assert all(finding.cause is finding.signature is None for finding in found.findings)
    assert "cause" not in capsys.readouterr().out


def test_an_ads_that_fails_otherwise_is_a_class_of_its_own(tmp_path):
    fuzz(tmp_path / "run", "tests.drivers:Leaver", 2, code=EXECUTION_FAILED)
    assert main(["triage", str(tmp_path / "run"), "--workers", "0", "--quiet"]) == OK
    findings = Triage.read(tmp_path / "run").findings
    assert [(f.spec, f.class_id, f.same_verdict) for f in findings] == [("error", "error/exit", True)] * 2


def test_what_does_not_happen_again_is_said_to():
    simulation = Simulation("intersection-straight", "tests.triage.test_triage:Wavering")
    scenario = simulation.logical.sample(np.random.default_rng(1))
    trace = simulation.run(scenario)
    assert not repeat(simulation, scenario, trace).same_trace
    steady = Simulation("intersection-straight", "tests.drivers:Cruiser")
    trace = steady.run(scenario)
    assert repeat(steady, scenario, trace).same_trace


def finding(number, class_id, **more):
    return Finding(id=number, spec="R1", class_id=class_id, words="", same_verdict=True, same_trace=True, **more)


def test_the_report_counts_classes_and_weaknesses():
    few = (
        finding(2, "R1/b", cause="R1-1", signature="R1-1", fault="preventable"),
        finding(5, "R1/a", cause="R1-2", signature="R1-1", fault="npc_rear_end"),
        replace(finding(7, "R1/b", cause="R1-1", signature="R1-1", fault="preventable"), same_verdict=False),
    )
    weaknesses = {"R1-1": WeaknessRecord(Sighting(9, 0), Sighting(4, 1), Sighting(2, 2))}
    text = report(Triage("lane-follow", "rule", 10, few, weaknesses))
    lines, said = [line.split() for line in text.splitlines()], " ".join(text.split())
    assert text.startswith("3 failures in 10 executions, in 2 classes; 1 did not happen again")
    assert "R1/b, first 2 fault: the ego's (preventable) cause: R1-1" in said
    assert "R1/a, first 5 fault: another vehicle's (it hit the ego from behind) cause: R1-2" in said
    assert ["R1-1", "9", "0", "4", "1", "2", "2"] in lines


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "create it with `behavexplor triage"),
        ("{", "cannot be read"),
        ("[]", "has format None"),
        ('{"format": 99}', "has format 99"),
        ('{"format": 1, "env": "a", "ads": "b", "executions": "many"}', "executions"),
        ('{"format": 1, "env": "a", "ads": "b", "executions": 1, "extra": 1}', "extra"),
    ],
)
def test_a_file_that_cannot_be_used_is_said_to_be(tmp_path, content, message):
    if content is not None:
        (tmp_path / TRIAGE).write_text(content)
    with pytest.raises(InputError, match=message):
        Triage.read(tmp_path)


def test_a_damaged_witness_is_said_to_be(tmp_path):
    damaged = ((20, [1, 2, 3]), (20, []), (20, [[0, math.nan]]), (0, [[0, 0]]))
    values = [{"name": "a", "begin": 0, "frequency": rate, "commands": commands} for rate, commands in damaged]
    for content in ("", "{}", *map(json.dumps, values)):
        (tmp_path / "w.json").write_text(content)
        with pytest.raises(InputError, match="is not a witness"):
            read_witness(tmp_path / "w.json")


def test_wrong_input_is_one_sentence(run, tmp_path, capsys):
    assert main(["triage", str(tmp_path / "none")]) == BAD_INPUT
    assert "is not a run folder" in capsys.readouterr().err
    assert main(["triage", str(run), "--workers", "65"]) == BAD_INPUT
    assert "between 0 and 64" in capsys.readouterr().err
    copy = tmp_path / "copy"
    shutil.copytree(run, copy)
    text = (copy / "config.yaml").read_text().replace("ads: rule:hardened", "ads: rulle:hardened")
    (copy / "config.yaml").write_text(text)
    assert main(["triage", str(copy), "--afresh"]) == BAD_INPUT
    assert "rulle" in capsys.readouterr().err
