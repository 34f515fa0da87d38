"""What an import costs. Which module may import which is checked by import-linter, see pyproject.toml."""

import subprocess
import sys

import pytest

HEAVY = {"highway_env", "matplotlib", "pandas", "pygame", "sklearn", "stable_baselines3", "torch"}


@pytest.mark.parametrize(
    "name", ["behavexplor", "behavexplor.fuzz", "behavexplor.fuzz.methods", "behavexplor.judge.specs"]
)
def test_import_is_light(name):
    code = f"import sys, {name}; print(sorted({HEAVY} & set(sys.modules)))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
