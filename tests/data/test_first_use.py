"""Modules that are loaded late, or not at all."""

import subprocess
import sys
from importlib import import_module
from threading import Thread

import pytest

from behavexplor.data.first_use import hidden

TRACED = """
import sys
from behavexplor.{module} import {name}

{call}
print("pandas.core" in sys.modules, "matplotlib.figure" in sys.modules)
"""


def ran(code):
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert result.returncode == 0, result.stderr
    return result.stdout.split("\n")


def test_an_environment_loads_neither_tables_nor_plots():
    call = "make_registered('intersection-straight', {})"
    assert ran(TRACED.format(module="envs.making", name="make_registered", call=call))[0] == "False False"


def test_clustering_loads_no_tables():
    assert ran(TRACED.format(module="behavior.clusters", name="load_clustering", call="load_clustering()"))[0] == (
        "False False"
    )


def test_a_module_that_was_not_loaded_is_loaded_at_its_first_use():
    code = """
import sys
from behavexplor.envs.making import make_registered

make_registered("intersection-straight", {})
import pandas
from matplotlib import pyplot
from highway_env.envs.common import observation
from highway_env.vehicle import dynamics

print(observation.pd.DataFrame({"a": [1, 2]}).a.sum(), observation.pd is pandas, dynamics.plt is pyplot)
print(callable(dynamics.plt.subplots), sys.modules["pandas"] is pandas)
"""
    assert ran(code)[:2] == ["3 True True", "True True"]


def test_tables_can_be_clustered_after_clustering_was_loaded_without_them():
    code = """
from behavexplor.behavior.clusters import load_clustering

load_clustering()
import pandas
from sklearn.preprocessing import StandardScaler

table = pandas.DataFrame({"a": [1.0, 2.0], "b": [3.0, 5.0]})
scaled = StandardScaler().set_output(transform="pandas").fit_transform(table)
print(type(scaled).__name__, scaled.a.tolist())
"""
    assert ran(code)[0] == "DataFrame [-1.0, 1.0]"


def test_a_module_is_hidden_in_one_thread_and_for_a_while():
    seen = []
    with hidden("xmlrpc.server"):
        with pytest.raises(ModuleNotFoundError, match=r"No module named 'xmlrpc\.server'"):
            import_module("xmlrpc.server")
        thread = Thread(target=lambda: seen.append(import_module("xmlrpc.server").__name__))
        thread.start()
        thread.join()
    assert seen == ["xmlrpc.server"]
    assert not any(type(finder).__name__ == "_HidingFinder" for finder in sys.meta_path)
