"""Scenes: exported, valid, imported and executed again; changed by hand; refused with a name."""

import csv
import json
import math
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from lxml import etree

import behavexplor.commands.roads
from behavexplor.commands import main
from behavexplor.commands.roads import road_of
from behavexplor.data.drawn_scenario import DrawnScenario, Setup
from behavexplor.data.npc_motion import motion_table
from behavexplor.data.road_plan import plan_of_map
from behavexplor.data.scenario import parse_scenario
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.data.trace import ABSENT, Trace
from behavexplor.envs.making import is_highway, make_env
from behavexplor.errors import InputError
from behavexplor.exchange.opendrive import MAX_ERROR, write_road
from behavexplor.exchange.openscenario import CARLA, STANDARD, write_scene
from behavexplor.exchange.restoring import MAX_DEVIATION, restored
from behavexplor.exchange.scene_reading import read_scene
from behavexplor.exchange.scenes import COLUMNS, SceneFile, movers_of
from behavexplor.execution.simulation import logical_scenario
from tests.exchange.exported import difference, failures, fuzz, imported, repeated, schema_errors

ROOT = Path(__file__).parent.parent.parent
FORMS = [("recorded", "trajectories"), ("free", "routes")]
S1 = logical_scenario("intersection-straight")


@pytest.mark.parametrize(("ego", "npcs"), FORMS)
def test_failures_are_valid_and_the_same_when_imported(campaign, tmp_path, ego, npcs):
    run, env, ads = campaign
    executions = failures(run)
    if ego == "free" and is_highway(env):
        assert main(["export", str(run), "--out", str(tmp_path), "--ego", ego, "--npcs", npcs]) == 2
        assert list(tmp_path.iterdir()) == []
        return
    assert main(["export", str(run), "--out", str(tmp_path), "--ego", ego, "--npcs", npcs]) == 0
    paths = [tmp_path / f"{execution.id:06d}.xosc" for execution in executions]
    assert {*tmp_path.iterdir()} == {*paths, tmp_path / f"{env}.xodr"}
    assert [error for path in tmp_path.iterdir() for error in schema_errors(path)] == []
    scenarios = [imported(path) for path in paths]
    assert scenarios == [execution.scenario for execution in executions]
    if (ego, npcs) != FORMS[0]:
        return  # equal scenarios have equal executions
    for execution, again in zip(executions, repeated(scenarios, env, ads), strict=True):
        distance, said, expected = difference(execution, again)
        assert distance < 0.01
        assert said == expected


@pytest.mark.parametrize("ego", ["recorded", "free"])
def test_scenes_for_carla_are_valid_in_openscenario_1_0(campaign, tmp_path, ego):
    run, env, _ = campaign
    if is_highway(env) and ego == "free":
        return  # refused, as in the other format
    assert main(["export", str(run), "--out", str(tmp_path), "--ego", ego, "--format", "openscenario-1.0"]) == 0
    paths = [*tmp_path.glob("*.xosc")]
    assert len(paths) == len(failures(run))
    assert [error for path in paths for error in schema_errors(path, "1_0")] == []
    for root in map(etree.parse, paths):
        header = root.find("FileHeader")
        assert (header.get("revMajor"), header.get("revMinor")) == ("1", "0")
        is_crash = "ended by a collision" in header.get("description")
        assert ("before the boxes touch" in header.get("description")) == (is_highway(env) and is_crash)
        kinds = {one.get("name"): value(root, one.get("name"), "type") for one in root.iter("ScenarioObject")}
        assert [name for name, kind in kinds.items() if kind.get("value") == "ego_vehicle"] == ["Ego"]
        assert all(one.get("name").startswith("vehicle.") for one in root.iter("Vehicle"))
        assert root.find(".//Act/StopTrigger//CollisionCondition") is not None
        for private in root.iter("Private"):
            (place,) = private.iter("WorldPosition")  # ScenarioRunner begins at the last one
            assert place.getparent().getparent().tag == "TeleportAction"
        assert (root.find(".//Event//AcquirePositionAction") is not None) == (ego == "free")


