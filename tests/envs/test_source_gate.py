"""What runs is what the engines were ported from, and what a program replaces is noticed."""

import json
import pickle
import subprocess
import sys
import types
from copy import deepcopy
from functools import partial

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import SyncVectorEnv
from highway_env import utils
from highway_env.envs import HighwayEnv, HighwayEnvFast, IntersectionEnv, RoundaboutEnv
from highway_env.envs.common import abstract
from highway_env.envs.common.action import DiscreteMetaAction
from highway_env.envs.common.observation import observation_factory
from highway_env.road.road import Road
from highway_env.vehicle.behavior import IDMVehicle, LinearVehicle
from highway_env.vehicle.controller import ControlledVehicle, MDPVehicle
from highway_env.vehicle.kinematics import Vehicle

import behavexplor
from behavexplor.envs import source_gate
from behavexplor.envs.driving import DrivingEnv
from behavexplor.envs.engine.vehicle_parameters import TRAFFIC_PARAMETERS
from behavexplor.envs.highway.highway_vector_env import HighwayVectorEnv
from behavexplor.envs.making import make_env, make_vector_env
from behavexplor.envs.sb3_vec_env import HighwayVecEnv
from behavexplor.envs.source_gate import MODULES, ChangeGuard, changes, ported_sources, replaced, replaced_in
from behavexplor.errors import InputError
from tests.envs.patches import MOMENTS, classes_of_engines, in_child, other, patches

NOT_RULES = ("metadata", "render", "close", "update_metadata", "set_record_video_wrapper", "_automatic_rendering")
READ = ("default_config", "logical", "track_config_path", "metaclass__")


def present_sources(owners):
    """What the installed release of highway-env has in classes and modules, in the form of `source_digests.json`."""
    found = {}
    for owner in owners:
        module, name = source_gate._module(owner), source_gate._qualname(owner)
        if not module.startswith("highway_env."):
            continue
        digests, names = source_gate._digests(module), found.setdefault(module, {}).setdefault(name, {})
        for key, value in sorted(vars(owner).items()):
            if source_gate._matters(owner, key, value):
                is_value = source_gate._codes(value) is None
                path = f"{name}.{key}".lstrip(".")
                names[key] = source_gate._VALUE + source_gate._text(value) if is_value else digests[path]
    return found


def test_highway_env_is_the_one_that_was_ported():
    present = json.dumps(present_sources([*classes_of_engines(), *MODULES]), indent=1)
    assert not changes(classes_of_engines(), TRAFFIC_PARAMETERS), (
        f"compare these with the port, then update source_digests.json: {present}"
    )


def test_every_class_of_the_engines_was_ported():
    ported = {(module, name) for module, classes in ported_sources().items() for name in classes}
    ours = {(cls.__module__, cls.__qualname__) for cls in classes_of_engines()}
    assert {one for one in ours if one[0].startswith("highway_env.")} <= ported
    assert {(module.__name__, "") for module in MODULES} <= ported


def test_every_name_is_noticed_before_and_after_an_environment_is_made(monkeypatch):
    classes, noticed = classes_of_engines(), []
    for patch in patches():
        owner, name = patch.found(), patch.name
        guard = ChangeGuard(classes)
        guard.check()
        with monkeypatch.context() as replacing:
            changed = vars(owner)[name]
            replacing.setattr(owner, name, other(changed) if not isinstance(changed, str) else "")
            if name in NOT_RULES or name in READ:
                guard.check()
                continue
            label = f"{owner.__name__.rpartition('.')[2]}.{name}"
            is_initial = owner is gymnasium.Env and name in ("render_mode", "spec")  # which environments replace
            assert (label in changes(classes, TRAFFIC_PARAMETERS)) != (name in TRAFFIC_PARAMETERS or is_initial), label
            if vars(owner)[name] is not changed:
                with pytest.raises(InputError, match=f"{label} changed after the compiled environment was made"):
                    guard.check()
            noticed.append(label)
        guard.check()
    assert len(noticed) > 350


