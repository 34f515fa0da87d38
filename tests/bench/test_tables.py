"""Summaries, tables and curves of a few campaigns that are made up, so that every figure can be said in advance."""

import csv
import io
import math
from xml.etree import ElementTree

import pytest

from behavexplor.bench.curves import curves, curves_csv, curves_svg
from behavexplor.bench.experiment import experiment_config
from behavexplor.bench.statistics import Estimate
from behavexplor.bench.summaries import Failure, Summary, correlation, summaries_csv
from behavexplor.bench.tables import Column, Table, tables
from behavexplor.bench.writing import escaped, marked, table_csv, table_latex
from behavexplor.commands.terminal_tables import text

ENVS = ("lane-follow", "lane-change")
EXPERIMENT = experiment_config(
    {
        "name": "made-up",
        "envs": list(ENVS),
        "methods": {name: {"method": "uniform"} for name in ("Search", "w/o it", "Uniform_1")},
        "seeds": 3,
        "budget": 100,
        "baseline": "Uniform_1",
        "groups": {"ablation": ["Search", "w/o it"]},
    }
)


def failures(*labels, kinds=None, signatures=None):
    """Failures at every fifth execution; of the collisions, the first is an NPC's."""
    kinds, signatures = (values or [None] * len(labels) for values in (kinds, signatures))
    return tuple(
        Failure(5 * i, label, label == "R1" and i == 0, kind, signature)
        for i, (label, kind, signature) in enumerate(zip(labels, kinds, signatures, strict=True))
    )


def campaign(method, seed, labels, env="lane-follow", kinds=None, r=None, signatures=None):
    found = failures(*labels, kinds=kinds, signatures=signatures)
    return Summary(env, "rule", method, seed, 100, found, 0.2, 8.0, 2.0, r, None if r is None else 10.0**-seed)


SUMMARIES = [
    campaign("Search", 1, ["R1", "R1", "R2"], r=-0.2),
    campaign("Search", 2, ["R1", "R3", "R3", "R3", "R3"], r=-0.3),
    campaign("Search", 3, ["R2", "R2", "R2", "R2"], r=-0.1),
    campaign("w/o it", 1, ["R1"]),
    campaign("w/o it", 2, []),
    campaign("Uniform_1", 1, ["R3", "R3", "R3"]),
    campaign("Search", 1, ["R2"], env="lane-change", r=-0.5),
]
CLASSIFIED = [
    campaign("Search", 1, ["R1", "R1", "R2"], kinds=["R1-a", "R1-a", "R2-a"]),
    campaign("Search", 2, ["R1", "R3"], kinds=["R1-b", "R3-a"]),
    campaign("w/o it", 1, ["R1"], kinds=["R1-a"]),
]


SIGNED = [
    campaign("Search", 1, ["R1", "R1", "R2"], signatures=["environment", "R1-8", "R2-2"]),
    campaign("Search", 2, ["R1", "R1", "R1"], signatures=["R1-8", "R1-8", "R1-2"]),
    campaign("w/o it", 1, ["R2", "R3"], signatures=["R2-2", "unexplained"]),
    campaign("Uniform_1", 1, []),
]


def made(name, summaries=SUMMARIES):
    return next(table for table in tables(EXPERIMENT, summaries) if table.name == name)


def column(table, name):
    index = [column.name for column in table.columns].index(name)
    return [row[index] for row in table.rows]


def test_violations_are_means_of_what_was_found_first():
    table = made("violations")
    assert column(table, "Scenario") == ["lane-follow"] * 3 + ["lane-change"]
    assert column(table, "Method") == ["Search", "w/o it", "Uniform_1", "Search"]
    assert column(table, "n") == [3, 2, 1, 1]
    means = {name: column(table, name)[0].mean for name in ("R1", "R2", "R3", "Sum", "R1 by NPC", "Novel %")}
    assert means == pytest.approx({"R1": 1, "R2": 5 / 3, "R3": 4 / 3, "Sum": 4, "R1 by NPC": 2 / 3, "Novel %": 20})
    half = 4.3026527 / math.sqrt(3)  # of 3, 5 and 4; Student's t of two degrees of freedom
    assert (column(table, "Sum")[0].low, column(table, "Sum")[0].high) == pytest.approx((4 - half, 4 + half))
    assert table.blocks == (3, 1)
    assert not [head.name for head in table.columns if "Unique" in head.name]


def test_a_group_has_a_table_of_its_methods():
    assert set(column(made("violations-ablation"), "Method")) == {"Search", "w/o it"}


def test_errors_have_a_column_only_where_there_are_any():
    assert "error" not in [head.name for head in made("violations").columns]
    erring = [*SUMMARIES, campaign("w/o it", 3, ["error"])]
    assert column(made("violations", erring), "error")[1].mean == pytest.approx(1 / 3)