def test_scenes_for_carla_have_the_centers_of_vehicles(scene, tmp_path):
    _, scenario, trace = scene
    path = tmp_path / "carla.xosc"
    write(path, scenario, trace, dialect=CARLA)
    root = etree.parse(path).getroot()
    for vehicle in root.iter("Vehicle"):  # the same distance before and behind the center
        front, rear = (float(vehicle.find(f"Axles/{name}Axle").get("positionX")) for name in ("Front", "Rear"))
        assert front == -rear == pytest.approx(0.3 * float(vehicle.find("BoundingBox/Dimensions").get("length")))
    vertex = next(group(root, "NPC1").iter("Vertex")).find("Position/WorldPosition")
    x, y = trace.position[0, 1]
    assert (float(vertex.get("x")), -float(vertex.get("y"))) == pytest.approx((x, y), abs=1e-6)
    with pytest.raises(InputError, match="of another program, or for CARLA"):
        read_scene(path)


def test_what_carla_cannot_play_is_refused(tmp_path, capsys):
    run = fuzz(tmp_path / "run", "intersection-v0", "constant:FASTER", 3)
    assert main(["export", str(run), "--out", str(tmp_path / "out"), "--format", "openscenario-1.0"]) == 2
    assert "a vehicle appears or leaves, which CARLA's ScenarioRunner cannot play" in capsys.readouterr().err
    assert main(["export", str(run), "0", "0", "--out", str(tmp_path / "twice")]) == 0
    assert "1 execution written" in capsys.readouterr().out
    flags = ["--format", "openscenario-1.0", "--npcs", "routes"]
    assert main(["export", str(run), "--out", str(tmp_path / "out"), *flags]) == 2
    assert "has no speed profiles" in capsys.readouterr().err


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A scripted scenario's exported file, with its scenario and its trace."""
    scenario = S1.sample(np.random.default_rng(3))
    trace = repeated([scenario], "intersection-straight", "tests.drivers:cruiser")[0]
    path = tmp_path_factory.mktemp("scene") / "scene.xosc"
    write(path, scenario, trace)
    return path, scenario, trace


def write(path, scenario, trace, *, is_ego_free=False, as_routes=False, dialect=STANDARD):
    movers = movers_of(scenario, trace, S1, is_ego_free=is_ego_free)
    made = SceneFile(
        "a test",
        "intersection-straight",
        road_file="road.xodr",
        movers=movers,
        is_ego_free=is_ego_free,
        destination=trace.destination,
        stops_there=True,
    )
    write_scene(made, path, datetime(2026, 1, 1, tzinfo=UTC), as_routes=as_routes, dialect=dialect)


def changed(path, tmp_path, change):
    """A copy of a scene, changed by hand."""
    root = etree.parse(path).getroot()
    change(root)
    copy = tmp_path / "changed.xosc"
    copy.write_bytes(etree.tostring(root))
    return copy


def entity(root, name):
    return next(one for one in root.iter("ScenarioObject") if one.get("name") == name)


def value(root, name, key):
    """The property of a vehicle."""
    names = (f"behavexplor:{key}", key)
    return next(one for one in entity(root, name).iter("Property") if one.get("name") in names)


def group(root, name):
    return next(one for one in root.iter("ManeuverGroup") if one.find("Actors/EntityRef").get("entityRef") == name)


def test_positions_are_mirrored_and_those_of_the_rear_axle(scene):
    path, scenario, trace = scene
    root = etree.parse(path).getroot()
    vertex = next(group(root, "NPC1").iter("Vertex")).find("Position/WorldPosition")
    x, y, heading = (float(vertex.get(name)) for name in ("x", "y", "h"))
    (cx, cy), turned = trace.position[0, 1], trace.heading[0, 1]
    back = 0.3 * trace.size[1, 0]
    assert (x, y) == pytest.approx((cx - back * np.cos(turned), -(cy - back * np.sin(turned))), abs=1e-6)
    assert np.cos(heading + turned) == pytest.approx(1.0)
    assert float(entity(root, "NPC1").find("Vehicle/BoundingBox/Center").get("x")) == pytest.approx(back)
    assert entity(root, "NPC1").find("Vehicle").get("name") == scenario.npcs[0].type


