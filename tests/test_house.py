"""The package keeps its structure: not too many modules, none too small, none that only one other needs."""

from tests.house import LIMITS, measures, table


def test_the_structure_is_within_its_limits():
    found = measures()
    over = {name: places for name, (value, places) in found.items() if value > LIMITS[name]}
    assert not over, f"{table(found)}\n{over}"
    assert found.keys() == LIMITS.keys()
