"""The folder of an evaluation: it goes on after any interruption, and other commands read its failures."""

import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from PIL import Image

import behavexplor
from behavexplor.api.rate_folder import CARD, OUTCOMES, PICTURE, RateFolder, impact
from behavexplor.api.run import Run
from behavexplor.campaign.config import campaign_config
from behavexplor.campaign.folder_format import DATABASE
from behavexplor.commands import BAD_INPUT, OK, main
from behavexplor.errors import InputError
from behavexplor.evaluation import BLOCK, estimate_rates, failing, start_judge
from behavexplor.execution.start import logical_of_target
from behavexplor.judge.fault import is_at_fault
from behavexplor.judge.rates import Goal

CONFIG = campaign_config({"env": "roundabout-v0", "ads": "constant:FASTER"})


def evaluated(folder, n, workers=0, goal=None):
    """The evaluation in a folder, and the bytes of its file."""
    found = RateFolder(folder, CONFIG)
    with start_judge(CONFIG.target, workers) as judge:
        logical = logical_of_target(judge, CONFIG.env)
        result = estimate_rates(judge, logical, n, CONFIG.seed, goal=goal, file=found.file)
    return result, (folder / OUTCOMES).read_bytes()


def test_a_folder_with_files_of_the_users_own_is_left_as_it_is(tmp_path):
    (tmp_path / "card.md").write_text("mine")
    with pytest.raises(InputError, match="is not empty, and holds no evaluation"):
        RateFolder(tmp_path, CONFIG)
    assert [path.name for path in tmp_path.iterdir()] == ["card.md"]


def test_workers_do_not_change_the_file(tmp_path):
    found = [evaluated(tmp_path / str(workers), 700, workers) for workers in (0, 1, 2)]
    assert found[0] == found[1] == found[2]
    assert found[0][1].count(b"\n") == 4
    assert found[0][0].n == 700


def test_a_file_that_was_cut_short_anywhere_becomes_the_same_again(tmp_path):
    whole = evaluated(tmp_path / "whole", 600)
    generator = np.random.default_rng(0)
    for k, cut in enumerate(generator.integers(0, len(whole[1]), 8).tolist()):
        folder = tmp_path / str(k)
        folder.mkdir()
        (folder / OUTCOMES).write_bytes(whole[1][:cut])
        assert evaluated(folder, 600) == whole


@pytest.mark.parametrize("deleted", ["", OUTCOMES])
def test_a_folder_that_is_deleted_while_it_is_filled_is_named(deleted, tmp_path):
    folder = tmp_path / "evaluation"
    evaluated(folder, 20)
    found = RateFolder(folder, CONFIG)
    block = next(found.file.blocks())
    (folder / deleted).rename(tmp_path / "other")
    with pytest.raises(InputError, match=rf"{OUTCOMES} was deleted or moved while the evaluation ran"):
        found.file.append(block)


def test_an_evaluation_goes_on_where_it_ended(tmp_path):
    first, _ = evaluated(tmp_path, BLOCK)
    assert first.n == BLOCK
    longer, content = evaluated(tmp_path, 2 * BLOCK)
    assert (longer, content) == evaluated(tmp_path / "at-once", 2 * BLOCK)
    again, same = evaluated(tmp_path, BLOCK)
    assert (again, same) == (first, content)


def test_a_decision_does_not_depend_on_what_lies_behind_it(tmp_path):
    goal = Goal("failed", below=0.2)
    alone = evaluated(tmp_path / "a", 2000, goal=goal)[0]
    evaluated(tmp_path / "b", 700)
    assert evaluated(tmp_path / "b", 2000, workers=2, goal=goal)[0] == alone
    assert alone.decision.verdict == "above"


def test_failures_are_drawn_again_by_their_numbers(tmp_path):
    evaluated(tmp_path, 600)
    with start_judge(CONFIG.target, 0) as judge:
        logical = logical_of_target(judge, CONFIG.env)
        file = RateFolder(tmp_path, CONFIG).file
        found = list(failing(file, logical, CONFIG.seed, 590))
        outcomes = [one for block in file.blocks() for one in block.outcomes]
    assert [number for number, _ in found] == [i for i, one in enumerate(outcomes[:590]) if not one.passed]
    generator = np.random.default_rng([0x6576616C, 0])
    scenarios = [logical.sample(generator) for _ in range(590)]
    assert all(scenarios[number] == scenario for number, scenario in found)


def test_another_evaluation_is_refused(tmp_path):
    RateFolder(tmp_path, CONFIG)
    with pytest.raises(InputError, match="belongs to another evaluation"):
        RateFolder(tmp_path, campaign_config({"env": "roundabout-v0", "ads": "careful"}))