def test_a_collision_of_the_ego_with_any_vehicle_stops_the_storyboard(scene):
    path, scenario, _ = scene
    stop = etree.parse(path).getroot().find("Storyboard/StopTrigger")
    partners = [one.get("entityRef") for one in stop.iterfind(".//CollisionCondition/EntityRef")]
    assert partners == [f"NPC{i + 1}" for i in range(len(scenario.npcs))]
    assert len(stop.findall("ConditionGroup")) == len(partners) + 2  # also the arrival, and the time limit


def test_a_free_ego_has_a_start_and_a_destination_only(scene, tmp_path):
    _, scenario, trace = scene
    path = tmp_path / "free.xosc"
    write(path, scenario, trace, is_ego_free=True)
    root = etree.parse(path).getroot()
    actors = {one.get("entityRef") for one in root.iter("EntityRef") if one.getparent().tag == "Actors"}
    assert "Ego" not in actors
    assert {"NPC1", "NPC2"} <= actors
    goal = root.find(".//AcquirePositionAction/Position/WorldPosition")
    assert (float(goal.get("x")), -float(goal.get("y"))) == pytest.approx(tuple(trace.destination))
    movers = read_scene(path).movers
    ends = motion_table(scenario, S1.roadmap, np.array([200.0]))[0, :, :2]
    for mover, end in zip(movers[1:], ends, strict=True):
        np.testing.assert_allclose(mover.pose[-1, :2], end, atol=1e-6)


def test_a_changed_script_counts(scene, tmp_path):
    path, scenario, _ = scene

    def slower(root):
        first = value(root, "NPC1", "waypoints")
        pair, comma, rest = first.get("value").partition(",")
        first.set("value", f"{pair.split()[0]} 1.5{comma}{rest}")

    found = imported(changed(path, tmp_path, slower))
    assert found.npcs[0].waypoints[0].speed == 1.5
    assert found.npcs[0].waypoints[1:] == scenario.npcs[0].waypoints[1:]
    assert found.npcs[1:] == scenario.npcs[1:]


def test_a_changed_trajectory_counts(scene, tmp_path):
    path, scenario, _ = scene

    def later(root):
        for vertex in list(group(root, "NPC2").iter("Vertex")):
            vertex.set("time", str(float(vertex.get("time")) * 1.1))

    copy = changed(path, tmp_path, later)
    found = imported(copy)
    assert found.npcs[1] != scenario.npcs[1]
    assert found.npcs[:1] + found.npcs[2:] == scenario.npcs[:1] + scenario.npcs[2:]
    mover = read_scene(copy).movers[2]
    motion = motion_table(found, S1.roadmap, mover.time)[:, 1, :2]
    assert np.hypot(*(motion - mover.pose[:, :2]).T).max() < MAX_DEVIATION


def begin(root, name):
    """What a vehicle has at the start."""
    return next(one for one in root.iter("Private") if one.get("entityRef") == name)


def test_the_speed_at_the_start_of_a_trajectory_has_no_effect(scene, tmp_path):
    path, scenario, _ = scene

    def faster(root):
        begin(root, "NPC2").find(".//AbsoluteTargetSpeed").set("value", "7.0")

    assert imported(changed(path, tmp_path, faster)) == scenario


def test_a_copied_vehicle_without_a_trajectory_needs_its_digest_removed(scene, tmp_path):
    path, scenario, _ = scene

    def copy(root):
        """Replace NPC2 by a copy of its entity and start."""
        group(root, "NPC2").getparent().remove(group(root, "NPC2"))
        entity(root, "NPC2").set("name", "Copy")
        begin(root, "NPC2").set("entityRef", "Copy")

    copied = changed(path, tmp_path, copy)
    with pytest.raises(InputError, match=r"Copy has no trajectory.*remove behavexplor:recorded"):
        imported(copied)
    assert imported(changed(copied, tmp_path, drop(lambda root: value(root, "Copy", "recorded")))) == scenario

    def forget(root):
        properties = entity(root, "Copy").find("Vehicle/Properties")
        properties.getparent().remove(properties)

    with pytest.raises(InputError, match="Copy has neither a trajectory nor the properties behavexplor:route"):
        imported(changed(copied, tmp_path, forget))


