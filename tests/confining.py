"""Whether the system that tests run on can confine a process."""

import subprocess
import sys
from functools import cache
from pathlib import Path

_TRIED = """
import os
from behavexplor.execution.confinement import confine
print(confine() == ())
os.kill(os.getppid(), 0)
"""


@cache
def confines() -> bool:
    """Whether it can keep a process from writing files, using the network, and sending signals; tried in another."""
    command = [sys.executable, "-c", _TRIED]
    tried = subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parent.parent, check=False)
    return tried.stdout.strip() == "True" and "PermissionError" in tried.stderr
