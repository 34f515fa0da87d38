"""Every failure of one campaign in each of S1 to S4, and in highway and roundabout: valid, and the same again.

The checkers of ASAM need other versions of libraries than this package. Each is looked for on the path, or where a
variable of the environment says: QC_OPENSCENARIO (of asam-qc-openscenarioxml) and QC_OPENDRIVE (of asam-qc-opendrive).
"""

import os
import re
import shutil
import subprocess

import pytest

from behavexplor.commands import main
from tests.exchange.exported import difference, failures, fuzz, imported, repeated, schema_errors

BUDGET = 100
CAMPAIGNS = {
    "intersection-straight": "rule",
    "intersection-left": "rule",
    "lane-follow": "rule",
    "lane-change": "rule",
    "highway-v0": "constant:IDLE",
    "roundabout-v0": "constant:IDLE",
}
CHECKERS = {".xosc": ("qc_openscenario", "xoscBundle"), ".xodr": ("qc_opendrive", "xodrBundle")}
CONFIG = (
    '<Config><Param name="InputFile" value="{path}"/><CheckerBundle application="{bundle}">'
    '<Param name="resultFile" value="{result}"/></CheckerBundle></Config>'
)


@pytest.fixture(scope="module", params=CAMPAIGNS)
def exported(request, tmp_path_factory):
    """A run with its environment and driver, and the folders of its scenes with a recorded and with a free ego."""
    folder, ads = tmp_path_factory.mktemp("campaign"), CAMPAIGNS[request.param]
    run = fuzz(folder / "run", request.param, ads, BUDGET)
    forms = {"recorded": "trajectories", "free": "routes"}
    for ego, npcs in forms.items():
        assert main(["export", str(run), "--out", str(folder / ego), "--ego", ego, "--npcs", npcs]) == 0
    return run, request.param, ads, [folder / ego for ego in forms]


@pytest.mark.slow
def test_every_failure_is_valid_and_the_same_when_imported(exported):
    run, env, ads, folders = exported
    executions = failures(run)
    assert executions
    for folder in folders:
        assert [error for path in folder.iterdir() for error in schema_errors(path)] == []
        again = repeated([imported(folder / f"{one.id:06d}.xosc") for one in executions], env, ads)
        for execution, trace in zip(executions, again, strict=True):
            distance, said, expected = difference(execution, trace)
            assert distance < 0.01
            assert said == expected


@pytest.mark.slow
@pytest.mark.parametrize("kind", CHECKERS)
def test_the_checkers_of_the_standards_find_no_issue(exported, kind, tmp_path):
    name, bundle = CHECKERS[kind]
    program = os.environ.get(name.upper()) or shutil.which(name)
    if program is None:
        pytest.skip(f"{name} is not installed; see docs/exchange.md")
    for path in (path for folder in exported[3] for path in sorted(folder.glob(f"*{kind}"))):
        config, result = tmp_path / "config.xml", tmp_path / "result.xqar"
        config.write_text(CONFIG.format(path=path, bundle=bundle, result=result))
        subprocess.run([program, "-c", str(config)], check=True, capture_output=True, timeout=300)
        found = result.read_text()
        assert {*re.findall(r'status="(\w+)"', found)} <= {"completed", "skipped"}
        assert re.findall(r'<Issue [^>]*description="([^"]*)"', found) == []
        result.unlink()