def test_a_script_without_a_trajectory_counts(scene, tmp_path):
    path, scenario, _ = scene

    def only_script(root):
        for element in (group(root, "NPC1"), value(root, "NPC1", "recorded")):
            element.getparent().remove(element)

    assert imported(changed(path, tmp_path, only_script)) == scenario


def test_a_removed_vehicle_is_gone(scene, tmp_path):
    path, scenario, _ = scene

    def remove(root):
        for element in (entity(root, "NPC2"), group(root, "NPC2")):
            element.getparent().remove(element)
        for element in [one for one in root.iter("Private") if one.get("entityRef") == "NPC2"]:
            element.getparent().remove(element)

    assert imported(changed(path, tmp_path, remove)).npcs == scenario.npcs[:1] + scenario.npcs[2:]


def test_parameters_are_replaced(scene, tmp_path):
    path, scenario, _ = scene

    def declare(root):
        waypoints = value(root, "NPC1", "waypoints")
        attributes = {"name": "Way", "parameterType": "string", "value": waypoints.get("value")}
        etree.SubElement(root.find("ParameterDeclarations"), "ParameterDeclaration", attributes)
        waypoints.set("value", "$Way")

    assert imported(changed(path, tmp_path, declare)) == scenario


def set_attribute(find, key, text):
    return lambda root: find(root).set(key, text)


def add_element(find, name):
    return lambda root: etree.SubElement(find(root), name)


def first(path):
    return lambda root: root.find(path)


def drop(find):
    def remove(root):
        element = find(root)
        element.getparent().remove(element)

    return remove


def leave(root):
    """Let a scripted vehicle be deleted."""
    maneuver = group(root, "NPC1").find("Maneuver")
    event = etree.fromstring(etree.tostring(maneuver.find("Event")))
    action = event.find("Action")
    action.remove(action.find("PrivateAction"))
    entity_action = etree.SubElement(etree.SubElement(action, "GlobalAction"), "EntityAction", entityRef="NPC1")
    etree.SubElement(entity_action, "DeleteEntityAction")
    maneuver.append(event)