@pytest.mark.parametrize(
    ("owner", "name", "value"),
    [
        (IDMVehicle, "is_yielding", True),  # which highway-env asks each vehicle for
        (IDMVehicle, "steering_control", lambda *_: 0.0),  # hides the method of a parent
        (IDMVehicle, "speed", property(lambda _: 1.0, lambda *_: None)),  # hides an attribute of the objects
        (MDPVehicle, "__setattr__", lambda *_: None),
        (Road, "act", types.MethodType(lambda *_: None, Road)),
        (abstract, "observation_factory", lambda *_: None),  # imported from another module
        (abstract, "IDMVehicle", LinearVehicle),
        (utils, "not_zero", lambda x, _=0: x),
    ],
)
def test_what_is_added_or_imported_is_noticed(owner, name, value, monkeypatch):
    classes = classes_of_engines()
    monkeypatch.setattr(owner, name, value, raising=False)
    assert any(found.endswith(f".{name}") for found in changes(classes))


def test_code_that_is_replaced_within_a_function_is_noticed(monkeypatch):
    monkeypatch.setattr(Vehicle.clip_actions, "__code__", (lambda self: None).__code__)
    assert changes([Vehicle]) == ("Vehicle.clip_actions",)


def test_what_the_file_of_another_release_adds_is_no_change(monkeypatch):
    ported = deepcopy(ported_sources())
    del ported["highway_env.vehicle.behavior"]["IDMVehicle"]["recover_from_stop"]
    monkeypatch.setattr(source_gate, "ported_sources", lambda: ported)
    assert not changes([IDMVehicle])
    del ported["highway_env.vehicle.behavior"]["IDMVehicle"]["act"]  # a new one that hides that of a parent
    ported["highway_env.vehicle.behavior"]["IDMVehicle"]["mobil"] = "0" * 16
    ported["highway_env.vehicle.behavior"]["IDMVehicle"]["ACC_MAX"] = "= 7.0"  # a parameter, which is read
    ported["highway_env.vehicle.controller"]["ControlledVehicle"]["KP_A"] = "= 7.0"
    ported["highway_env.road.lane"]["StraightLane"]["gone"] = "0" * 16
    del ported["highway_env.road.road"]["Road"]
    lane = type(IntersectionEnv().road.network.lanes_list()[0])
    named = changes([IDMVehicle, ControlledVehicle, lane, Road], TRAFFIC_PARAMETERS)
    assert named == (
        "IDMVehicle.act",
        "IDMVehicle.mobil",
        "ControlledVehicle.KP_A",
        "StraightLane.gone",
        "Road.__class__",
    )


def test_a_patched_environment_runs_in_highway_env_itself_with_one_warning(monkeypatch):
    original = HighwayEnv._create_vehicles

    def only_two_others(env):
        original(env)
        env.road.vehicles = env.road.vehicles[:3]

    monkeypatch.setattr(HighwayEnv, "_create_vehicles", only_two_others)
    with pytest.warns(UserWarning, match="highway-env itself runs, .* another HighwayEnv._create_vehicles") as warned:
        env = gymnasium.make_vec("behavexplor/highway-fast-v0", num_envs=2, vectorization_mode="vector_entry_point")
    assert len(warned) == 1
    assert isinstance(env, SyncVectorEnv)
    assert len(env.envs[0].unwrapped.road.vehicles) == 3
    with pytest.raises(InputError, match=r"HighwayEnv._create_vehicles.*vectorization_mode='sync'"):
        HighwayVectorEnv(HighwayEnvFast)
    with pytest.warns(UserWarning, match="highway-env itself runs"):
        trained = HighwayVecEnv([lambda: gymnasium.make("highway-fast-v0", config={"duration": 2})] * 2)
    trained.reset()
    dones = [trained.step(np.ones(2, dtype=np.int64))[2] for _ in range(3)]
    assert np.any(dones)


def test_patches_of_other_environments_do_not_matter(monkeypatch):
    monkeypatch.setattr(RoundaboutEnv, "_reward", lambda *_: 0.0)
    assert isinstance(
        gymnasium.make_vec("behavexplor/highway-fast-v0", vectorization_mode="vector_entry_point"), HighwayVectorEnv
    )


