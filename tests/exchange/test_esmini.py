"""Exported scenes played by esmini, which a variable of the environment names: ESMINI=/path/to/bin/esmini.

A stand-in of a few lines plays the trajectories of a scene as esmini logs them, so that a displaced vehicle is known to
be noticed.
"""

import csv
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from lxml import etree

from behavexplor.commands import main
from tests.exchange.exported import failures, fuzz

CAMPAIGNS = {
    "intersection-straight": "tests.drivers:cruiser",
    "intersection-left": "tests.drivers:cruiser",
    "lane-follow": "tests.drivers:cruiser",
    "lane-change": "tests.drivers:cruiser",
    "highway-fast-v0": "constant:FASTER",
    "merge-v0": "constant:FASTER",
    "roundabout-v0": "constant:FASTER",
    "intersection-v0": "constant:FASTER",
}
NEAR = 1e-5  # [m]
STAND_IN = """
import sys
from lxml import etree
scene, log, displaced = sys.argv[1], sys.argv[2], float(sys.argv[3])
ways = []
for actor in etree.parse(scene).iterfind(".//ManeuverGroup"):
    name = actor.find(".//EntityRef").get("entityRef")
    vertices = actor.findall(".//Polyline/Vertex")
    if vertices:
        ways.append((name, [(v.get("time"), v.find(".//WorldPosition")) for v in vertices]))
with open(log, "w") as file:
    print("esmini, a stand-in", file=file)
    names = ("Entity_Name [-]", "World_Position_X [m]", "World_Position_Y [m]", "collision_ids")
    heads = [f"#{i} {name}" for i in range(1, len(ways) + 1) for name in names]
    print("Index [-], TimeStamp [s]", *heads, sep=", ", file=file)
    for k, (time, _) in enumerate(max((own for _, own in ways), key=len)):
        rows = [(name, own[min(k, len(own) - 1)][1]) for name, own in ways]
        cells = [c for name, at in rows for c in (name, float(at.get("x")) + displaced, at.get("y"), "")]
        print(k, time, *cells, sep=", ", file=file)
"""


def logged(path):
    """Times and places by vehicle, (T, 3), and whether each vehicle touches another one, from a log of esmini."""
    lines = path.read_text().splitlines()
    first = next(i for i, line in enumerate(lines) if line.lstrip().startswith("Index"))
    heads, *rows = csv.reader(lines[first:], skipinitialspace=True)
    heads = [head.strip().replace("Entitity", "Entity") for head in heads]  # as older versions write it
    found = {}
    for head in (head for head in heads if head.endswith("Entity_Name [-]")):
        number = head.split()[0]
        keys = ("TimeStamp [s]", f"{number} World_Position_X [m]", f"{number} World_Position_Y [m]")
        own = [[float(row[heads.index(key)]) for key in keys] for row in rows]
        touches = [bool(row[heads.index(f"{number} collision_ids")].strip()) for row in rows]
        found[rows[0][heads.index(head)].strip()] = (np.array(own), touches)
    return found


def deviation(scene, log):
    """The greatest distance between the vertices of a scene's trajectories and where they were played [m]."""
    found, greatest = logged(log), 0.0
    groups = [
        group for group in etree.parse(scene).iterfind(".//ManeuverGroup") if group.find(".//Polyline") is not None
    ]
    assert groups
    for group in groups:
        played, _ = found[group.find(".//EntityRef").get("entityRef")]
        for vertex in group.iterfind(".//Polyline/Vertex"):
            time, at = float(vertex.get("time")), vertex.find(".//WorldPosition")
            frame = int(np.abs(played[:, 0] - time).argmin())
            if abs(played[frame, 0] - time) < 1e-3:  # a parked vehicle's second vertex may lie behind the end
                distance = math.hypot(played[frame, 1] - float(at.get("x")), played[frame, 2] - float(at.get("y")))
                greatest = max(greatest, distance)
    return greatest


def exported(folder, env, budget=12):
    """The failures of a campaign, each with its scene."""
    run = fuzz(folder / "run", env, CAMPAIGNS[env], budget)
    found = failures(run)
    assert found
    assert main(["export", str(run), "--out", str(folder / "scenes")]) == 0
    return [(one, folder / "scenes" / f"{one.id:06d}.xosc") for one in found]


@pytest.mark.slow
@pytest.mark.parametrize("env", CAMPAIGNS)
def test_esmini_plays_what_was_recorded(env, tmp_path):
    program = os.environ.get("ESMINI") or shutil.which("esmini")
    if program is None:
        pytest.skip("esmini is not installed; see docs/exchange.md")
    for execution, scene in exported(tmp_path, env):
        trace, log = execution.load_trace(), scene.with_suffix(".csv")
        step = float(trace.time[1] - trace.time[0])
        flags = ["--headless", "--fixed_timestep", repr(step), "--traj_filter", "0", "--pline_interpolation", "segment"]
        flags += ["--collision", "--disable_stdout", "--csv_logger", str(log), "--osc", scene.name]
        subprocess.run([program, *flags], check=True, cwd=scene.parent, capture_output=True, timeout=300)
        assert deviation(scene, log) < NEAR
        _, touches = logged(log)["Ego"]
        if trace.end == "collision" and env in list(CAMPAIGNS)[:4]:  # highway-env predicts contacts
            assert abs(touches.index(True) - (len(trace.time) - 1)) <= 1


@pytest.mark.parametrize(("displaced", "is_near"), [(0.0, True), (1e-4, False)])
def test_a_displaced_vehicle_would_be_noticed(displaced, is_near, tmp_path):
    (tmp_path / "stand_in.py").write_text(STAND_IN)
    _, scene = exported(tmp_path, "roundabout-v0", budget=6)[0]
    log = Path(tmp_path / "log.csv")
    command = [sys.executable, str(tmp_path / "stand_in.py"), str(scene), str(log), str(displaced)]
    subprocess.run(command, check=True)
    assert (deviation(scene, log) < NEAR) == is_near
    assert "Ego" in logged(log)