PRIVATE = "Storyboard/Init/Actions/Private/PrivateAction"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (add_element(first(".//Event/Action/PrivateAction"), "LateralAction"), "LateralAction in PrivateAction cannot"),
        (add_element(first("CatalogLocations"), "VehicleCatalog"), "VehicleCatalog in CatalogLocations cannot"),
        (add_element(first("Entities/ScenarioObject"), "Pedestrian"), "Pedestrian in ScenarioObject cannot be taken"),
        (set_attribute(first(".//FollowTrajectoryAction"), "initialDistanceOffset", "5"), "an initialDistanceOffset"),
        (set_attribute(first(".//Trajectory"), "closed", "true"), "a closed trajectory"),
        (
            set_attribute(first(".//ManeuverGroup"), "maximumExecutionCount", "0"),
            "a maximumExecutionCount other than 1",
        ),
        (set_attribute(first(".//Vertex"), "time", "${1+1}"), "an expression, or a parameter that is not declared"),
        (set_attribute(first(".//Vertex"), "time", "soon"), "time of Vertex must be a number, got 'soon'"),
        (set_attribute(first(".//Vertex"), "time", "nan"), "time of Vertex must be a number"),
        (
            set_attribute(first(f"{PRIVATE}//WorldPosition"), "x", "0"),
            "Ego begins at another place than its trajectory",
        ),
        (
            set_attribute(first("FileHeader/Properties/Property"), "name", "x"),
            "is an OpenSCENARIO file of another program",
        ),
        (set_attribute(lambda root: entity(root, "NPC1"), "name", "NPC2"), "Two entities are named 'NPC2'"),
        (
            set_attribute(lambda root: entity(root, "NPC1"), "name", "Other"),
            "the entity 'NPC1', which is not declared,",
        ),
        (set_attribute(lambda root: entity(root, "NPC1").find("Vehicle"), "name", "truck"), "Unknown vehicle type"),
        (set_attribute(lambda root: value(root, "NPC1", "waypoints"), "value", "1 2 3"), "a waypoint is a position"),
        (set_attribute(lambda root: value(root, "NPC2", "route"), "value", "up"), "NPC2: route: Unknown route 'up'"),
        (drop(first(f"{PRIVATE}/TeleportAction/..")), "Ego is nowhere: it needs a TeleportAction"),
        (drop(first(".//Event/StartTrigger")), "the start of this Event, which is not at a simulation time, cannot be"),
        (set_attribute(first("Storyboard/Story/Act/StartTrigger//*[@rule]"), "value", "3"), "a start at 3 s, after"),
        (set_attribute(first(".//Event//SimulationTimeCondition"), "value", "5"), "a start at 5 s, after"),
        (set_attribute(first(".//Event//SimulationTimeCondition"), "rule", "lessThan"), "the start of this Event"),
        (leave, "NPC1 appears or leaves during the scene"),
        (
            set_attribute(lambda root: entity(root, "NPC1").find(".//Dimensions"), "length", "12"),
            "choose another type of vehicle",
        ),
        (
            set_attribute(lambda root: entity(root, "NPC1").find(".//Center"), "x", "0"),
            "choose another type of vehicle",
        ),
        (set_attribute(lambda root: entity(root, "NPC1").find(".//Center"), "y", "1"), "choose another type"),
        (set_attribute(lambda root: entity(root, "Ego").find(".//Center"), "x", "0"), "box of the ego cannot be"),
        (
            set_attribute(lambda root: entity(root, "Ego").find(".//Dimensions"), "length", "12"),
            "The bounding box of the ego cannot be changed",
        ),
    ],
)
def test_what_cannot_be_taken_is_named(scene, tmp_path, change, message):
    with pytest.raises(InputError) as error:
        imported(changed(scene[0], tmp_path, change))
    assert message in str(error.value)


def test_a_trajectory_off_the_routes_is_named(scene, tmp_path):
    def aside(root):
        begin = next(one for one in root.iter("Private") if one.get("entityRef") == "NPC1")
        for place in [*group(root, "NPC1").iter("WorldPosition"), *begin.iter("WorldPosition")]:
            place.set("x", str(float(place.get("x")) + 3))
            place.set("y", str(float(place.get("y")) + 3))

    with pytest.raises(InputError, match=r"NPC1: no route with waypoints comes nearer to its trajectory than \d"):
        imported(changed(scene[0], tmp_path, aside))


def test_a_vehicle_that_would_drive_backwards_is_named(scene, tmp_path):
    def turn(root):
        for place in group(root, "NPC1").iter("WorldPosition"):
            place.set("h", str(float(place.get("h")) + math.pi))

    with pytest.raises(InputError, match="NPC1: its headings differ by more than 90 degrees"):
        imported(changed(scene[0], tmp_path, turn))


def test_a_changed_speed_profile_is_named(scene, tmp_path):
    _, scenario, trace = scene
    path = tmp_path / "routes.xosc"
    write(path, scenario, trace, as_routes=True)
    assert imported(path) == scenario
    change = set_attribute(first(".//SpeedProfileEntry"), "speed", "3")
    with pytest.raises(InputError, match="its start, route or speed profile is not that which was exported"):
        imported(changed(path, tmp_path, change))


