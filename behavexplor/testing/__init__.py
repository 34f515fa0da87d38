"""Contract tests for search methods, driving systems, specs and environments of other packages.

Each function checks what behavexplor promises to its users about one interface, and raises a `ContractError` that says
which promise is broken::

    from behavexplor.testing import check_search_method

    def test_my_search():
        check_search_method("my_package.search:MySearch")

`Suite` and `opened_driver` are for the tests that `behavexplor suite` writes.
"""

from behavexplor.repair.cases import Suite
from behavexplor.repair.checking import opened_driver
from behavexplor.testing.contracts import ContractError, check_ads, check_env, check_search_method, check_spec
from behavexplor.testing.synthetic import synthetic_trace

__all__ = [
    "ContractError",
    "Suite",
    "check_ads",
    "check_env",
    "check_search_method",
    "check_spec",
    "opened_driver",
    "synthetic_trace",
]
