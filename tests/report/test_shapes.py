"""What is drawn: charts, behaviors, roads, marks."""

import re
from contextlib import closing
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from behavexplor.campaign.store import Store
from behavexplor.data.road_shape import RoadShape
from behavexplor.errors import InputError
from behavexplor.report.behavior_map import LETTERS, classical_scaling, find_behaviors
from behavexplor.report.charts import BOTTOM, HEIGHT, LEFT, RIGHT, TOP, WIDTH, Series, chart, ticks
from behavexplor.report.gallery import PASSED, cards, replay_values
from behavexplor.report.reading import read_run
from behavexplor.report.road_shapes import known_road, road_values
from behavexplor.report.run_page import evenly

NO_RUN = Path("no-such-run")


@pytest.fixture(scope="module")
def executions(run):
    with closing(Store.read(run)) as store:
        return list(store.executions())


@pytest.fixture(scope="module")
def found(executions):
    return find_behaviors({execution.id: execution.load_trace() for execution in executions})


@pytest.mark.parametrize(
    ("start", "end"), [(0, 1), (0, 13), (0, 0), (-1.3, 4.7), (0, 1e-3), (0, 123456), (0.0, 5.0), (3, 3)]
)
def test_ticks_are_round_few_and_span_the_values(start, end):
    marks = ticks(start, end)
    assert marks[0] <= start
    assert marks[-1] >= end
    assert 2 <= len(marks) <= 7
    step = marks[1] - marks[0]
    assert np.allclose(np.diff(marks), step)
    assert round(step / 10 ** np.floor(np.log10(step) + 1e-9)) in (1, 2, 5, 10)


