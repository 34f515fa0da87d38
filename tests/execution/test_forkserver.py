import signal
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
from multiprocessing import forkserver
from behavexplor.execution.forkserver import share_imports

share_imports(["json"])
print(forkserver._forkserver._forkserver_pid, flush=True)
input()
"""
LOADED = "[name in sys.modules for name in ('highway_env', 'pandas.core', 'matplotlib.figure')]"
WORKER = f"""
import multiprocessing
from behavexplor.execution.forkserver import share_imports, preloaded_modules

if __name__ == "__main__":
    share_imports(preloaded_modules("intersection-straight", "constant"))
    with multiprocessing.get_context("forkserver").Pool(1) as pool:
        print(pool.apply(eval, ["{LOADED}".replace("sys", "__import__('sys')")]))
"""
FIRST_USE = f"""
import sys
import behavexplor.execution.lazy_imports
import behavexplor.envs.functional
print({LOADED})

import pandas
from matplotlib import pyplot
from highway_env.envs.common import observation
from highway_env.vehicle import dynamics

print(observation.pd.DataFrame({{"a": [1, 2]}}).a.sum(), observation.pd is pandas, dynamics.plt is pyplot)
print(callable(dynamics.plt.subplots), sys.modules["pandas"] is pandas)
"""
UNGUARDED = """
import behavexplor

print("the script runs")
run = behavexplor.find_failures("constant", "lane-follow", budget=2, method="uniform", workers=1, out="run")
print(len(run))
"""


def ran(code):
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert result.returncode == 0, result.stderr
    return result.stdout.split("\n")[:-1]


@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="needs the files in /proc")
def test_the_process_that_imports_for_all_is_not_interrupted():
    """Ctrl-C reaches it, too; in the middle of an import, it would end with a traceback on the terminal."""

    def blocks(pid):
        mask = Path(f"/proc/{pid}/status").read_text().partition("SigBlk:")[2].split()[0]
        return bool(int(mask, 16) & 1 << (signal.SIGINT - 1))

    with subprocess.Popen([sys.executable, "-c", SCRIPT], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        server = int(process.stdout.readline())
        assert blocks(server)
        assert not blocks(process.pid)
        process.communicate(b"\n")


def test_workers_load_neither_tables_nor_plots():
    assert ran(WORKER) == ["[True, False, False]"]


def test_a_module_that_was_not_loaded_is_loaded_at_its_first_use():
    assert ran(FIRST_USE) == ["[True, False, False]", "3 True True", "True True"]


def test_workers_do_not_run_the_users_script_again(tmp_path):
    """It has no `if __name__ == "__main__":`, and would train its policy once more."""
    script = tmp_path / "script.py"
    script.write_text(UNGUARDED)
    result = subprocess.run(
        [sys.executable, "-W", "ignore", script], capture_output=True, text=True, timeout=120, check=False, cwd=tmp_path
    )
    assert (result.returncode, result.stderr) == (0, "")
    assert result.stdout.split("\n") == ["the script runs", "2", ""]