def test_scripted_environments_refuse_by_name(monkeypatch):
    make = {"vectorization_mode": "vector_entry_point"}
    env = gymnasium.make_vec("behavexplor/lane-follow-v0", **make)
    env.reset(seed=0)
    monkeypatch.setattr(DrivingEnv, "_find_end", lambda _: "timeout")
    env.step(env.action_space.sample())
    with pytest.raises(InputError, match=r"DrivingEnv._find_end changed after .*make the environment again"):
        env.reset()
    with pytest.raises(InputError, match=r"another DrivingEnv._find_end than .*vectorization_mode='sync'"):
        gymnasium.make_vec("behavexplor/lane-follow-v0", **make)


@pytest.mark.filterwarnings("ignore:.*highway-env itself")
def test_an_episode_after_a_change_begins_anew_on_highway_envs_objects(monkeypatch):
    env, clip = gymnasium.make("behavexplor/intersection-left-v0").unwrapped, Vehicle.clip_actions
    env.reset(seed=1)
    begun = [(*vehicle.position, vehicle.speed) for vehicle in env.road.vehicles]
    for _ in range(20):
        env.step(np.array([1.0, 0.0], dtype=np.float32))
    monkeypatch.setattr(Vehicle, "clip_actions", lambda vehicle: clip(vehicle) or None)
    env.reset(seed=1)
    assert [(*vehicle.position, vehicle.speed) for vehicle in env.road.vehicles] == begun


def test_automatic_resets_look_too(monkeypatch):
    env = HighwayVectorEnv(HighwayEnvFast, 1, {"duration": 1}, autoreset_mode="SameStep")
    env.reset(seed=0)
    monkeypatch.setattr(IDMVehicle, "mobil", lambda *_: True)
    with pytest.raises(InputError, match=r"IDMVehicle.mobil changed"):  # noqa: PT012 - at every eighth reset
        for _ in range(8):
            env.step(np.array([1]))


def test_an_environment_of_an_intersection_elsewhere_changes_nothing():
    expected = IDMVehicle.DISTANCE_WANTED
    env = HighwayVectorEnv(HighwayEnvFast, 1, {"duration": 3})
    first, _ = env.reset(seed=0)
    IntersectionEnv()
    assert expected != IDMVehicle.DISTANCE_WANTED
    again, _ = env.reset(seed=0)
    assert (first == again).all()
    IDMVehicle.DISTANCE_WANTED = 8.0
    with pytest.raises(InputError, match=r"IDMVehicle.DISTANCE_WANTED changed"):
        env.reset()


class CountingEnv(HighwayEnvFast):
    """Counts its episodes in its class, and sets a parameter of the traffic in each."""

    episodes = 0

    def _create_vehicles(self):
        super()._create_vehicles()
        type(self).episodes += 1
        IDMVehicle.TIME_WANTED = 1.0 + self.episodes % 2


def test_what_own_starts_do_to_their_classes_is_supported():
    env = HighwayVectorEnv(CountingEnv, 1, {"duration": 1})
    for _ in range(3):
        env.reset()
    assert CountingEnv.episodes == 4  # the first one when it was made
    CountingEnv._create_vehicles = HighwayEnvFast._create_vehicles
    with pytest.raises(InputError, match=r"CountingEnv._create_vehicles changed"):
        env.reset()


def test_guards_can_be_copied_and_pickled(monkeypatch):
    guard = ChangeGuard([IDMVehicle], frozenset({"ACC_MAX"}))
    there = pickle.loads(pickle.dumps(guard))
    monkeypatch.setattr(IDMVehicle, "ACC_MAX", 1.0)
    there.check()
    monkeypatch.setattr(LinearVehicle, "ACCELERATION_RANGE", np.ones((2, 3)))
    there.check()
    monkeypatch.setattr(IDMVehicle, "mobil", lambda *_: True)
    for one in (there, deepcopy(guard)):
        with pytest.raises(InputError, match=r"IDMVehicle.mobil"):
            one.check()


def test_what_changes_in_place_or_in_an_import_is_noticed_when_an_environment_is_made_again(monkeypatch):
    HighwayVectorEnv(HighwayEnvFast)
    monkeypatch.setitem(DiscreteMetaAction.ACTIONS_ALL, 0, "IDLE")
    with pytest.raises(InputError, match=r"DiscreteMetaAction.ACTIONS_ALL"):
        HighwayVectorEnv(HighwayEnvFast)
    monkeypatch.undo()
    HighwayVectorEnv(HighwayEnvFast)
    monkeypatch.setattr(abstract, "observation_factory", partial(observation_factory))
    with pytest.raises(InputError, match=r"abstract.observation_factory"):
        HighwayVectorEnv(HighwayEnvFast)


