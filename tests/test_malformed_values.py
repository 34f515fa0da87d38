"""Input of the right form with wrong values in it, made by hypothesis: what changing bytes hardly reaches."""

import atexit
import io
import json
import pickle
import shutil
import sqlite3
import tempfile
from base64 import b64encode
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import ZipFile

import gymnasium
import numpy as np
import pytest
import yaml
from gymnasium.spaces import Box, Discrete, MultiBinary, MultiDiscrete
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from behavexplor import FUNCTIONAL_SCENARIOS
from behavexplor.ads.learned.driver import LearnedDriver
from behavexplor.ads.learned.network_file import read_network
from behavexplor.ads.sb3.archive import DATA, SETTINGS
from behavexplor.bench.experiment import read_experiment
from behavexplor.campaign.campaign import search_method
from behavexplor.campaign.config import CampaignConfig, campaign_config, read_yaml
from behavexplor.campaign.database_file import connect
from behavexplor.campaign.database_rows import Row, insert
from behavexplor.campaign.folder_format import DATABASE
from behavexplor.campaign.store import Store
from behavexplor.commands import BAD_INPUT, OK, main
from behavexplor.data.motion_bytes import unpack_arrays
from behavexplor.data.scenario import parse_scenario
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.data.trace import Trace
from behavexplor.envs.making import environment_id
from behavexplor.errors import InputError
from behavexplor.execution.simulation import Simulation
from behavexplor.fuzz.methods import METHODS, load_method
from behavexplor.report.reading import read_run
from behavexplor.report.run_page import page
from behavexplor.triage.findings import TRIAGE, Triage
from tests.ads.sb3.models import make_model
from tests.malformed import is_sentence, limited, refuse, write
from tests.strategies import changed, changed_arrays, command_lines, random_trace, scenarios, values

LOGICALS = {name: Simulation(name, "constant").logical for name in sorted(FUNCTIONAL_SCENARIOS)}
EXPERIMENT = {
    "name": "small",
    "methods": {"A": {"method": "uniform", "options": {}}, "B": {"config": "paper"}},
    "envs": ["lane-follow", "lane-change"],
    "ads": ["constant", "constant:0.5"],
    "seeds": 3,
    "first_seed": 1,
    "budget": 20,
    "batch": 4,
    "workers": 0,
    "trust": [f"sha256:{'0' * 64}"],
    "reference": "A",
    "baseline": "B",
    "groups": {"both": ["A", "B"]},
}
KINEMATICS = {
    "type": "Kinematics",
    "vehicles_count": 5,
    "features": ["presence", "x", "y", "heading"],
    "features_range": {"x": [-10, 10]},
    "absolute": True,
    "order": "sorted",
    "normalize": True,
    "clip": True,
    "see_behind": False,
    "observe_intentions": False,
    "include_obstacles": True,
}
STEERED = {
    "type": "ContinuousAction",
    "acceleration_range": [-5, 5],
    "steering_range": [-0.5, 0.5],
    "speed_range": [0, 9],
    "longitudinal": True,
    "lateral": True,
    "dynamical": False,
    "clip": True,
}
TIMES = {"simulation_frequency": 20, "policy_frequency": 10, "duration": 20.0}
NPCS = {
    "n_npcs": 3,
    "waypoints_per_lane": 2,
    "min_speed": 0.2,
    "end_gap": 2.5,
    "npc_gap": 8.0,
    "ego_gap": 15.0,
    "vehicle_types": ["suv"],
}
COMPILED = [  # configurations that the vector environment takes, too
    {"observation": KINEMATICS, "action": STEERED, **TIMES, "reward": {"progress": 1.0}, "logical": NPCS},
    {"observation": {"type": "Scene"}, "action": {"type": "DiscreteMetaAction", "target_speeds": [0, 5, 10]}},
]
GRID = {
    "type": "OccupancyGrid",
    "features": ["presence", "on_road"],
    "grid_size": [[-10, 10], [-10, 10]],
    "grid_step": [5, 5],
    "as_image": False,
    "align_to_vehicle_axes": True,
}
LIDAR = {"type": "LidarObservation", "cells": 8, "maximum_range": 60, "normalize": True}
IMAGE = {"type": "GrayscaleObservation", "observation_shape": (64, 48), "stack_size": 2, "weights": [0.3, 0.6, 0.1]}
CONFIGURATIONS = [
    *COMPILED,
    {"observation": GRID, "action": {"type": "DiscreteAction", "actions_per_axis": 3}},
    {"observation": {"type": "TupleObservation", "observation_configs": [LIDAR, KINEMATICS]}},
    {"observation": {"type": "TimeToCollision", "horizon": 10}, "action": {"type": "DiscreteMetaAction"}},
    {"observation": IMAGE, "screen_width": 64, "screen_height": 48, "scaling": 1.7, "centering_position": [0.5, 0.5]},
]
SPACES = [
    Box(-1, 1, ()),
    Box(-1, 1, (0, 5)),
    Box(-1, 1, (7, 5, 1)),
    Box(-np.inf, np.inf, (300_000,)),
    Box(0, 255, (36, 36, 3), np.uint8),
    Discrete(10**9),
    Discrete(10**15),
    Discrete(5, start=-2),
    MultiBinary(3),
    MultiDiscrete([2, 10**6]),
    gymnasium.spaces.Dict({"a": Discrete(2)}),
    gymnasium.spaces.Text(4),
]
DESCRIPTION = {
    "observation": {"type": "Kinematics", "vehicles_count": 7},
    "action": {"type": "ContinuousAction"},
    "policy_frequency": 5,
    "simulation_frequency": 15,
    "frame_stack": 1,
    "about": {"a": 1},
}


