"""Pictures show what the trace says."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from behavexplor.data.road_shape import RoadShape
from behavexplor.envs.functional import IntersectionStraightEnv
from behavexplor.report import drawing
from behavexplor.report.drawing import SIDE, Footage, decisive_frame, draw, save_animation
from behavexplor.report.marks import page_colors
from behavexplor.report.road_shapes import shape_of
from tests.fakes import make_trace, simulate
from tests.strategies import random_trace

LOGICAL = IntersectionStraightEnv.logical

ROADMAP = LOGICAL.roadmap
ROAD = shape_of(ROADMAP)
PAGE = page_colors()
SCENARIO = LOGICAL.sample(np.random.default_rng(0))


def colors(picture):
    return {tuple(color) for color in np.asarray(picture).reshape(-1, 3).tolist()}


def meeting():
    """The ego drives north; an NPC comes towards it, is nearest in frame 5, and touches it in none."""
    y = np.linspace(40, 20, 11)
    ego = np.stack([np.full(11, 1.75), y, np.full(11, -np.pi / 2)], axis=1)
    npc = np.stack([np.full(11, -1.75), 60 - y, np.full(11, np.pi / 2)], axis=1)
    return make_trace(ego, [npc], lines=ROADMAP.illegal_lines)


def test_a_frame_shows_the_road_and_the_vehicles():
    trace = meeting()
    footage = Footage(trace, ROAD, "meeting", ["jeep"])
    picture = draw(footage, 5)
    assert picture.size == (SIDE, SIDE)
    assert {PAGE[name] for name in ("ego", "v2", "road", "ground", "accent")} <= colors(picture)
    assert PAGE["v5"] in colors(draw(replace(footage, types=()), 5))
    middle = picture.getpixel((SIDE // 2, SIDE // 2))
    assert middle == PAGE["ego"]


def test_a_picture_is_no_higher_than_the_road_needs():
    """Its whole width is seen, wherever the ego is."""
    highway = RoadShape((np.array([[-100.0, -2.0], [400.0, -2.0], [400.0, 14.0], [-100.0, 14.0]]),))
    trace = make_trace(np.stack([np.linspace(0, 50, 11), np.linspace(0.0, 12.0, 11), np.zeros(11)], axis=1))
    footage = Footage(trace, highway, "")
    pictures = [draw(footage, frame) for frame in (0, 10)]
    assert {picture.size for picture in pictures} == {(SIDE, 330)}  # 14 m and the margin, on both sides
    for picture in pictures:
        column = [picture.getpixel((SIDE // 2 + 60, y)) for y in range(330)]
        assert column.index(PAGE["road"]) > 48  # below the text
        assert column[-1] == PAGE["ground"]
    assert draw(Footage(trace, RoadShape(()), ""), 0).size == (SIDE, SIDE)


def test_a_violation_has_a_circle_from_its_frame_on():
    trace = meeting()
    position = np.array(trace.position)
    position[:, 1] = position[:, 0] + (0.0, -4.0)
    crash = Footage(replace(trace, position=position), ROAD, "", violated=["collision"])
    assert PAGE["hit"] in colors(draw(crash, 10))
    assert PAGE["hit"] not in colors(draw(crash, 9))
    assert PAGE["hit"] not in colors(draw(replace(crash, violated=()), 10))


def test_the_decisive_frame():
    trace = meeting()
    assert decisive_frame(trace, []) == 5
    assert decisive_frame(trace, ["destination"]) == 10
    assert decisive_frame(trace, ["collision", "destination"]) == 10
    drifted = np.array(trace.position)
    drifted[3:, 0, 0] = 0.5  # over the double yellow line from frame 3 on
    assert decisive_frame(replace(trace, position=drifted), ["lines", "destination"]) == 3
    alone = make_trace(np.stack([np.zeros(4), np.arange(4.0), np.zeros(4)], axis=1))
    assert decisive_frame(alone, []) == 3


@pytest.mark.parametrize("frames", [1, 2, 7, 900])
def test_an_animation_shows_the_whole_trace(tmp_path, frames, monkeypatch):
    monkeypatch.setattr(drawing, "MAX_FRAMES", 30)
    trace = simulate(SCENARIO)
    trace = make_trace(
        np.column_stack([np.resize(trace.position[:, 0], (frames, 2)), np.zeros(frames)]), lines=ROADMAP.illegal_lines
    )
    save_animation(tmp_path / "a.gif", Footage(trace, ROAD, "caption"))
    with Image.open(tmp_path / "a.gif") as animation:
        assert 1 <= animation.n_frames <= 30
        if frames == 900:
            assert animation.n_frames == 30


def test_a_large_trace_takes_as_long_as_a_small_one():
    """Few of its vehicles and points are drawn, with the first and the last point of each path."""
    position = np.cumsum(np.ones((5000, 2)), axis=0)
    thinned = drawing._thinned(position, 100)
    assert len(thinned) <= 101
    assert (thinned[[0, -1]] == position[[0, -1]]).all()
    assert drawing._thinned(position, 5000) is position
    around = np.concatenate([np.zeros((1, 2)), np.arange(1000, 0, -1)[:, None] * np.ones(2)])
    assert drawing._nearest(around, np.ones(1001, bool)) == list(range(1000 - drawing.MOST_DRAWN + 1, 1001))
    long_road = RoadShape((), striped=(np.array([[0.0, 0.0], [3e6, 0.0]]),))
    footage = drawing.Footage(random_trace(0), long_road, "")
    assert drawing._most_pictures(footage) == drawing._ANIMATION_POINTS // (drawing._PATH_POINTS + long_road.n_points)
