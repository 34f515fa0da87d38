"""Summaries, tables and curves of a few campaigns that are made up, so that every figure can be said in advance."""

import csv
import io
import math
from dataclasses import replace

import pytest
from scipy.stats import pearsonr

from behavexplor.bench.comparisons import curves, curves_csv, headline
from behavexplor.bench.experiment import experiment_config
from behavexplor.bench.statistics import Estimate
from behavexplor.bench.summaries import Failure, Mutant, Summary, correlation, summaries_csv
from behavexplor.bench.table import Column, Table, marked, table_csv, table_markdown
from behavexplor.bench.tables import tables
from behavexplor.commands.plain_tables import text

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
    """Failures at every fifth execution, by default each of its own class; of the collisions, the first is an NPC's."""
    kinds = kinds or [f"{label}-{i}" for i, label in enumerate(labels)]
    signatures = signatures or [None] * len(labels)
    return tuple(
        Failure(5 * i, label, label == "R1" and i == 0, kind, signature)
        for i, (label, kind, signature) in enumerate(zip(labels, kinds, signatures, strict=True))
    )


def campaign(method, seed, labels, env="lane-follow", kinds=None, mutants=(), signatures=None):
    found = failures(*labels, kinds=kinds, signatures=signatures)
    return Summary(env, "rule", method, seed, 100, found, 0.2, 8.0, 2.0, mutants=tuple(mutants))


def line(degree, distance):
    """Four mutants whose distances fall as their degrees rise."""
    return [Mutant(float(degree + i), distance - 0.1 * i, False) for i in range(4)]


