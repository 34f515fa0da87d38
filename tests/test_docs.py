"""The documentation says what the code says."""

import ast
import importlib
import inspect
import json
import pkgutil
import re
import runpy
import shutil
from collections import Counter
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import behavexplor
from behavexplor.behavior.miner import MinerOptions
from behavexplor.behavior.novelty import NOVELTY_THRESHOLD
from behavexplor.bench.experiment_archive import ARCHIVE
from behavexplor.commands import OK, main
from behavexplor.envs.tasks.scripted_outcome import WEIGHTS
from behavexplor.execution.simulation import Simulation

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


def listed():
    """The names in the picture of CONTRIBUTING.md."""
    text = (ROOT / "CONTRIBUTING.md").read_text()
    block = text.partition("```\nbehavexplor/\n")[2].partition("```")[0]
    return [line.split()[0] for line in block.splitlines()]


def test_the_picture_of_the_house_is_the_listing():
    package = ROOT / "behavexplor"
    modules = [path.name for path in package.glob("*.py")]
    folders = [f"{path.name}/" for path in package.iterdir() if (path / "__init__.py").is_file()]
    assert sorted(listed()) == sorted([*modules, *folders])
    assert len(modules) <= 6


@pytest.mark.parametrize("room", ["envs", "ads"])
def test_the_picture_of_a_room_is_the_listing(room):
    block = (ROOT / "CONTRIBUTING.md").read_text().partition(f"```\n{room}/\n")[2].partition("```")[0]
    folder, named = "", []
    for line in block.splitlines():
        names = re.findall(r"\S+(?:\.py|/)(?= |$)", line)
        if line.startswith("  ") and not line.startswith("    "):
            folder = names[0] if names[0].endswith("/") else ""
        named += [folder + name for name in names if name.endswith(".py")]
    root = ROOT / "behavexplor" / room
    patterns = [path.relative_to(root).as_posix() for name in named for path in root.glob(name)]
    there = [path.relative_to(root).as_posix() for path in root.rglob("*.py") if path.stem != "__init__"]
    assert sorted(patterns) == sorted(there)


def test_the_way_of_a_scenario_is_at_most_twelve_files():
    way = re.findall(r"^\d+\. `([\w/]+\.py)`", (ROOT / "CONTRIBUTING.md").read_text(), re.MULTILINE)
    assert 0 < len(way) <= 12
    assert all((ROOT / "behavexplor" / path).is_file() for path in way)


def test_no_two_modules_have_one_name_but_for_their_role():
    paths = sorted((ROOT / "behavexplor").rglob("*.py"))
    names = Counter(path.stem for path in paths)
    folders = {path.parent.name for path in paths}
    assert {name for name, count in names.items() if count > 1} == {"__init__", "__main__"}
    same_role = {path.stem for path in paths if path.stem in folders and path.parent.name == "commands"}
    assert {name for name in names if name in folders} == {*same_role, "campaign", "behavexplor", "highway"}


@pytest.mark.parametrize("page", sorted(ROOT.glob("docs/*.md")), ids=lambda page: page.name)
def test_links_between_the_pages_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text()):
        assert (page.parent / target).exists(), f"{page.name} links to {target}"


@pytest.mark.parametrize("page", [*sorted(ROOT.glob("docs/*.md")), ROOT / "README.md", ROOT / "CONTRIBUTING.md"])
def test_modules_that_a_page_names_exist(page):
    for name in re.findall(r"`(behavexplor(?:\.\w+)+)", page.read_text()):
        parts = name.split(".")
        paths = [ROOT.joinpath(*parts[:i]) for i in range(2, len(parts) + 1)]
        found = [path for path in paths if path.is_dir() or path.with_suffix(".py").is_file()]
        assert found, f"{page.name} names {name}"
        assert len(parts) - len(found[-1].relative_to(ROOT).parts) <= 2, f"{page.name} names {name}"


@pytest.fixture(scope="module")
def behaviors():
    """What docs/behaviors.py executes and abstracts."""
    pytest.importorskip("matplotlib")
    made = runpy.run_path(str(ROOT / "docs" / "behaviors.py"))
    traces = made["executed"]()
    return made, traces, made["abstracted"](traces, MinerOptions())


def test_scenarios_a_b_and_c_are_a_slow_follow_a_normal_drive_and_a_bypass(behaviors):
    _, traces, _ = behaviors
    assert {trace.end for trace in traces.values()} == {"arrived"}
    aside = {name: float(np.ptp(trace.position[:, 0, 1])) for name, trace in traces.items()}
    speed = {name: float(np.median(np.hypot(*trace.velocity[:, 0].T))) for name, trace in traces.items()}
    assert aside["A"] < 0.5
    assert aside["B"] < 0.5
    assert 3.0 < aside["C"] < 4.0  # a lane
    assert speed["A"] == pytest.approx(4.0, abs=0.2)  # of the vehicle ahead
    assert speed["B"] == pytest.approx(speed["C"], abs=0.1)
    assert abs(traces["B"].duration - traces["C"].duration) < 1.0


def test_the_distances_of_scenarios_a_b_and_c_are_those_that_the_page_says(behaviors):
    """All are beyond the threshold, and without scaling a bypass cannot be told from a normal drive."""
    made, traces, found = behaviors
    page = (ROOT / "docs" / "method.md").read_text()
    for a, b in made["PAIRS"]:
        assert found.distances[a + b] > NOVELTY_THRESHOLD
        assert f"| {a} and {b} | {found.distances[a + b]:.2f} |" in page
    assert made["abstracted"](traces, MinerOptions(scaling="none")).distances["BC"] < 0.01
    assert len(made["figure"](traces, found).axes) == 3