def test_unique_violations_are_classes_and_only_where_all_are_known():
    table = made("violations", CLASSIFIED)
    assert [column(table, f"Unique {name}")[0].mean for name in ("R1", "R2", "R3", "sum")] == [1, 0.5, 0.5, 2]
    half_known = [*CLASSIFIED, campaign("w/o it", 2, ["R1"])]
    assert "Unique sum" not in [head.name for head in made("violations", half_known).columns]
    assert "distinct" not in [table.name for table in tables(EXPERIMENT, half_known)]


def test_distinct_violations_are_the_classes_of_all_campaigns_together():
    table = made("distinct", CLASSIFIED)
    assert table.rows[0] == ("Search", 2, 2, 1, 1, 4, "R1-a, R1-b, R2-a, R3-a")
    assert table.rows[1] == ("w/o it", 1, 1, 0, 0, 1, "R1-a")


def test_weaknesses_are_counted_by_campaign_and_what_is_none_is_left_out():
    table = made("weaknesses", SIGNED)
    assert [head.name for head in table.columns] == ["Method", "Campaigns", "R1-2", "R1-8", "R2-2", "Distinct"]
    assert table.rows == (("Search", 2, 1, 2, 1, 3), ("w/o it", 1, 0, 0, 1, 1), ("Uniform_1", 1, 0, 0, 0, 0))
    assert [mean.mean for mean in column(made("violations", SIGNED), "Weaknesses")] == [2, 1, 0]
    assert column(made("weaknesses-search", SIGNED), "Mean against") == [1, 0]
    assert SIGNED[0].weaknesses("R1") == {"R1-8"}


def test_weaknesses_are_told_only_where_every_failure_has_a_signature():
    half_known = [*SIGNED, campaign("w/o it", 2, ["R1"])]
    unexplained = [campaign("Search", 1, ["R1"], signatures=["unexplained"])]
    for summaries in (SUMMARIES, half_known, unexplained):
        assert not {"weaknesses", "weaknesses-search"} & {table.name for table in tables(EXPERIMENT, summaries)}
        assert "Weaknesses" not in [head.name for head in made("violations", summaries).columns]


def test_times_are_split():
    (search, *_) = made("times").rows
    assert search[:2] == ("Search", 4)
    assert (search[2].mean, search[3].mean) == (8.0, 2.0)
    assert search[4:] == pytest.approx((20.0, 10.0))


def test_unmeasured_campaigns_have_no_time():
    lost = Summary("lane-follow", "rule", "Search", 1, 100, (), 0.2, math.nan, math.nan)
    assert made("times", [lost]).rows == ()
    assert "nan" not in text(made("times", [lost])) + summaries_csv([lost])


def test_correlations_are_of_the_methods_that_have_one():
    table = made("correlations")
    assert column(table, "Method") == ["Search", "Search"]
    assert column(table, "r_BF")[0].mean == pytest.approx(-0.2)
    assert column(table, "p < 0.001") == ["0 of 3", "0 of 1"]


def test_a_correlation_is_pearsons():
    r, p = correlation([(1, 2), (2, 1), (3, 4), (4, 3)])
    assert r == pytest.approx(0.6)
    assert p == pytest.approx(0.4)
    assert correlation([(1, 2), (2, 2), (3, 2)]) == (None, None)
    assert correlation([(1, 2), (2, 3)]) == (None, None)
    assert correlation([]) == (None, None)


def test_comparisons_are_of_the_reference_and_of_the_baseline():
    against_reference, against_baseline = made("failures-search"), made("failures-uniform_1")
    assert [row[:5] for row in against_reference.rows] == [
        ("lane-follow", "Search", "w/o it", 3, 2),
        ("lane-follow", "Search", "Uniform_1", 3, 1),
    ]
    assert column(against_reference, "A12") == [1.0, (1 + 1 + 0.5) / 3]
    assert column(against_reference, "p") == ["0.200", "1.000"]
    assert column(against_reference, "p Holm") == ["0.400", "1.000"]
    assert set(column(against_reference, "Verdict")) == {"not distinguishable"}
    assert "the least corrected p is 0.400" in against_reference.notes[-1]
    assert [row[1:3] for row in against_baseline.rows] == [("Search", "Uniform_1"), ("w/o it", "Uniform_1")]


