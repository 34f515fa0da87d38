import pytest

from behavexplor.commands.early_imports import begin_imports
from behavexplor.data.target import Target
from behavexplor.execution.evaluator import evaluator_recipe


@pytest.fixture
def begun(monkeypatch):
    imports = []
    monkeypatch.setattr("behavexplor.commands.early_imports.share_imports", imports.append)
    return imports


@pytest.mark.parametrize(
    ("arguments", "target"),
    [
        (["fuzz"], Target("intersection-straight", "rule")),
        (["fuzz", "--budget", "9", "--env=lane-change"], Target("lane-change", "rule")),
        (["fuzz", "--ads", "model.zip", "--env", "highway-fast-v0"], Target("highway-fast-v0", "model.zip")),
        (["fuzz", "--env"], Target("", "rule")),
    ],
)
def test_what_the_workers_will_need_is_imported_early(begun, arguments, target):
    begin_imports(arguments)
    assert begun == [evaluator_recipe(target).preload]


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["records", "run"],
        ["fuzz", "--help"],
        ["fuzz", "--workers", "0"],
        ["fuzz", "--workers=0"],
        ["fuzz", "--resume", "run"],
        ["fuzz", "--cluster", "dask"],
    ],
)
def test_nothing_is_imported_without_workers_or_without_a_known_target(begun, arguments):
    begin_imports(arguments)
    assert begun == []