def test_vehicles_that_appear_and_leave_are_added_and_deleted(tmp_path):
    frames, there = np.arange(20), np.zeros((20, 3), dtype=bool)
    there[:, 0], there[5:, 1], there[:12, 2] = True, True, True
    position = np.stack([frames[:, None] * [1.0, 2.0, 3.0], frames[:, None] * [0.0, 0.5, -0.5]], axis=-1)
    trace = Trace(
        time=frames / 15,
        position=np.where(there[..., None], position, ABSENT),
        heading=np.zeros((20, 3)),
        velocity=np.ones((20, 3, 2)),
        size=np.full((3, 2), [5.0, 2.0]),
        actions=np.zeros((0, 1)),
        action_frame=np.zeros(0),
        route=np.array([[0.0, 0.0], [20.0, 0.0]]),
        destination=np.array([20.0, 0.0]),
        illegal_lines=np.zeros((0, 2, 2)),
        end="timeout",
        present=there,
    )
    path = tmp_path / "scene.xosc"
    drawn = DrawnScenario(Setup("intersection-v0", "{}", "default", "1.12"), 0, ())
    movers = movers_of(drawn, trace, None, is_ego_free=False)
    write_scene(SceneFile("a test", "intersection-v0", movers=movers), path, datetime(2026, 1, 1, tzinfo=UTC))
    assert schema_errors(path) == []
    found = read_scene(path).movers
    assert [mover.is_gone for mover in found] == [False, False, True]
    assert [mover.is_changed for mover in found] == [False, False, False]
    for mover, wrote in zip(found, movers, strict=True):
        np.testing.assert_allclose(mover.time, wrote.time, atol=1e-8)
        np.testing.assert_allclose(mover.pose, wrote.pose, atol=1e-8)


def test_a_scene_of_vehicles_that_drive_themselves_cannot_be_changed(campaign, tmp_path, capsys):
    run, env, _ = campaign
    if env != "roundabout-v0":
        return
    number = failures(run)[0].id
    assert main(["export", str(run), str(number), "--out", str(tmp_path)]) == 0
    path = tmp_path / f"{number:06d}.xosc"

    def move(root):
        vertex = list(group(root, "NPC1").iter("Vertex"))[-1]
        vertex.find("Position/WorldPosition").set("x", "0")

    for change in (
        move,
        lambda root: entity(root, "NPC1").find(".//Dimensions").set("length", "9"),
        lambda root: entity(root, "NPC1").find(".//Center").set("x", "0"),
        lambda root: entity(root, "NPC1").find("Vehicle").set("name", "truck"),
        lambda root: begin(root, "NPC1").find(".//AbsoluteTargetSpeed").set("value", "1"),
    ):
        with pytest.raises(InputError, match="drive themselves, so their motion cannot be given: NPC1 was changed"):
            imported(changed(path, tmp_path, change))

    def redraw(root):
        drawn = root.find("FileHeader/Properties/Property[@name='behavexplor:scenario']")
        scenario = json.loads(drawn.get("value"))
        next(iter(scenario["draws"].values()))[0] = 0.25
        drawn.set("value", json.dumps(scenario))

    with pytest.raises(InputError, match="The draws of a scene of roundabout-v0 cannot be changed"):
        imported(changed(path, tmp_path, redraw))

    def remove(root):
        for element in (entity(root, "NPC1"), group(root, "NPC1")):
            element.getparent().remove(element)
        for element in [one for one in root.iter("Private") if one.get("entityRef") == "NPC1"]:
            element.getparent().remove(element)

    with pytest.raises(InputError, match="vehicles were added or removed"):
        imported(changed(path, tmp_path, remove))

    def configure(root):
        properties = root.find("FileHeader/Properties")
        etree.SubElement(properties, "Property", name="behavexplor:env_config", value='{"duration": 5}')

    with pytest.raises(InputError, match="env_config cannot be given"):
        imported(changed(path, tmp_path, configure))
    forget = drop(first("FileHeader/Properties/Property[@name='behavexplor:scenario']"))
    with pytest.raises(InputError, match="lacks the property behavexplor:scenario, its random draws"):
        imported(changed(path, tmp_path, forget))


@pytest.fixture
def exported(scene, tmp_path):
    """A scene with its road in a folder of its own."""
    path = tmp_path / "scene.xosc"
    path.write_bytes(scene[0].read_bytes())
    write_road(plan_of_map(S1.roadmap), "road", tmp_path / "road.xodr")
    return path