def test_enough_seeds_tell_methods_apart():
    runs = [campaign(name, i, ["R1"] * n) for name, n in (("Search", 9), ("w/o it", 4)) for i in range(8)]
    runs = [campaign(run.method, run.seed, ["R1"] * (run.total() + run.seed // 2)) for run in runs]
    table = made("failures-search", runs)
    assert column(table, "Verdict") == ["more, large"]
    assert not [note for note in table.notes if "So few seeds" in note]


def test_the_best_of_a_block_is_marked_also_where_two_look_alike():
    def estimate(mean):
        return Estimate(2, mean, mean - 1, mean + 1)

    rows = (("a", estimate(3.04)), ("b", estimate(3.01)), ("c", estimate(1)), ("d", estimate(5)), ("e", estimate(5)))
    table = Table("t", "T", (Column("Method"), Column("Sum", best=True, interval=True)), rows, (3, 2))
    assert marked(table) == {(0, 1), (1, 1)}
    assert "3.0 [2.0, 4.0]*" in text(table)
    assert r"a & \textbf{3.0 [2.0, 4.0]} \\" in table_latex(table)
    assert r"d & 5.0 [4.0, 6.0] \\" in table_latex(table)
    assert table_latex(table).count(r"\midrule") == 2


@pytest.mark.parametrize(
    ("plain", "latex"),
    [
        ("w/o BG_1", r"w/o BG\_1"),
        ("50 % & more", r"50 \% \& more"),
        ("p < 0.001", r"p \textless{} 0.001"),
        ("#{x}$", r"\#\{x\}\$"),
        ("a\\b~c^d", r"a\textbackslash{}b\textasciitilde{}c\textasciicircum{}d"),
    ],
)
def test_latex_is_escaped(plain, latex):
    assert escaped(plain) == latex


def test_a_latex_table_escapes_names_and_says_what_it_is():
    lines = table_latex(made("violations")).splitlines()
    assert lines[0] == r"\begin{table}"
    assert r"    \toprule" in lines
    assert r"Scenario & Method & n & R1 & R2 & R3 & Sum & R1 by NPC & Novel \% \\" in lines[6]
    assert [line for line in lines if r"Uniform\_1 & 1 & 0.0" in line]
    assert r"\label{tab:violations}" in lines[3]


def test_a_csv_table_has_every_digit_and_the_interval():
    rows = list(csv.DictReader(io.StringIO(table_csv(made("violations")))))
    assert rows[0]["R2 mean"] == "1.666667"
    assert rows[0]["Sum n"] == "3"
    assert float(rows[0]["Sum low"]) < 4 < float(rows[0]["Sum high"])
    assert rows[2]["Sum low"] == ""
    assert rows[0]["Method"] == "Search"


def test_a_summary_is_a_row():
    rows = list(csv.DictReader(io.StringIO(summaries_csv(SUMMARIES))))
    assert len(rows) == len(SUMMARIES)
    expected = {
        "env": "lane-follow",
        "method": "Search",
        "seed": "1",
        "failed": "3",
        "failed_R1": "2",
        "failed_R2": "1",
    }
    assert expected.items() <= rows[0].items()
    assert (rows[0]["R1_npc_caused"], rows[0]["R1_other"]) == ("1", "1")
    assert (rows[0]["r_BF"], rows[0]["executing_s"]) == ("-0.2", "8.0")
    assert "unique" not in rows[0]
    classified = list(csv.DictReader(io.StringIO(summaries_csv(CLASSIFIED))))
    assert (classified[0]["unique"], classified[0]["unique_R1"], classified[0]["classes"]) == ("2", "1", "R1-a R2-a")
    assert "weaknesses" not in classified[0]
    signed = list(csv.DictReader(io.StringIO(summaries_csv(SIGNED))))
    assert [(row["weaknesses"], row["signatures"]) for row in signed[:2]] == [("2", "R1-8 R2-2"), ("2", "R1-2 R1-8")]


def test_curves_rise_with_the_failures():
    (curve, *_) = curves(EXPERIMENT, SUMMARIES)
    found = dict(zip(curve.executions, (point.mean for point in curve.found), strict=True))
    assert (curve.method, curve.figure) == ("Search", "failures")
    assert found[2] == 1.0  # every campaign fails first in execution 0
    assert found[6] == 2.0
    assert found[100] == 4.0
    assert max(curve.executions) == 100
    rows = list(csv.DictReader(io.StringIO(curves_csv([curve]))))
    assert (rows[-1]["executions"], rows[-1]["mean"], rows[-1]["n"]) == ("100", "4.0", "3")


def test_curves_of_unique_violations_count_a_class_once():
    by_figure = {curve.figure: curve for curve in curves(EXPERIMENT, CLASSIFIED[:1])}
    assert by_figure["failures"].found[-1].mean == 3
    assert by_figure["unique violations"].found[-1].mean == 2


def test_the_figure_is_the_same_file_again_and_has_every_curve():
    pytest.importorskip("matplotlib")
    drawn = curves(EXPERIMENT, CLASSIFIED)
    figure = curves_svg(drawn)
    assert figure == curves_svg(drawn)
    words = {element.text for element in ElementTree.fromstring(figure).iter() if element.text}
    assert {"lane-follow", "executions", "unique violations", "Search", "w/o it"} <= words
