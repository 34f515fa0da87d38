"""The layers of the house: which module may import which, read from the source; see CONTRIBUTING.md."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "behavexplor"
MODULES = sorted(PACKAGE.rglob("*.py"))

GROUND = {"compiled", "errors", "geometry", "plain", "roadmap", "scenario", "logical", "scene", "trace"}
STRANGERS = {"envs", "ads", "fuzz"}
EXECUTION = {"rollout", "simulation", "executor", "health", "identity", "serving", "workers", "cluster", "confinement"}
CAMPAIGN = {"config", "database", "losses", "store", "campaign", "running", "drawing", "evaluation"}
ALLOWED = {
    **dict.fromkeys(GROUND, GROUND),
    **{room: GROUND | {room} for room in STRANGERS},
    **dict.fromkeys(EXECUTION, GROUND | EXECUTION | {"ads"}),
    **dict.fromkeys(CAMPAIGN, GROUND | EXECUTION | CAMPAIGN | {"fuzz"}),
    "triage": GROUND | EXECUTION | {"ads", "fuzz", "config", "store", "triage"},
    "report": GROUND | {"config", "fuzz", "store", "triage", "bench", "report"},
    "training": GROUND | EXECUTION | {"ads", "envs"},
    "bench": GROUND | EXECUTION | CAMPAIGN | {"fuzz", "triage", "bench"},
    "commands": GROUND | EXECUTION | CAMPAIGN | {"ads", "fuzz", "training", "triage", "bench", "report", "commands"},
    "__main__": {"commands"},
    "fuzz.__main__": {"commands"},
    "envs.sb3": GROUND | {"envs"},
    "__init__": set(),
}
APART = {("fuzz", "__main__"), ("envs", "sb3")}  # modules that may import what their neighbors may not
HEAVY = {  # where the heavy libraries may be imported
    "highway_env": {"envs"},
    "pygame": {"envs"},
    "torch": {"ads", "training"},
    "stable_baselines3": {"ads", "envs.sb3", "training"},
    "sb3_contrib": {"ads", "training"},
    "numba": {"compiled"},
    "landlockpy": {"confinement"},
    "pyseccomp": {"confinement"},
    "sklearn": {"fuzz", "triage"},
    "pymoo": {"fuzz"},
    "ribs": {"fuzz"},
    "rich": {"commands"},
    "tyro": {"commands"},
    "ray": {"cluster"},
    "distributed": {"cluster"},
    "PIL": {"drawing"},
    "matplotlib": {"bench"},
    "jinja2": {"report"},
}


def room(path: Path) -> str:
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts) if parts in APART else parts[0]


def imports(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_module_imports_only_what_its_layer_may(path):
    for name in imports(path):
        parts = name.split(".")
        if parts[0] in HEAVY:
            assert room(path) in HEAVY[parts[0]], f"{path.name} must not import {parts[0]}"
        if name.startswith("behavexplor.") and (PACKAGE / f"{parts[1]}.py").exists() | (PACKAGE / parts[1]).is_dir():
            assert parts[1] in ALLOWED[room(path)], f"{path.name} must not import behavexplor.{parts[1]}"


def test_every_room_has_a_layer():
    assert {room(path) for path in MODULES} <= set(ALLOWED)


@pytest.mark.parametrize(
    "name", ["behavexplor", "behavexplor.fuzz", "behavexplor.fuzz.methods", "behavexplor.judge.specs"]
)
def test_import_is_light(name):
    heavy = "{'torch', 'stable_baselines3', 'highway_env', 'sklearn', 'pandas', 'matplotlib', 'pygame', 'numba'}"
    code = f"import sys, {name}; print(sorted({heavy} & set(sys.modules)))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