def test_a_line_begins_and_ends_with_its_values_and_stays_in_the_chart():
    numbers = np.arange(1.0, 2001.0)
    drawn = chart("Failures", [Series("failures", numbers, np.cumsum(numbers % 7 == 0).astype(float))])
    assert drawn is not None
    places = [float(text) for text in re.findall(r"-?[\d.]+", drawn.series[0].path)]
    assert min(places) >= TOP
    assert max(places) <= WIDTH - RIGHT
    level = {label: place for place, label in drawn.y_ticks}
    last = float(re.findall(r"V([\d.]+)", drawn.series[0].path)[-1])
    assert level["0"] == HEIGHT - BOTTOM
    share = (level["0"] - last) / (level["0"] - level["300"]) * 300
    assert share == pytest.approx(2000 // 7, abs=1)
    assert drawn.rows[0] == ("1", "0")
    assert drawn.rows[-1] == ("2000", str(2000 // 7))
    assert drawn.x_ticks[0] == (LEFT, "0")


def test_dots_are_drawn_where_there_are_values_and_a_chart_without_any_is_none():
    numbers = np.arange(4.0)
    drawn = chart("Novelty", [Series("novelty", numbers, np.array([np.nan, 0.5, np.nan, 1.0]), dots=True)])
    assert drawn is not None
    assert len(drawn.series[0].dots) == 2
    assert [row[1] for row in drawn.rows] == ["", "0.5", "", "1"]
    assert chart("Energy", [Series("energy", numbers, np.full(4, np.nan))]) is None


def test_a_map_keeps_distances_that_fit_into_the_plane():
    points = np.random.default_rng(3).normal(size=(40, 2)) * (3.0, 1.0)
    distances = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
    shown = classical_scaling(distances)
    assert np.allclose(np.hypot(*(shown[:, None] - shown[None]).transpose(2, 0, 1)), distances)
    assert np.array_equal(shown, classical_scaling(distances))
    assert np.ptp(shown[:, 0]) > np.ptp(shown[:, 1])


@pytest.mark.parametrize("count", [1, 2])
def test_a_map_of_few_is_a_map(count):
    assert classical_scaling(1.0 - np.eye(count)).shape == (count, 2)


def test_behaviors_cover_each_trace_and_are_named_by_speed(executions, found):
    for execution in executions:
        stretches = found.stretches(execution.id)
        assert sum(count for _, count in stretches) == len(found.labels[execution.id])
        assert all(letter in LETTERS for letter, _ in stretches)
        assert all(before[0] != after[0] for before, after in pairwise(stretches))
    speeds = [state.speed for state in found.states]
    assert speeds == sorted(speeds)
    assert sum(state.share for state in found.states) == pytest.approx(1)
    assert len({state.letter for state in found.states}) == len(found.states)


def test_evenly_takes_the_ends_and_no_more_than_wanted():
    assert evenly(range(10), 20) == list(range(10))
    assert evenly(range(100), 3) == [0, 49, 99]
    assert evenly([], 3) == []


def test_each_class_has_a_replay_before_any_has_two(run):
    read = read_run(run)
    classes = len(read.classes)
    few = cards(read, classes)
    assert [len(card.replays) for card in few if card.class_id != PASSED] == [1] * classes
    assert sum(len(card.replays) for card in cards(read, 1)) == 1
    every = cards(read, 10_000)
    assert sum(len(card.replays) for card in every if card.class_id != PASSED) == len(read.findings)
    assert [card.count for card in every if card.class_id != PASSED] == sorted(
        (len(findings) for findings in read.classes.values()), reverse=True
    )
    assert all(not card.replays for card in cards(read, 0))


def test_a_collision_is_marked_where_both_vehicles_are(executions, found):
    collisions = [execution for execution in executions if "collision" in execution.record.violated]
    assert collisions
    for execution in collisions:
        trace = execution.load_trace()
        values = replay_values(trace, execution.record, found.stretches(execution.id))
        for vehicle in (0, values["partner"]):
            gap = np.array(values["mark"]) - trace.position[-1, vehicle]
            cos, sin = np.cos(trace.heading[-1, vehicle]), np.sin(trace.heading[-1, vehicle])
            ahead, across = gap @ (cos, sin), gap @ (-sin, cos)
            assert abs(ahead) <= trace.size[vehicle, 0] / 2 + 0.05
            assert abs(across) <= trace.size[vehicle, 1] / 2 + 0.05
        assert values["moment"] == values["frames"] - 1
        assert len(values["types"]) == values["vehicles"] - 1 == len(values["size"]) - 1


@pytest.mark.parametrize("name", ["intersection-left", "behavexplor/lane-change-v0"])
def test_the_road_of_our_environments_is_known(name, executions):
    env = gymnasium.make(name if "/" in name else f"behavexplor/{name}-v0")
    road = env.unwrapped.logical.roadmap
    values = road_values(known_road(name, NO_RUN), [executions[0].load_trace()])
    assert len(values["lanes"]) == len(road.lanes)
    assert set(values["routes"]) == set(road.routes)
    ends = [np.hypot(*np.subtract(*dash)) for dash in values["dashes"]]
    assert max(ends) == pytest.approx(3.0, abs=0.02)


def test_double_yellow_lines_and_curbs_are_told_apart(executions):
    trace = executions[0].load_trace()
    kinds = {line["kind"] for line in road_values(known_road("intersection-straight", NO_RUN), [trace])["lines"]}
    assert kinds == {"double-yellow", "curb"}
    assert {line["kind"] for line in road_values(known_road("lane-change", NO_RUN), [trace])["lines"]} == {"curb"}


def test_the_road_of_a_stock_environment_is_in_its_run(tmp_path, executions):
    road = RoadShape((np.zeros((4, 2)),), striped=(np.array([[0.0, 0.0], [30.0, 0.0]]),))
    (tmp_path / "road.json").write_text(road.to_json())
    found = known_road("merge-v0", tmp_path)
    assert [dash.tolist() for dash in found.dashes(np.array([5.0, -1.0]), np.array([16.0, 1.0]))] == [
        [[6.0, 0.0], [9.0, 0.0]],
        [[12.0, 0.0], [15.0, 0.0]],
    ]
    (tmp_path / "road.json").write_text('{"surfaces": [[1]], "striped": [], "borders": []}')
    with pytest.raises(InputError, match="surfaces of the shape of a road must be lines of at least two points within"):
        known_road("merge-v0", tmp_path)


def test_dashes_are_drawn_along_all_drives(executions):
    road = RoadShape((np.zeros((4, 2)),), striped=(np.array([[0.0, 0.0], [3000.0, 0.0]]),))
    early = executions[0].load_trace()
    late = replace(early, position=early.position - early.position[0, 0] + [2000.0, 0.0])
    early = replace(early, position=early.position - early.position[0, 0])
    starts = [dash[0][0] for dash in road_values(road, [early, late])["dashes"]]
    assert min(starts) == 0.0
    assert max(starts) > 2000.0
    assert max(dash[0][0] for dash in road_values(road, [early])["dashes"]) < 500.0


@pytest.mark.parametrize("name", ["strangers:package/road-v0", "CartPole-v1", "behavexplor/nowhere-v0", "../x"])
def test_no_environment_of_others_is_made(name, executions, monkeypatch):
    monkeypatch.setattr(gymnasium, "make", lambda *_, **__: pytest.fail("made"))
    assert not known_road(name, NO_RUN).surfaces
    values = road_values(RoadShape(()), [executions[0].load_trace()])
    assert values["lanes"] == []
    assert values["lines"]


def test_counts_have_whole_ticks():
    numbers = np.arange(1.0, 4.0)
    for counts, labels in (([0.0, 1.0, 1.0], ["0", "1"]), ([0.0, 0.5, 1.0], ["0", "0.2", "0.4", "0.6", "0.8", "1"])):
        drawn = chart("Failures", [Series("failures", numbers, np.array(counts))])
        assert [label for _, label in drawn.y_ticks] == labels