def test_an_array_in_place_of_another_is_a_change(monkeypatch):
    guard = ChangeGuard([LinearVehicle])
    monkeypatch.setattr(LinearVehicle, "ACCELERATION_RANGE", LinearVehicle.ACCELERATION_RANGE.copy())
    guard.check()
    monkeypatch.setattr(LinearVehicle, "ACCELERATION_RANGE", np.ones((2, 3)))
    with pytest.raises(InputError, match="ACCELERATION_RANGE"):
        guard.check()


class Quick(IDMVehicle):
    """Another parameter, and methods of its own."""

    TIME_WANTED = 0.5

    def is_quick(self):
        return True

    def __repr__(self):
        return "quick"


class Painted(IDMVehicle):
    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)


class Fixed(IDMVehicle):
    @property
    def target_speed(self):
        return 3.0

    @target_speed.setter
    def target_speed(self, _):
        pass


def test_what_a_subclass_replaces_is_found():
    assert replaced(Quick, IDMVehicle) == "Quick.TIME_WANTED"
    assert replaced(Quick, IDMVehicle, {"TIME_WANTED"}) is None
    assert replaced(Painted, IDMVehicle) == "Painted.__init__"
    assert replaced(Fixed, IDMVehicle) == "Fixed.target_speed"
    assert replaced(IDMVehicle, IDMVehicle) is None


def test_a_patch_before_anything_of_this_package_is_imported_is_noticed():
    program = (
        "from highway_env.envs import HighwayEnv\n"
        "HighwayEnv._is_terminated = lambda env: False\n"
        "import behavexplor, gymnasium\n"
        "env = gymnasium.make_vec('behavexplor/highway-v0', vectorization_mode='vector_entry_point')\n"
        "print(type(env).__name__)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "SyncVectorEnv\n"
    assert "another HighwayEnv._is_terminated than" in done.stderr


@pytest.mark.slow
def test_no_patch_of_one_name_ends_the_interpreter_or_is_ignored():
    tries = [([patch], moment) for patch in patches() for moment in MOMENTS]
    outcomes = in_child(tries)
    assert [one for one, outcome in zip(tries, outcomes, strict=True) if outcome == "different"] == []
    assert outcomes.count("original") > 200
    assert outcomes.count("refused") > 600


@pytest.mark.slow
def test_no_patch_of_two_names_ends_the_interpreter_or_is_ignored():
    rng, found = np.random.default_rng(0), patches()
    tries = []
    for k in range(200):
        one, two = (found[i] for i in rng.choice(len(found), 2, replace=False))
        tries.append(([one, two._replace(world=one.world)], MOMENTS[k % 3]))
    outcomes = in_child(tries)
    assert [one for one, outcome in zip(tries, outcomes, strict=True) if outcome == "different"] == []


def endless(spec="highway-fast-v0"):
    """An environment in which a program has replaced a method of the object alone."""
    env = gymnasium.make(spec, config={"duration": 3})
    env.unwrapped._is_terminated = lambda: False
    return env


def test_a_method_that_is_replaced_in_an_object_is_refused_by_name(monkeypatch):
    assert replaced_in(endless().unwrapped) == "HighwayEnvFast._is_terminated"
    assert replaced_in(gymnasium.make("highway-fast-v0").unwrapped) is None
    with pytest.raises(InputError, match=r"HighwayEnvFast._is_terminated of this environment; use DummyVecEnv"):
        HighwayVecEnv([endless])
    with pytest.raises(InputError, match=r"without its HighwayEnvFast._is_terminated: override it in a subclass"):
        behavexplor.find_failures(lambda _: 1, endless(), budget=1)
    monkeypatch.setitem(gymnasium.registry, "own/endless-v0", EnvSpec("own/endless-v0", lambda **_: endless()))
    env = make_env("own/endless-v0", {})
    with pytest.raises(InputError, match=r"HighwayEnvFast._is_terminated of this environment object"):
        make_vector_env(env, 2, {})
