"""Modules that are loaded late, or not at all."""

import subprocess
import sys
from importlib import import_module
from threading import Thread

import pytest

from behavexplor.data.first_use import hidden

LOADED = 'print("pandas.core" in sys.modules, "matplotlib.figure" in sys.modules)\n'


def ran(code):
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert result.returncode == 0, result.stderr
    return result.stdout.split("\n")


def test_a_campaign_in_one_process_loads_no_plots(tmp_path):
    code = f"""
import sys
from behavexplor.commands import main

main("fuzz --quiet --workers 0 --ads constant --budget 2 --out {tmp_path}/run".split())
{LOADED}"""
    assert ran(code)[-2].endswith("False")


def test_workers_load_neither_tables_nor_plots():
    code = """
import multiprocessing
from behavexplor.execution.shared_imports import share_imports, slow_modules

if __name__ == "__main__":
    share_imports(slow_modules("intersection-straight", "constant"))
    names = ("highway_env", "pandas.core", "matplotlib.figure")
    with multiprocessing.get_context("forkserver").Pool(1) as pool:
        print(pool.apply(eval, [f"[name in __import__('sys').modules for name in {names}]"]))
"""
    assert ran(code)[0] == "[True, False, False]"


def test_a_program_that_uses_the_library_loads_all():
    code = f"""
import sys
from behavexplor.envs.making import make_registered

make_registered("intersection-straight", {{}})
{LOADED}"""
    assert ran(code)[0] == "True True"


def test_clustering_loads_no_tables():
    code = f"""
import sys
from behavexplor.behavior.clusters import load_clustering

load_clustering()
{LOADED}"""
    assert ran(code)[0] == "False False"


def test_a_module_that_was_not_loaded_is_loaded_at_its_first_use():
    code = """
import sys
from behavexplor.data.first_use import loaded_at_first_use
from behavexplor.envs.making import make_registered

with loaded_at_first_use():
    make_registered("intersection-straight", {})
print("pandas.core" in sys.modules, "matplotlib.figure" in sys.modules)
import pandas
from matplotlib import pyplot
from highway_env.envs.common import observation
from highway_env.vehicle import dynamics

print(observation.pd.DataFrame({"a": [1, 2]}).a.sum(), observation.pd is pandas, dynamics.plt is pyplot)
print(callable(dynamics.plt.subplots), sys.modules["pandas"] is pandas)
"""
    assert ran(code)[:3] == ["False False", "3 True True", "True True"]


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


def test_a_module_is_hidden_in_one_thread_and_for_a_while(monkeypatch):
    monkeypatch.delitem(sys.modules, "xmlrpc.server", raising=False)
    seen = []
    with hidden("xmlrpc.server"):
        with pytest.raises(ModuleNotFoundError, match=r"No module named 'xmlrpc\.server'"):
            import_module("xmlrpc.server")
        thread = Thread(target=lambda: seen.append(import_module("xmlrpc.server").__name__))
        thread.start()
        thread.join()
    assert seen == ["xmlrpc.server"]
    assert not any(type(finder).__name__ == "_HidingFinder" for finder in sys.meta_path)