def test_two_evaluations_do_not_write_into_one_folder(tmp_path):
    """Both appended their outcomes, which were counted twice then."""
    first = RateFolder(tmp_path, CONFIG)
    with pytest.raises(InputError, match="is in use"):
        RateFolder(tmp_path, CONFIG)
    with pytest.raises(InputError, match="is in use"):
        behavexplor.evaluate("constant:FASTER", "roundabout-v0", scenarios=1, out=tmp_path)
    first.close()
    behavexplor.evaluate("constant:FASTER", "roundabout-v0", scenarios=1, out=tmp_path)  # though it has written a lock
    with pytest.raises(KeyboardInterrupt) as held:  # whose traceback keeps all that was in use
        behavexplor.evaluate("constant:FASTER", "roundabout-v0", scenarios=2, out=tmp_path, observe=interrupt)
    behavexplor.evaluate("constant:FASTER", "roundabout-v0", scenarios=2, out=tmp_path)
    assert held.value.args == ("now",)


def test_a_folder_that_is_refused_is_not_locked(tmp_path):
    RateFolder(tmp_path, CONFIG).close()
    with pytest.raises(InputError, match="belongs to another evaluation") as held:  # whose traceback has the folder
        RateFolder(tmp_path, campaign_config({"env": "roundabout-v0", "ads": "careful"}))
    RateFolder(tmp_path, CONFIG).close()
    assert held.value


def interrupt(_):
    raise KeyboardInterrupt("now")


def test_failures_of_which_a_full_disk_left_none_are_driven_again(tmp_path):
    whole = behavexplor.evaluate("constant:FASTER", "roundabout-v0", scenarios=20, out=tmp_path)
    database = tmp_path / "failures" / DATABASE
    for path in database.parent.glob(f"{DATABASE}*"):
        path.unlink()
    database.touch()
    assert behavexplor.evaluate("constant:FASTER", "roundabout-v0", scenarios=20, out=tmp_path) == whole
    assert len(Run(tmp_path / "failures").records) == whole.failed > 0


def test_a_damaged_file_is_named(tmp_path):
    file = RateFolder(tmp_path, CONFIG).file
    with file.path.open("a") as stream:
        stream.write('{"kinds": [], "codes": "A"}\n')
    with pytest.raises(InputError, match="line 2, is damaged"):
        list(file.blocks())


def test_the_failures_are_a_run_and_the_card_tells_the_rates(tmp_path, capsys):
    folder = tmp_path / "rates"
    command = ["evaluate", "--env", "roundabout-v0", "--ads", "constant:FASTER", "--workers", "0", "--no-controls"]
    assert main([*command, "--scenarios", "30", "--out", str(folder), "--quiet"]) == OK
    assert main([*command, "--scenarios", "60", "--out", str(folder), "--quiet"]) == OK
    card = json.loads((folder / f"{CARD}.json").read_text())
    failed = card["rates"]["failed"]
    assert card["scenarios"] == 60
    assert failed["low"] < failed["count"] / 60 == failed["rate"] < failed["high"]
    assert sum(one["failures"] for one in card["classes"]) == failed["count"]
    text = (folder / f"{CARD}.md").read_text()
    assert "which says nothing about roads" in text
    assert f"| failed | {failed['count']} |" in text
    assert f"({PICTURE})" in text
    with Image.open(folder / PICTURE) as picture:
        assert picture.format == "PNG"
    run = str(folder / "failures")
    crashes = [one.id for one in Run(run).records if one.fault and is_at_fault(one.fault)]
    impacts = {number: round(impact(Run(run).trace(number)), 2) for number in crashes}
    assert impacts[card["hardest"]["execution"]] == card["hardest"]["impact"] == max(impacts.values())
    assert main(["replay", run, "0"]) == OK
    assert main(["report", run, "--replays", "1"]) == OK
    (folder / PICTURE).unlink()
    (folder / PICTURE).mkdir()
    assert main([*command, "--scenarios", "60", "--out", str(folder), "--quiet"]) == BAD_INPUT
    assert f"{PICTURE} cannot be written: Is a directory" in capsys.readouterr().err
    assert main([*command, "--seed", "1", "--out", str(folder)]) == BAD_INPUT
    assert "belongs to another evaluation" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("workers", [0, 1, 2])
def test_a_killed_evaluation_goes_on(workers, tmp_path):
    command = [sys.executable, "-m", "behavexplor", "evaluate", "--env", "roundabout-v0", "--ads", "careful"]
    command += ["--scenarios", "6000", "--no-controls", "--quiet", "--workers", str(workers), "--out"]
    whole = tmp_path / "whole"
    subprocess.run([*command, str(whole)], check=True, capture_output=True)
    generator, killed = np.random.default_rng(workers), 0
    for _ in range(20):
        process = subprocess.Popen([*command, str(tmp_path / "killed")], stdout=subprocess.DEVNULL)
        time.sleep(generator.uniform(2, 6))
        process.send_signal(signal.SIGKILL)
        killed += process.wait() == -signal.SIGKILL
    assert killed
    subprocess.run([*command, str(tmp_path / "killed")], check=True, capture_output=True)
    for name in (OUTCOMES, f"{CARD}.json"):
        assert (tmp_path / "killed" / name).read_bytes() == (whole / name).read_bytes()
