"""The documentation says what the code says."""

import inspect
import runpy
from pathlib import Path

import gymnasium
import pytest

import behavexplor
from behavexplor.envs.reward import WEIGHTS

NAMES = ("intersection-straight", "intersection-left", "lane-follow", "lane-change")
ROOT = Path(__file__).parent.parent
BUILD = runpy.run_path(str(ROOT / "docs" / "build.py"))


@pytest.mark.parametrize("name", behavexplor.FUNCTIONAL_SCENARIOS)
def test_the_page_of_an_environment_is_made_from_its_docstring(name):
    """If this fails, run python docs/build.py."""
    page = ROOT / "docs" / "environments" / f"{name}.md"
    assert page.read_text() == BUILD["page"](name)
    assert page.with_suffix(".png").exists()


def test_every_weight_of_the_reward_is_in_the_pages():
    text = BUILD["page"]("lane-follow")
    for name, weight in WEIGHTS.items():
        assert f"| {name} | {weight:g} |" in text


def test_a_page_says_where_the_ego_goes_and_who_drives_there():
    ways = {name: BUILD["way"](gymnasium.make(f"behavexplor/{name}-v0").unwrapped.logical.roadmap) for name in NAMES}
    assert ways == {
        "intersection-straight": "160 m",
        "intersection-left": "166 m, with a turn to the left of 16.75 m radius",
        "lane-follow": "220 m",
        "lane-change": "220 m, with a change of 2 lanes to the right",
    }
    page = BUILD["page"]("lane-change")
    for row in ("| NPCs | 6, each on one of 4 routes |", "| waypoints | 4 on each of a route's 2 lanes |"):
        assert row in page
    assert "| illegal lines | double yellow lines and curb lines |" in page


def test_no_environment_repeats_what_all_share():
    """What a scenario's own docstring says is in no other's, but for the headings."""
    lines = [
        line
        for name in NAMES
        for line in inspect.cleandoc(type(gymnasium.make(f"behavexplor/{name}-v0").unwrapped).__doc__).splitlines()
    ]
    repeated = {line for line in lines if lines.count(line) > 1}
    assert repeated == {"", "## Version history", "- v0: first version."}
