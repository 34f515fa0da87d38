import subprocess
import sys

CODE = """
import sys

import numpy as np

from behavexplor.behavior.novelty import NoveltyArchive
from behavexplor.campaign.judgment import judgment
from behavexplor.campaign.opening import load_analysis
from behavexplor.execution.simulation import Simulation
from behavexplor.judge.specs import SPECS


def loaded():
    modules = [vars(sys.modules[name]) for name in list(sys.modules) if name.startswith("behavexplor.")]
    kernels = {key: value for module in modules for key, value in module.items() if hasattr(value, "signatures")}
    return {key: len(kernel.signatures) for key, kernel in kernels.items() if kernel.signatures}


load_analysis()
print(len(loaded()) > 8, "fill_states" in loaded())
simulation = Simulation("intersection-straight", "constant:1")
rng = np.random.default_rng(0)
traces = [trace for _, trace in simulation.run_all([simulation.logical.sample(rng) for _ in range(16)])]
safe = [trace.to_bytes() for trace in traces if trace.end != "collision"]
before, archive = loaded(), NoveltyArchive()
novelties = [archive.observe(judgment(data, None, SPECS).trace) for data in safe]
print(len(novelties) > 5, loaded() == before)
"""


def test_nothing_is_left_to_load_when_the_first_trace_is_analyzed():
    result = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, timeout=120, check=False)
    assert result.returncode == 0, result.stderr
    assert result.stdout.split() == ["True"] * 4