def test_an_import_prints_the_scenario_or_executes_it(exported, scene, tmp_path, capsys):
    _, scenario, trace = scene
    assert main(["import", str(exported)]) == 0
    assert parse_scenario(capsys.readouterr().out) == scenario
    out = tmp_path / "scenario.json"
    arguments = ["import", str(exported), "--ads", "tests.drivers:cruiser", "--unconfined", "--out", str(out)]
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    assert ("ended by a collision" in printed) == (trace.end == "collision")
    assert f"after {trace.duration:.2f} s" in printed
    assert parse_scenario(out.read_text()) == scenario
    assert main(["import", str(exported), "--out", str(exported)]) == 2
    assert "is there already, and is kept" in capsys.readouterr().err


def test_a_missing_road_is_said(exported, capsys):
    (exported.parent / "road.xodr").unlink()
    assert main(["import", str(exported)]) == 0
    assert "The file of the scene's road is not there" in capsys.readouterr().err


def test_a_changed_road_is_named(exported, capsys):
    road = exported.with_name("road.xodr")
    road.write_text(road.read_text().replace('name="road"', 'name="other"'))
    assert main(["import", str(exported)]) == 0  # the header does not count
    road.write_text(road.read_text().replace('a="3.5"', 'a="3.6"', 1))
    assert main(["import", str(exported)]) == 2
    assert "and a road cannot be changed by a scene" in capsys.readouterr().err


def test_a_scene_does_not_choose_which_code_is_loaded(exported, capsys):
    text = exported.read_text().replace('value="intersection-straight"', 'value="tests.nothing:lane-v0"')
    exported.write_text(text)
    assert main(["import", str(exported)]) == 2
    assert "of another package: pass --env tests.nothing:lane-v0 to load it" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "cannot be read as XML"),
        ("time,vehicle,type\n0.0,Ego,vehicle\n", "cannot be read as XML, which `export` writes without --format csv"),
        ("<OpenDRIVE/>", "is an OpenDRIVE road, and not a scene of behavexplor's environments"),
        ("<OpenSCENARIO><FileHeader/><Catalog/></OpenSCENARIO>", "is an OpenSCENARIO catalog, and not a scene"),
        (
            "<OpenSCENARIO><FileHeader/><Entities><ScenarioObject><CatalogReference/></ScenarioObject></Entities>"
            "</OpenSCENARIO>",
            "is an OpenSCENARIO file of another program",
        ),
        ("<commonRoad/>", "is a CommonRoad scenario"),
        ("<html/>", "is another XML file"),
        ('<!DOCTYPE x [<!ENTITY a "b">]><OpenSCENARIO>&a;</OpenSCENARIO>', "has entities of its own"),
    ],
)
def test_other_files_are_refused(text, message, tmp_path, capsys):
    path = tmp_path / "scene.xosc"
    path.write_text(text)
    assert main(["import", str(path)]) == 2
    assert message in capsys.readouterr().err


def test_a_missing_library_is_named(monkeypatch, campaign, tmp_path, capsys):
    monkeypatch.setattr(behavexplor.commands.roads, "find_spec", lambda name: None)
    assert main(["export", str(campaign[0]), "--out", str(tmp_path)]) == 2
    assert "needs lxml: install the extra 'scenes'" in capsys.readouterr().err