SUMMARIES = [
    campaign("Search", 1, ["R1", "R1", "R2"], mutants=line(1, 0.9)),
    campaign("Search", 2, ["R1", "R3", "R3", "R3", "R3"], mutants=line(1, 0.9)),
    campaign("Search", 3, ["R2", "R2", "R2", "R2"], mutants=line(1, 0.9)),
    campaign("w/o it", 1, ["R1"]),
    campaign("w/o it", 2, []),
    campaign("Uniform_1", 1, ["R3", "R3", "R3"]),
    campaign("Search", 1, ["R2"], env="lane-change", mutants=line(1, 0.9)),
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


def test_forecasts_stand_beside_what_was_found_later():
    kinds = {0: "a", 1: "b", 2: "b", 99: "c", 104: "d", 900: "e", 901: "a"}
    found = tuple(Failure(number, "R3", False, kind) for number, kind in kinds.items())
    whole = Summary("lane-follow", "rule", "Search", 1, 1000, found, 0.2, 8.0, 2.0)
    table = made("forecasts", [whole])
    (row,) = table.rows
    values = dict(zip([column.name for column in table.columns], row, strict=True))
    assert (values["After"].mean, values["Classes"].mean, values["Total, found"].mean) == (100, 3, 5)
    assert (values["Chance %"].mean, values["Then new %"].mean) == (2, 10)  # a and c were seen once; d is new
    assert values["Total, forecast"].mean == pytest.approx(3 + 0.99 * 2 * 1 / (2 * 2))
    assert values["Within"] == 1
    names = [table.name for table in tables(EXPERIMENT, [whole])]
    assert "forecasts-pooled" not in names  # of a single campaign
    assert "forecasts" not in [table.name for table in tables(EXPERIMENT, CLASSIFIED)]  # too short


def test_forecasts_of_one_campaign_stand_beside_what_all_found():
    first = campaign("Search", 1, ["R3"] * 4, kinds=["a", "a", "b", "c"])
    second = campaign("Search", 2, ["R3"] * 4, kinds=["d", "e", "a", "a"])  # the first two in the first ten
    table = made("forecasts-pooled", [first, second])
    (row,) = table.rows
    values = dict(zip([column.name for column in table.columns], row, strict=True))
    assert values["n"] == 2
    assert (values["After"].mean, values["Classes"].mean, values["Total, found"].mean) == (100, 3, 5)
    assert values["Chance %"].mean == 2
    assert values["Then new %"].mean == (100 * 2 / 10 + 0) / 2  # the first campaign begins with what the second has
    assert values["Within"] == 2


def test_an_overview_has_a_row_for_each_method_and_a_column_for_each_scenario():
    table = made("overview-at-fault")
    assert [column.name for column in table.columns] == ["Method", *ENVS]
    assert [row[0] for row in table.rows] == ["Search", "w/o it", "Uniform_1"]
    search, without, _ = table.rows
    assert search[1].mean == (2 + 4 + 4) / 3  # the first collisions are an NPC's
    assert without[2] is None
    assert "0 to 3 campaigns" in table.notes[1]
    collisions = made("overview-npc-caused")
    assert collisions.rows[0][1].mean == 2 / 3


def test_effect_sizes_of_all_figures_are_those_of_the_comparisons():
    table = made("effects-search", CLASSIFIED)
    (row,) = table.rows
    assert row[0] == "w/o it"
    sizes = [column(made(f"{key}-search", CLASSIFIED), "A12")[0] for key in ("at-fault", "at-fault-classes", "unique")]
    assert row[1].split(" / ")[:3] == [f"{size:.2f}" for size in sizes]
    assert row[2] == ""  # nothing was run there


def test_scenarios_are_compared_together():
    runs = [
        campaign(method, seed, ["R2"] * count, env=env)
        for env in ENVS
        for method, counts in (("Search", (5, 6, 7)), ("w/o it", (2, 3, 5)), ("Uniform_1", (5, 6, 7)))
        for seed, count in enumerate(counts)
    ]
    table = made("together-search", runs)
    assert column(table, "Against") == ["w/o it", "Uniform_1"]
    assert [cell.rstrip("*") for cell in column(table, "failures")] == [f"{8.5 / 9:.2f}", "0.50"]
    assert column(table, "p Holm: failures")[1] == 1
    assert column(table, "failures")[0].endswith("*") == (column(table, "p Holm: failures")[0] < 0.05)
    alone = replace(EXPERIMENT, ads={ENVS[0]: ("rule",)})
    assert not [found.name for found in tables(alone, runs) if "together" in found.name]


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


def test_a_group_has_a_table_of_its_methods():
    assert set(column(made("violations-ablation"), "Method")) == {"Search", "w/o it"}


def test_errors_have_a_column_only_where_there_are_any():
    assert "error" not in [head.name for head in made("violations").columns]
    erring = [*SUMMARIES, campaign("w/o it", 3, ["error"])]
    assert column(made("violations", erring), "error")[1].mean == pytest.approx(1 / 3)


def test_unique_violations_are_classes():
    table = made("violations", CLASSIFIED)
    assert [column(table, f"Unique {name}")[0].mean for name in ("R1", "R2", "R3", "sum")] == [1, 0.5, 0.5, 2]


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
    assert SIGNED[0].weaknesses() == {"R1-8", "R2-2"}


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
    found = tables(EXPERIMENT, [lost])
    assert "times" not in [table.name for table in found]
    assert "nan" not in "".join(map(text, found)) + summaries_csv([lost])


def test_correlations_are_of_the_methods_that_have_one():
    table = made("correlations")
    assert column(table, "Method") == ["Search", "Search"]
    assert column(table, "n") == [3, 1]
    assert "correlations" not in [found.name for found in tables(EXPERIMENT, SUMMARIES[3:6])]


def test_correlations_are_pooled_over_the_campaigns_of_a_scenario_with_one_p():
    """Each campaign alone falls, and both together rise."""
    together = [campaign("Search", seed, [], mutants=line(4 * seed, seed)) for seed in (1, 2)]
    table = made("correlations", together)
    assert column(table, "Mutants") == [8]
    assert column(table, "of a campaign")[0].mean == pytest.approx(-1)
    pooled = pearsonr([4, 5, 6, 7, 8, 9, 10, 11], [1, 0.9, 0.8, 0.7, 2, 1.9, 1.8, 1.7])
    assert column(table, "r_BF") == [pytest.approx(pooled.statistic)]
    assert column(table, "p") == [f"{pooled.pvalue:.3f}"]


def test_correlations_of_passed_mutants_alone():
    """Failing mutants that are far and low make a correlation which the others do not have."""
    passed, failing = [Mutant(d, 0.3 + 0.1 * (-1) ** d, False) for d in range(4)], [Mutant(-9.0, 1.0, True)] * 4
    table = made("correlations", [campaign("Search", 1, [], mutants=(*passed, *failing))])
    assert column(table, "r_BF")[0] < -0.9
    assert column(table, "r_BF passed") == [correlation(passed).r]
    assert correlation(passed).r > -0.5
    assert column(table, "Passed") == [4]
    failed_alone = made("correlations", [campaign("Search", 1, [], mutants=(*failing, Mutant(1.0, 0.1, True)))])
    assert column(failed_alone, "r_BF passed") == [None]
    assert "None" not in text(failed_alone)


def test_a_correlation_is_pearsons():
    def found(pairs):
        return correlation([Mutant(degree, distance, False) for degree, distance in pairs])

    assert found([(1, 2), (2, 1), (3, 4), (4, 3)]) == pytest.approx((4, 0.6, 0.4))
    assert found([(1, 2), (2, 2), (3, 2)]) is found([(1, 2), (2, 3)]) is found([]) is None


def test_mutations_are_shares_of_methods_that_make_them():
    """Methods with mutations of their own kind, such as uniform sampling, have no row."""
    runs = [
        replace(campaign("Search", 1, []), mutations=(90, 10), assignments=7),
        replace(campaign("Search", 2, []), mutations=(70, 30), assignments=9),
        campaign("Uniform_1", 1, []),
    ]
    table = made("mutations", runs)
    assert [row[:3] for row in table.rows] == [("lane-follow", "Search", 2)]
    assert column(table, "Waypoint mutations %")[0].mean == pytest.approx(80)
    assert column(table, "Assignments")[0].mean == pytest.approx(8)
    assert "mutations" not in [found.name for found in tables(EXPERIMENT, SUMMARIES)]


def test_in_equal_time_a_method_with_long_runs_has_fewer_executions():
    """100 executions of 1 s with 2 s of analysis against 100 of 4 s: after 102 s the latter have had 25.4 of them."""
    short = replace(campaign("Search", 1, ["R1", "R1", "R2"]), durations=(1.0,) * 100)
    long = replace(campaign("w/o it", 1, ["R2"] * 8), durations=(4.0,) * 100)
    table = made("violations-equal-time", [short, long])
    assert [mean.mean for mean in column(table, "Executions")] == [100, 25]
    assert [mean.mean for mean in column(table, "Sum")] == [3, 5]  # a failure at every fifth execution
    assert "lane-follow 0.03 h" in " ".join(table.notes)


def test_in_equal_time_analysis_counts():
    durations = (1.0,) * 100
    cheap = replace(campaign("Search", 1, []), durations=durations, analysing=0.0)
    costly = replace(campaign("w/o it", 1, []), durations=durations, analysing=100.0)
    assert [mean.mean for mean in column(made("violations-equal-time", [cheap, costly]), "Executions")] == [100, 50]


def test_in_equal_time_scenarios_have_a_time_each():
    runs = [
        replace(campaign("Search", 1, ["R1"], env=env), durations=(seconds,) * 100)
        for env, seconds in zip(ENVS, (1.0, 4.0), strict=True)
    ]
    assert [mean.mean for mean in column(made("violations-equal-time", runs), "Executions")] == [100, 100]


def test_an_overview_in_equal_time_has_what_was_found_until_then():
    short = replace(campaign("Search", 1, ["R1", "R1", "R2"]), durations=(1.0,) * 100)
    long = replace(campaign("w/o it", 1, ["R2"] * 8), durations=(4.0,) * 100)
    table = made("overview-failures-equal-time", [short, long])
    assert [row[1].mean for row in table.rows] == [3, 5]
    assert "at most" in table.notes[1]
    assert "lane-follow 0.03 h" in table.notes[-1]


@pytest.mark.parametrize("unknown", [{"durations": ()}, {"analysing": math.nan}])
def test_there_is_no_table_of_equal_time_if_a_time_is_not_known(unknown):
    runs = [replace(campaign("Search", seed, []), durations=(1.0,) * 100) for seed in (1, 2)]
    runs[1] = replace(runs[1], **unknown)
    assert not [table.name for table in tables(EXPERIMENT, runs) if table.name.endswith("-equal-time")]


def test_a_contrast_is_a_family_of_its_own():
    experiment = replace(EXPERIMENT, contrasts={"causes": (("w/o it", "Uniform_1"), ("Search", "w/o it"))})
    table = next(found for found in tables(experiment, SUMMARIES) if found.name == "failures-contrast-causes")
    assert [row[1:3] for row in table.rows] == [("w/o it", "Uniform_1"), ("Search", "w/o it")]
    assert "for 2 comparisons" in table.notes[1]


def test_tables_of_weaknesses_say_that_they_replicate_nothing():
    for name in ("violations", "weaknesses"):
        assert any("with the paper's findings in sight" in note for note in made(name, SIGNED).notes)
    assert not any("in sight" in note for note in made("violations").notes)


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


@pytest.mark.parametrize(
    ("baseline", "reference", "heads", "rows"),
    [
        ("Uniform_1", "", ["Method", "Mean", "Uniform_1"], [("Search", 3.0, 2.0), ("w/o it", 1.0, 2.0)]),
        ("", "Search", ["Against", "Search", "Mean"], [("w/o it", 3.0, 1.0), ("Uniform_1", 3.0, 2.0)]),
        ("Search", "", ["Against", "Search", "Mean"], [("w/o it", 3.0, 1.0), ("Uniform_1", 3.0, 2.0)]),
    ],
)
def test_the_first_table_has_a_column_for_the_method_of_all_rows_and_a_row_for_each_other(
    baseline, reference, heads, rows
):
    experiment = replace(EXPERIMENT, baseline=baseline, reference=reference)
    labels = {"Search": ["R2"] * 3, "w/o it": ["R2"], "Uniform_1": ["R2"] * 2}
    (table,) = headline(experiment, [campaign(name, seed, labels[name]) for name in labels for seed in (1, 2)])
    assert [head.name for head in table.columns[1:4]] == heads
    assert [row[1:4] for row in table.rows] == rows


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
    assert "| a | **3.0 [2.0, 4.0]** |" in table_markdown(table)
    assert "| d | 5.0 [4.0, 6.0] |" in table_markdown(table)
    piped = Table("piped", "Piped", (Column("A|B"), Column("C")), (("a|b", "c"),))
    assert "| A\\|B | C |\n| --- | --- |\n| a\\|b | c |" in table_markdown(piped)


def test_a_markdown_table_marks_the_best_and_has_its_notes():
    lines = table_markdown(made("distinct", CLASSIFIED)).splitlines()
    assert lines[:5] == [
        "**Distinct violations over all campaigns**",
        "",
        "| Method | Campaigns | R1 | R2 | R3 | Sum |",
        "| --- | --- | --- | --- | --- | --- |",
        "| Search | 2 | 2 | 1 | 1 | 4 |",
    ]
    assert lines[-1].startswith("Question: ")
    assert "| **4.0 [1.5, 6.5]** |" in table_markdown(made("violations"))


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
    assert (rows[0]["r_BF"], rows[0]["r_BF_passed"], rows[0]["executing_s"]) == ("-1.0", "-1.0", "8.0")
    assert (rows[3]["r_BF"], rows[3]["simulated_s"], rows[3]["waypoint_mutations"]) == ("", "", "0")
    classified = list(csv.DictReader(io.StringIO(summaries_csv(CLASSIFIED))))
    assert (classified[0]["unique"], classified[0]["unique_R1"], classified[0]["classes"]) == ("2", "1", "R1-a R2-a")
    assert "weaknesses" not in classified[0]
    signed = list(csv.DictReader(io.StringIO(summaries_csv(SIGNED))))
    assert [(row["weaknesses"], row["signatures"]) for row in signed[:2]] == [("2", "R1-8 R2-2"), ("2", "R1-2 R1-8")]


def test_curves_rise_with_the_failures():
    drawn = curves(EXPERIMENT, SUMMARIES)
    assert drawn[0].figure == "failures at fault"
    curve = next(one for one in drawn if (one.method, one.figure) == ("Search", "failures"))
    found = dict(zip(curve.executions, (point.mean for point in curve.found), strict=True))
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
    assert by_figure["failures at fault"].found[-1].mean == CLASSIFIED[0].at_fault()
    assert by_figure["classes of failures at fault"].found[-1].mean == CLASSIFIED[0].classes_at_fault()
