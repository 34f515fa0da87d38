"""Paired statistics: counts, McNemar's exact test, and the interval of the difference."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from behavexplor.campaign.record import Record
from behavexplor.data.drawn_scenario import DrawnScenario, Setup
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.errors import InputError
from behavexplor.judge.specs import SPECS
from behavexplor.repair.pairs import AT_FAULT, COLUMNS, FAILED, Pairs, paired, rows

NAMES = tuple(spec.name for spec in SPECS)


def record(number, *violated, fault=None, scenario=None):
    scenario = scenario or ScriptedScenario(f"place-{number}", ())
    return Record(id=number, end="arrived", violated=violated, fault=fault, scenario=scenario.to_dict())


def pairs(fixed, broken, both=0, neither=0):
    return Pairs("any", tuple(range(fixed)), tuple(range(fixed, fixed + broken)), both, neither)


def test_what_only_one_driver_fails_is_fixed_or_broken():
    first = [record(0, "lines"), record(1, "collision", "destination"), record(2), record(3)]
    second = [record(0), record(1, "collision"), record(2, "collision", fault="npc_rear_end"), record(3)]
    found = {row.outcome: row for row in paired(first, second, NAMES)}
    assert list(found) == [FAILED, AT_FAULT, "collision", "lines", "destination"]
    assert (found[FAILED].only_first, found[FAILED].only_second) == ((0,), (2,))
    assert (found[AT_FAULT].only_first, found[AT_FAULT].only_second) == ((0,), ())
    assert (found["collision"].both, found["collision"].neither) == (1, 2)
    assert found["destination"].only_first == (1,)
    assert found[FAILED].rates == (0.5, 0.5)


def test_specs_that_mean_nothing_in_the_environment_are_left_out():
    first, second = [record(0, "lines", "mine")], [record(0, "mine")]
    outcomes = [row.outcome for row in paired(first, second, ("collision", "arrived"))]
    assert outcomes == [FAILED, AT_FAULT, "collision", "mine"]


def test_runs_of_other_scenarios_are_refused():
    with pytest.raises(InputError, match="Execution 1 is another scenario"):
        paired([record(0), record(1)], [record(0), record(1, scenario=ScriptedScenario("elsewhere", ()))], NAMES)


def test_the_same_draws_are_the_same_scenario_for_policies_that_see_and_act_otherwise():
    def drawn(config, seed=3):
        return DrawnScenario(Setup("merge-v0", config, "default", "1.12.1"), seed, (("a", (0.5,)),))

    first = [record(0, scenario=drawn('{"duration":20,"observation":{"type":"Kinematics"}}'))]
    assert paired(first, [record(0, scenario=drawn('{"action":{"type":"DiscreteMetaAction"},"duration":20}'))], NAMES)
    for other in (drawn('{"duration":30}'), drawn('{"duration":20}', seed=4)):
        with pytest.raises(InputError, match="another scenario"):
            paired(first, [record(0, scenario=other)], NAMES)


@pytest.mark.parametrize(("fixed", "broken"), [(0, 0), (1, 1), (5, 0), (10, 2), (6, 59)])
def test_the_p_value_is_that_of_a_fair_coin(fixed, broken):
    n = fixed + broken
    tail = sum(math.comb(n, k) for k in range(min(fixed, broken) + 1)) / 2**n
    assert pairs(fixed, broken, 3, 90).p == pytest.approx(min(2 * tail, 1.0))


def test_the_interval_is_that_of_agresti_and_min():
    # Their table 1: approval of a prime minister, 794, 150, 86 and 570 of 1600: 0.04 with the interval 0.02 to 0.06
    difference, low, high = pairs(86, 150, 794, 570).difference
    assert difference == pytest.approx(0.04)
    assert (low, high) == (pytest.approx(0.0212, abs=5e-4), pytest.approx(0.0587, abs=5e-4))


@given(st.tuples(*[st.integers(0, 40)] * 4).filter(any))
def test_the_interval_contains_the_difference_of_the_enlarged_table_and_stays_in_range(cells):
    difference, low, high = pairs(*cells).difference
    assert -1 <= low <= high <= 1
    n = sum(cells)
    assert low <= difference * n / (n + 2) <= high


def test_a_row_has_a_cell_for_each_column():
    (row,) = rows([pairs(8, 0, 2, 90)])
    assert len(row) == len(COLUMNS)
    assert row[1:6] == ("10.0%", "2.0%", "8", "0", "2")
