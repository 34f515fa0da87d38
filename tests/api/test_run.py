"""A run as an object: its tables, replays, page and triage."""

import io
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

import behavexplor
from behavexplor.api.dataframes import frame_of
from behavexplor.campaign.run_summary import snippet
from behavexplor.errors import InputError
from behavexplor.judge.classes import words_of
from tests.drivers import Cruiser


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of an object in memory."""
    folder = tmp_path_factory.mktemp("run") / "run"
    return behavexplor.find_failures(
        Cruiser(), "intersection-straight", budget=12, method="uniform", seed=5, out=folder
    )


def test_failures_and_records_are_tables(run):
    table, failures = run.to_pandas(), run.failures
    assert list(table.index) == list(range(12))
    assert list(failures.index) == [record.id for record in run.records if record.failed]
    assert failures.failed.all()
    assert (failures["class"].map(words_of) == failures.words).all()
    assert table.degree_collision.equals(
        table.index.map(lambda i: run.records[i].degrees["collision"]).to_series(index=table.index)
    )
    assert list(frame_of([]).columns) == [name for name in table.columns if not name.startswith(("degree_", "search_"))]


def test_classes_list_their_failures(run):
    listed = sorted(number for numbers in run.classes.values() for number in numbers)
    assert listed == list(run.failures.index)
    counts = [len(numbers) for numbers in run.classes.values()]
    assert counts == sorted(counts, reverse=True)
    assert [one.id for one in run.summary.classes] == list(run.classes)
    assert sum(one.at_fault for one in run.summary.classes) == run.summary.at_fault


def test_a_run_shows_itself(run):
    assert f"{run.summary.failed} failed (" in repr(run)
    html = run._repr_html_()
    assert all(one.words.replace("'", "&#x27;") in html for one in run.summary.classes)


def test_traces_and_scenarios_can_be_read(run):
    durations = [trace.duration for trace in run.traces]
    assert durations == [record.duration for record in run.records]
    assert run.trace(np.int64(3)).duration == durations[3]
    assert run.scenario(3) == run.records[3].load_scenario()
    with pytest.raises(behavexplor.InputError, match="has no execution 99"):
        run.trace(99)


def test_a_replay_is_an_animation(run, tmp_path):
    replay = run.replay(run.failures.duration.idxmin())
    assert replay._repr_html_().startswith("<figure><img")
    with Image.open(io.BytesIO(replay.gif)) as animation:
        assert animation.n_frames == pytest.approx(replay.trace.duration / 0.1, abs=3)
    with Image.open(replay.save(tmp_path / "a.png")) as picture:
        assert picture.size == (600, 600)
    assert replay.save(tmp_path / "a.gif").read_bytes() == replay.gif
    with pytest.raises(behavexplor.InputError, match=r"saved as \.gif or \.png"):
        replay.save(tmp_path / "a.mp4")
    with pytest.raises(behavexplor.InputError, match="cannot be written"):
        replay.save(tmp_path / "nowhere" / "a.gif")


def test_an_execution_is_repeated(run):
    assert run.repeat(0).reproduced


def test_triage_and_the_page_tell_of_all_failures(run):
    found = run.triage()
    assert [finding.id for finding in found.findings] == list(run.failures.index)
    assert all(finding.same_trace for finding in found.findings)
    text = run.report().read_text()
    assert all(class_id in text for class_id in run.classes)
    assert run.report(run.folder / "other.html", replays=0).is_file()


def test_the_words_of_a_class_follow_from_its_id():
    assert words_of("R2/changing-right/right/fast") == "Touched a line on its right at speed while changing lanes right"
    assert words_of("brakes/going-straight/ended-by-timeout").startswith(
        "Violated brakes (end of the episode: timeout)"
    )
    assert words_of("error/hang") == "The driving system did not answer in time"
    assert words_of("of another version") == "of another version"


def test_failures_are_minimized_with_the_driver_in_memory(run):
    found = run.minimize()
    assert found
    assert all(one.minimal.values <= one.found.values for one in found)
    assert [one.id for one in run.minimize([found[0].id])] == [found[0].id]
    passed = next(record.id for record in run.records if not record.failed)
    with pytest.raises(InputError, match="has no failure"):
        run.minimize([passed])


@pytest.mark.filterwarnings("ignore:The (ADS|driver) always")
@pytest.mark.parametrize(("env", "driver"), [("intersection-straight", Cruiser), ("merge-v0", None)])
def test_an_execution_goes_on_in_a_loop_of_ones_own(env, driver, tmp_path):
    driver = driver() if driver else "constant:FASTER"
    found = behavexplor.find_failures(driver, env, budget=12, method="uniform", seed=5, out=tmp_path / "run")
    run = behavexplor.open_run(found.folder, driver)
    assert len(run.failures)
    for number in run.failures.index:
        env = run.env(number)
        for _ in range(2):  # a reset begins the same scenario again
            observation, info = env.reset()
            while "trace" not in info:
                observation, _, _, _, info = env.step(env.driver(observation))
            assert info["trace"].to_bytes() == run.trace(number).to_bytes()
        assert run.violated(info["trace"]) == run.records[number].violated
        env.close()


def test_an_episode_of_ones_own_is_rendered_and_must_begin(run):
    env = run.env(0, render_mode="rgb_array")
    with pytest.raises(InputError, match="call reset first"):
        env.driver(None)
    env.reset()
    assert env.render().ndim == 3
    env.close()


def test_a_driver_in_memory_must_be_given_again_for_its_episode(run):
    with pytest.raises(InputError, match="give it again in Python"):
        behavexplor.open_run(run.folder).env(0)


def test_the_printed_lines_reproduce_a_failure(tmp_path):
    folder = tmp_path / "run"
    run = behavexplor.find_failures("idm", "intersection-left", budget=6, seed=1, out=folder)
    number = int(run.failures.index[0])
    told = subprocess.run(
        [sys.executable, "-c", snippet(folder, number)], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    assert told.stdout.strip() == repr(run.records[number].violated)