def to_yaml(path, value):
    try:
        text = yaml.safe_dump(value)
    except RecursionError:
        text = json.dumps(value)  # nearly the same
    return write(path, text.encode(errors="surrogatepass"))


def of_scenario(value, folder, capfd):
    scenario = parse_scenario(json.dumps(value))
    LOGICALS.get(scenario.functional, LOGICALS["lane-follow"]).check(scenario)


def of_config(value, folder, capfd):
    config = campaign_config(read_yaml(to_yaml(folder / "config.yaml", value)))
    search_method(config, LOGICALS["lane-follow"]).ask()


def config_of(method):
    """A campaign's file in which every option of the method is named."""
    options = asdict(load_method(method).Options())
    config = CampaignConfig(ads="constant", env="lane-follow", method=method, options=options)
    return json.loads(json.dumps(asdict(config)))


def of_experiment(value, folder, capfd):
    experiment = read_experiment(str(to_yaml(folder / "experiment.yaml", value)))
    assert experiment.to_yaml()
    assert all(not run.folder.is_absolute() and ".." not in run.folder.parts for run in experiment.runs())


def of_environment(value, folder, capfd):
    name, config = value
    env = gymnasium.make(environment_id(name), config=config, disable_env_checker=True)
    begin(env)


def of_vector_environment(value, folder, capfd):
    name, config = value
    env = gymnasium.make_vec(environment_id(name), 2, "vector_entry_point", config=config)
    begin(env)


def begin(env):
    """Drive one decision long."""
    env.reset(seed=0)
    env.action_space.seed(0)
    env.step(env.action_space.sample())
    env.close()


def of_trace(arrays, folder, capfd):
    """Wrong values as a file of an earlier version, which can hold values of any type."""
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    Trace.from_bytes(buffer.getvalue())


def trace_arrays():
    trace = random_trace(0)
    return unpack_arrays(trace.to_bytes()) | {"format": np.array(1), "end": np.array(trace.end)}


def of_network(arrays, folder, capfd):
    np.savez(folder / "network.npz", **arrays)
    LearnedDriver(LOGICALS["lane-follow"].roadmap, read_network(folder / "network.npz"))


def network_arrays():
    path = Path(read_network.__code__.co_filename).parent / "policies" / "lane-follow.npz"
    with np.load(path) as arrays:
        return dict(arrays)


def of_model(value, folder, capfd):
    use_model({DATA: json.dumps(value).encode()}, folder)


def of_description(value, folder, capfd):
    to_yaml(folder / "model.yaml", value)
    use_model({}, folder)


def use_model(changed_members, folder):
    path = folder / "model.zip"
    with ZipFile(path, "w") as file:
        for name, content in {**model_members(), **changed_members}.items():
            file.writestr(name, content)
    simulation = Simulation("lane-follow", str(path))
    simulation.env.reset(seed=0)
    simulation.close()


@cache
def model_members():
    buffer = io.BytesIO()
    make_model("PPO", policy_kwargs={"net_arch": [8, 8], "ortho_init": True}).save(buffer)
    with ZipFile(buffer) as file:
        return {name: file.read(name) for name in file.namelist()}


def models():
    """The settings of a model, with other values in place of some, or other objects in their pickles."""
    data = {key: without_notes(value) for key, value in json.loads(model_members()[DATA]).items() if key in SETTINGS}
    objects = (st.sampled_from(SPACES) | values).map(pickled)
    pickles = st.tuples(st.just(data), st.sampled_from(sorted(data)), objects)
    return changed(data) | pickles.map(lambda drawn: {**drawn[0], drawn[1]: drawn[2]})


def without_notes(value):
    """What is read of a pickled setting; the rest says in words what it is."""
    return {":serialized:": value[":serialized:"]} if isinstance(value, dict) and ":serialized:" in value else value


def pickled(value):
    return {":serialized:": b64encode(pickle.dumps(value)).decode()}