def test_the_aimed_vehicle_of_the_figure_meets_the_recorded_ego():
    pytest.importorskip("matplotlib")
    made = runpy.run_path(str(ROOT / "docs" / "encounters.py"))
    simulation = Simulation(made["ENV"], made["ADS"])
    found = made["aimed"](simulation)
    simulation.close()
    least = found.distances.min(axis=1)
    assert least[found.chosen] < found.reach
    assert sum(least > found.reach) > len(least) / 2  # most drawn vehicles miss
    assert len(made["figure"](found, {}).axes) == 3


@pytest.mark.parametrize(
    "script", sorted([*ROOT.glob("docs/*.py"), *ROOT.glob("benchmarks/*.py")]), ids=lambda path: path.stem
)
def test_what_a_script_imports_exists(script):
    """Most scripts take too long to be run by a test."""
    for statement in ast.walk(ast.parse(script.read_text())):
        if isinstance(statement, ast.ImportFrom) and str(statement.module).startswith(("behavexplor", "benchmarks")):
            module = importlib.import_module(statement.module)
            modules = {one.name for one in pkgutil.iter_modules(getattr(module, "__path__", []))}
            missing = [one.name for one in statement.names if not hasattr(module, one.name)]
            missing = [name for name in missing if name not in modules]
            assert not missing, f"{statement.module} has no {missing}"


def test_tables_are_put_into_their_places(tmp_path):
    folder = tmp_path / "paper"
    (folder / "tables").mkdir(parents=True)
    (folder / "tables" / "times.md").write_text("**Times**\n\n| new |\n\nQuestion: how long?\n")
    filled = runpy.run_path(str(ROOT / "docs" / "results.py"))["filled"]
    names = ("paper/times", "paper/not-there", "windows/times")
    page = "".join(f"text\n<!-- table: {name} -->\nold\n<!-- end -->\n" for name in names)
    expected = page.replace("old", "\n**Times**\n\n| new |\n", 1)
    assert filled(page, folder) == expected
    assert filled(expected, folder) == expected


def without_versions(page):
    """Leave out the versions of libraries that a page says it was made with."""
    return re.sub(rb"with behavexplor [^<]*? This ", b"", page)


@pytest.mark.parametrize(
    ("name", "experiment"),
    [
        ("paper", "paper"),
        ("windows", "windows"),
        ("trained-policies", "policies"),
        ("default-planner", "default-planner"),
        ("deviations", "docs/data/deviations.yaml"),
        ("encounters-options", "docs/data/encounters-options.yaml"),
        ("encounters-changing-share", "docs/data/encounters-changing-share.yaml"),
        ("highway-default", "docs/data/policies/highway-default.yaml"),
        ("highway-wide", "docs/data/policies/highway-wide.yaml"),
    ],
)
def test_the_figures_of_an_experiment_are_those_of_its_archive(tmp_path, name, experiment):
    """If this fails, run the experiment's tables, and then python docs/results.py FOLDER."""
    kept = ROOT / "docs" / "data" / name
    folder = tmp_path / name
    folder.mkdir()
    for file in ("experiment.yaml", ARCHIVE):
        shutil.copy(kept / file, folder / file)
    assert main(["bench", experiment, "--out", str(folder), "--tables-only", "--quiet"]) == OK
    for path in kept.iterdir():
        if path.name == ARCHIVE:  # its bytes depend on the version of zlib
            continue
        assert without_versions((folder / path.name).read_bytes()) == without_versions(path.read_bytes()), path.name
    page = (ROOT / "docs" / "results.md").read_text()
    assert runpy.run_path(str(ROOT / "docs" / "results.py"))["filled"](page, folder) == page


def test_the_tables_of_speed_are_those_that_were_measured():
    """If this fails, run python docs/performance.py."""
    made = runpy.run_path(str(ROOT / "docs" / "performance.py"))
    measured = json.loads(made["FIGURES"].read_text())
    pages = [path.read_text() for path in made["PAGES"]]
    assert measured.keys() == made["COLUMNS"].keys()
    places = {found[1] for page in pages for found in made["PLACE"].finditer(page)}
    assert places == {*measured, made["GOALS"]}
    for page in pages:
        assert made["filled"](page, measured) == page


def test_the_tables_of_retrainings_are_those_of_their_lines():
    """If this fails, run python docs/retraining_tables.py."""
    made = runpy.run_path(str(ROOT / "docs" / "retraining_tables.py"))
    lines = [json.loads(line) for line in made["LINES"].read_text().splitlines()]
    page = made["PAGE"].read_text()
    assert {found[1] for found in made["PLACE"].finditer(page)} == set(made["TABLES"])
    assert made["filled"](page, lines) == page


def test_the_tables_that_the_results_name_are_in_their_files():
    page = (ROOT / "docs" / "results.md").read_text()
    named = re.findall(r"^In \[tables.txt\]\((\S+)\): (.*?)\.\n\n", page, re.DOTALL | re.MULTILINE)
    assert len(named) >= 10
    for path, titles in named:
        lines = (ROOT / "docs" / path).read_text().splitlines()
        for title in re.findall(r"\*(.+?)\*", " ".join(titles.split())):
            assert title in lines, f"{path} has no table {title!r}"


def test_the_results_begin_with_what_a_user_may_take_from_them():
    page = (ROOT / "docs" / "results.md").read_text()
    first, second = page.split("\n## ")[1:3]
    assert first.startswith("What a user may take from it")
    assert len(first.split()) <= 300
    assert second.startswith("The paper's experiment")
