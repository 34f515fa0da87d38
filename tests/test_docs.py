"""The documentation says what the code says."""

import runpy
from pathlib import Path

import pytest

import behavexplor
from behavexplor.envs.reward import WEIGHTS

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