def of_record(value, folder, capfd):
    run = copied_run(folder)
    with connect(run / DATABASE, "rw") as connection:
        trace = connection.execute("SELECT trace FROM executions WHERE id = 0").fetchone()[0]
        with suppress(sqlite3.OperationalError):  # nested too deeply for SQLite: nobody can have written that
            insert(connection, [Row(0, json.dumps(value).encode(), trace, 1.0)])
    connection.close()
    (run / TRIAGE).unlink(missing_ok=True)
    command = (["records", run], ["report", run], ["triage", run, "--workers", 0, "--quiet"])[len(str(value)) % 3]
    return refuse(capfd, *command, accepted=(OK,), sentences=2)


def first_record():
    store = Store.read(small_run())
    record = store.execution(0).record.to_dict()
    store.close()
    return record


def of_triage(value, folder, capfd):
    run = copied_run(folder)
    (run / TRIAGE).write_text(json.dumps(value))
    page([read_run(run)], 10)


def triage_values():
    found = read_run(small_run())
    return json.loads(json.dumps({"format": 1, **asdict(Triage("lane-follow", "constant:1", 6, found.findings))}))


@cache
def small_run():
    """The folder of a run of six executions, some of which failed."""
    folder = Path(tempfile.mkdtemp()) / "run"
    atexit.register(shutil.rmtree, folder.parent)
    flags = ["--ads", "constant:1", "--env", "lane-follow", "--method", "uniform", "--budget", "6", "--seed", "7"]
    assert main(["fuzz", *flags, "--workers", "0", "--quiet", "--out", str(folder)]) == OK
    return folder


def copied_run(folder):
    if not (folder / "run").is_dir():
        shutil.copytree(small_run(), folder / "run")
    return folder / "run"


def of_command_line(arguments, folder, capfd):
    return refuse(capfd, *arguments, accepted=(OK,))


class Kind(NamedTuple):
    made: Callable[[], st.SearchStrategy[Any]]
    few: int
    many: int


PLACES = st.sampled_from(list(LOGICALS))
KINDS = {
    of_scenario: Kind(
        lambda: PLACES.flatmap(lambda name: scenarios(LOGICALS[name])).map(ScriptedScenario.to_dict).flatmap(changed),
        40,
        1500,
    ),
    of_config: Kind(lambda: st.sampled_from(list(map(config_of, METHODS))).flatmap(changed), 40, 1500),
    of_experiment: Kind(lambda: changed(EXPERIMENT), 15, 500),
    of_environment: Kind(lambda: st.tuples(PLACES, st.sampled_from(CONFIGURATIONS).flatmap(changed)), 40, 1000),
    of_vector_environment: Kind(lambda: st.tuples(PLACES, st.sampled_from(COMPILED).flatmap(changed)), 30, 700),
    of_trace: Kind(lambda: changed_arrays(trace_arrays), 40, 1500),
    of_network: Kind(lambda: changed_arrays(network_arrays), 30, 500),
    of_model: Kind(models, 20, 500),
    of_description: Kind(lambda: changed(DESCRIPTION), 15, 500),
    of_record: Kind(lambda: changed(first_record()), 10, 250),
    of_triage: Kind(lambda: changed(triage_values()), 10, 400),
    of_command_line: Kind(command_lines, 15, 600),
}


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_wrong_values_are_refused_in_one_sentence(kind, tmp_path, capfd, monkeypatch):
    attack(kind, KINDS[kind].few, tmp_path, capfd, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_many_wrong_values_are_refused_in_one_sentence(kind, tmp_path, capfd, monkeypatch):
    codes = attack(kind, KINDS[kind].many, tmp_path, capfd, monkeypatch)
    with capfd.disabled():
        print(json.dumps({kind.__name__: codes}))  # noqa: T201 - the figures of docs/robustness.md


@pytest.fixture(scope="module", autouse=True)
def machine_code():
    """What is compiled takes its time once; the limits are for what is handed in."""
    for config in COMPILED:
        begin(gymnasium.make_vec(environment_id("lane-follow"), 2, "vector_entry_point", config=config))


def attack(kind, examples, tmp_path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)
    codes = Counter()

    @settings(
        max_examples=examples, derandomize=True, deadline=None, database=None, suppress_health_check=list(HealthCheck)
    )
    @given(KINDS[kind].made())
    def hand_in(value):
        with limited():
            codes[outcome(kind, value, tmp_path, capfd)] += 1

    with np.printoptions(threshold=9):
        hand_in()
    assert codes[BAD_INPUT] >= 0.2 * codes.total()
    return codes


def outcome(kind, value, folder, capfd):
    """The exit code: that of the program, or what it makes of an error of the library."""
    try:
        return kind(value, folder, capfd) or OK
    except InputError as error:
        assert is_sentence(str(error))
        return BAD_INPUT
