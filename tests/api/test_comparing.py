"""Comparison of two drivers from Python: the records are those of the command."""

import pytest

import behavexplor
from behavexplor.commands import OK, main
from behavexplor.errors import InputError
from behavexplor.repair.pairs import COLUMNS
from tests.drivers import Cruiser, Swerver


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compare") / "out"
    return behavexplor.compare(Swerver(), Cruiser(), "intersection-straight", scenarios=8, seed=5, out=folder)


def lines(run):
    return [record.to_json() for record in run.records]


def test_the_records_are_those_of_the_command(compared, tmp_path):
    arguments = ["compare", "tests.drivers:Swerver", "tests.drivers:Cruiser", "--scenarios", "8", "--seed", "5"]
    assert main([*arguments, "--workers", "0", "--unconfined", "--quiet", "--out", str(tmp_path / "a")]) == OK
    command = behavexplor.Comparison(tmp_path / "a")
    assert lines(compared.first) == lines(command.first)
    assert lines(compared.second) == lines(command.second)
    assert compared.pairs == command.pairs


@pytest.mark.parametrize(("name", "value"), [("scenarios", 0), ("margin", 7), ("margin", 0.0)])
def test_numbers_of_a_comparison_that_mean_nothing_are_refused(tmp_path, name, value):
    with pytest.raises(InputError, match=r"at least 1 scenario|must lie between 0 and 1"):
        behavexplor.compare(Swerver(), Cruiser(), "intersection-straight", out=tmp_path / "a", **{name: value})
    assert not (tmp_path / "a").exists()


def test_the_scenarios_of_a_comparison_are_always_drawn_uniformly(tmp_path):
    for settings in ({"method": "nsga2"}, {"budget": "9"}):
        with pytest.raises(InputError, match=f"so {next(iter(settings))} cannot be chosen"):
            behavexplor.compare(Swerver(), Cruiser(), "intersection-straight", out=tmp_path, **settings)


def test_the_table_counts_what_was_fixed_and_broken(compared):
    first, second = (
        {record.id for record in run.records if record.at_fault} for run in (compared.first, compared.second)
    )
    assert set(compared.fixed) == first - second != set()
    assert set(compared.broken) == second - first
    row = compared.to_pandas().loc["failure at fault"]
    assert (row.fixed, row.broken, row.both) == (len(first - second), len(second - first), len(first & second))
    assert row["first"] == len(first) / 8
    assert row.low <= row.change <= row.high
    assert 0 < row.p <= 1


def test_a_comparison_shows_itself_and_writes_a_page(compared, tmp_path):
    assert f"8 scenarios, {len(compared.fixed)} fixed" in repr(compared)
    html = compared._repr_html_()
    assert all(f"<th>{name}</th>" in html for name in COLUMNS)
    assert "A is in-memory:Swerver, B is in-memory:Cruiser" in html
    assert "A: in-memory:Swerver and B: in-memory:Cruiser in the same scenarios" in compared.report().read_text()
    assert compared.report(tmp_path / "a.html", replays=0).is_file()
    with pytest.raises(behavexplor.InputError, match="cannot be written"):
        compared.report(tmp_path / "nowhere" / "a.html")


def test_its_runs_can_execute_their_drivers_again(compared):
    assert compared.first.repeat(0).reproduced
    assert compared.second.repeat(0).reproduced


def test_ctrl_c_ends_a_comparison(tmp_path):
    def interrupt(progress):
        raise behavexplor.Interrupted(tmp_path)

    with pytest.raises(KeyboardInterrupt, match="is not complete"):
        behavexplor.compare(Cruiser(), Swerver(), scenarios=4, out=tmp_path / "a", progress=interrupt)


def test_a_folder_of_something_else_is_refused(tmp_path):
    with pytest.raises(behavexplor.InputError, match="is not a run folder"):
        behavexplor.Comparison(tmp_path)


@pytest.mark.filterwarnings("ignore:The driver always")
def test_a_comparison_with_a_margin_ends_when_it_is_decided(tmp_path):
    found = behavexplor.compare(
        "constant:IDLE",
        "constant:FASTER",
        "two-way-v0",
        scenarios=400,
        margin=0.9,
        workers=0,
        out=tmp_path,
        confirm=False,
    )
    assert found.decision(0.9).found == "non-inferior"
    with pytest.raises(InputError, match="The margin 5 must lie between 0 and 1"):
        found.decision(5)
    assert found.pairs[0].n == 250
