"""Modules that are loaded late, or not at all."""

import subprocess
import sys
from importlib import import_module
from threading import Thread

import pytest

from behavexplor.data.first_use import hidden

LOADED = 'print(*[name in sys.modules for name in ("pandas.core", "matplotlib.figure", "scipy.stats")])\n'


def ran(code):
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert result.returncode == 0, result.stderr
    return result.stdout.split("\n")


def test_a_campaign_in_one_process_loads_no_tables_plots_or_statistics(tmp_path):
    code = f"""
import sys
from behavexplor.commands import main

main("fuzz --quiet --workers 0 --ads constant --budget 2 --out {tmp_path}/run".split())
{LOADED}
print("sklearn.cluster" in sys.modules, "numpy.f2py.crackfortran" in sys.modules)
"""
    assert ran(code)[-3:-1] == ["False False False", "True False"]


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
    assert ran(code)[0] == "True True False"


def test_clustering_loads_no_tables():
    code = f"""
import sys
from behavexplor.behavior.clusters import load_clustering

load_clustering()
{LOADED}"""
    assert ran(code)[0] == "False False True"  # another thread may be importing scipy.stats


def test_what_clustering_left_out_is_loaded_when_it_is_needed():
    code = """
import sys
from behavexplor.behavior.clusters import load_clustering
from behavexplor.data.first_use import loaded_at_first_use

with loaded_at_first_use():
    load_clustering()
print("scipy.stats" in sys.modules)
from sklearn.metrics import label_ranking_average_precision_score
from sklearn.preprocessing import PowerTransformer, QuantileTransformer

print(label_ranking_average_precision_score([[1, 0, 0]], [[0.75, 0.5, 1]]))
print("scipy.stats" in sys.modules)
import scipy

print(QuantileTransformer(n_quantiles=3, output_distribution="normal").fit_transform([[1.0], [2.0], [4.0]])[1])
print(PowerTransformer().fit([[1.0], [2.0], [4.0]]).lambdas_.shape, round(scipy.stats.norm.cdf(0), 3))
"""
    assert ran(code)[:5] == ["False", "0.5", "True", "[0.]", "(1,) 0.5"]


def test_statistics_that_are_loaded_stay_so():
    code = """
import scipy.stats
from behavexplor.behavior.clusters import load_clustering
from behavexplor.data.first_use import loaded_at_first_use

with loaded_at_first_use():
    load_clustering()
from sklearn.metrics import _ranking

print(_ranking.rankdata is scipy.stats.rankdata)
"""
    assert ran(code)[0] == "True"


def test_a_module_that_was_not_loaded_is_loaded_at_its_first_use():
    code = """
import sys
from behavexplor.data.first_use import loaded_at_first_use
from behavexplor.envs.making import make_registered

with loaded_at_first_use():
    make_registered("intersection-straight", {})
print("matplotlib.figure" in sys.modules)
import pandas
from matplotlib import pyplot
from highway_env.envs.common import observation
from highway_env.vehicle import dynamics

print(observation.pd.DataFrame({"a": [1, 2]}).a.sum(), observation.pd is pandas, dynamics.plt is pyplot)
print(callable(dynamics.plt.subplots), sys.modules["pandas"] is pandas)
"""
    assert ran(code)[:3] == ["False", "3 True True", "True True"]


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


def test_a_module_that_waits_for_its_first_use_is_not_loaded_by_those_it_is_hidden_from():
    code = """
import sys
from behavexplor.data.first_use import hidden, loaded_at_first_use

with loaded_at_first_use():
    import pandas
with hidden("pandas"):
    try:
        import pandas as another
    except ModuleNotFoundError as error:
        print(error)
print("pandas.core" in sys.modules, sys.modules["pandas"] is pandas)
print(pandas.Series([1, 2]).sum(), "pandas.core" in sys.modules)
with hidden("pandas"):
    import pandas as another
print(another is pandas)
"""
    assert ran(code)[:4] == ["No module named 'pandas'", "False True", "3 True", "True"]


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