def test_a_table_has_a_row_for_each_vehicle_and_frame(campaign, tmp_path):
    run, _, _ = campaign
    execution = failures(run)[0]
    assert main(["export", str(run), str(execution.id), "--out", str(tmp_path), "--format", "csv"]) == 0
    with (tmp_path / f"{execution.id:06d}.csv").open() as file:
        rows = list(csv.DictReader(file))
    trace = execution.load_trace()
    assert tuple(rows[0]) == COLUMNS
    assert len(rows) == (trace.present.sum() if trace.present.size else trace.heading.size)
    for i, name in enumerate(["Ego", "NPC1"]):
        own = [row for row in rows if row["vehicle"] == name]
        column = {key: np.array([float(row[key]) for row in own]) for key in COLUMNS if key not in ("vehicle", "type")}
        there = trace.present[:, i] if trace.present.size else slice(None)
        np.testing.assert_allclose(column["time"], trace.time[there], atol=1e-8)
        np.testing.assert_allclose(column["x"], trace.position[there, i, 0], atol=1e-8)
        np.testing.assert_allclose(column["y"], -trace.position[there, i, 1], atol=1e-8)
        np.testing.assert_allclose(column["heading"], -trace.heading[there, i], atol=1e-8)
        np.testing.assert_allclose(column["vy"], -trace.velocity[there, i, 1], atol=1e-8)
        np.testing.assert_allclose([column["length"][0], column["width"][0]], trace.size[i])


def test_the_page_names_every_column_and_the_error_of_a_sine():
    page = (ROOT / "docs" / "exchange.md").read_text()
    assert all(f"| {name} |" in page for name in COLUMNS)
    assert f"{1000 * MAX_ERROR:g} mm" in page
    assert f"{MAX_DEVIATION:g} m" in page


def test_a_damaged_scene_is_a_scenario_or_one_sentence(scene, tmp_path):
    """Elements are removed, attributes removed or replaced at random."""
    _, scenario, trace = scene
    path = tmp_path / "routes.xosc"
    write(path, scenario, trace, as_routes=True)
    rng = np.random.default_rng(0)
    taken = 0
    for _ in range(60):
        root = etree.parse(path).getroot()
        elements = list(root.iter())[1:]
        element = elements[rng.integers(len(elements))]
        keys = sorted(element.keys())
        kind = rng.integers(3) if keys else 0
        if kind == 0:
            element.getparent().remove(element)
        elif kind == 1:
            del element.attrib[keys[rng.integers(len(keys))]]
        else:
            element.set(keys[rng.integers(len(keys))], str(rng.choice(["", "-1", "nan", "1e999", "$", "{}", "\u00b2"])))
        copy = tmp_path / "damaged.xosc"
        copy.write_bytes(etree.tostring(root))
        try:
            taken += isinstance(restored(read_scene(copy), S1), ScriptedScenario)
        except InputError:
            continue
    assert 5 < taken < 55


@pytest.mark.parametrize("env", ["intersection-straight", "merge-v0", "exit-v0"])
def test_roads_beside_a_junction_are_linked_to_it(env, tmp_path):
    """OpenDRIVE 1.7, section 12.4: neither an incoming nor an outgoing road is linked to a connecting road."""
    plan, _ = road_of(DrawnScenario(make_env(env, {}).unwrapped.logical.setup, 0, ()) if "-v" in env else None, env, {})
    write_road(plan, "road", tmp_path / "road.xodr")
    roads = {one.get("id"): one for one in etree.parse(tmp_path / "road.xodr").getroot().iterfind("road")}
    crossing = {number for number, road in roads.items() if road.get("junction") != "-1"}
    assert crossing
    linked = 0
    for number in roads.keys() - crossing:
        for link in roads[number].iterfind("link/*"):
            assert link.get("elementType") == "junction" or link.get("elementId") not in crossing
            linked += link.get("elementType") == "junction"
    assert linked >= 3


def test_a_route_has_its_ends_only_and_its_profile_ends_at_rest(tmp_path):
    scenario = S1.sample(np.random.default_rng(3))
    trace = repeated([scenario], "intersection-straight", "tests.drivers:cruiser")[0]
    write(tmp_path / "scene.xosc", scenario, trace, as_routes=True)
    root = etree.parse(tmp_path / "scene.xosc").getroot()
    routes, profiles = list(root.iter("Route")), list(root.iter("SpeedProfileAction"))
    assert len(routes) == len(profiles) == len(scenario.npcs)
    assert all(len(route.findall("Waypoint")) == 2 for route in routes)
    for profile in profiles:
        before, last = profile.findall("SpeedProfileEntry")[-2:]
        assert float(before.get("speed")) == float(last.get("speed")) == 0
        assert float(last.get("time")) == 1
