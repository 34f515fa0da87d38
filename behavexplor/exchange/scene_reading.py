"""Reading of scenes from OpenSCENARIO XML files of the subset that `behavexplor.exchange.openscenario` writes.

Every element of a file must be one that is known here, so that nothing is left out silently.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np

from behavexplor.data.array_types import Floats
from behavexplor.data.scenario import parse_scenario
from behavexplor.data.untrusted import parse_json
from behavexplor.errors import InputError, brief
from behavexplor.exchange import axes, scenes
from behavexplor.exchange.scenes import EGO, Mover, SceneFile, motion_digest, scenario_digest
from behavexplor.exchange.xml_files import Element, read_xml

_CHILDREN: Final = {  # the elements that a scene may have, by the element that contains them
    "OpenSCENARIO": "FileHeader ParameterDeclarations CatalogLocations RoadNetwork Entities Storyboard",
    "FileHeader": "License Properties",
    "Properties": "Property",
    "ParameterDeclarations": "ParameterDeclaration",
    "RoadNetwork": "LogicFile",
    "Entities": "ScenarioObject",
    "ScenarioObject": "Vehicle",
    "Vehicle": "ParameterDeclarations BoundingBox Performance Axles Properties",
    "BoundingBox": "Center Dimensions",
    "Axles": "FrontAxle RearAxle",
    "Storyboard": "Init Story StopTrigger",
    "Init": "Actions",
    "Actions": "Private",
    "Private": "PrivateAction",
    "PrivateAction": "TeleportAction LongitudinalAction RoutingAction",
    "TeleportAction": "Position",
    "Position": "WorldPosition",
    "LongitudinalAction": "SpeedAction SpeedProfileAction",
    "SpeedAction": "SpeedActionDynamics SpeedActionTarget",
    "SpeedActionTarget": "AbsoluteTargetSpeed",
    "SpeedProfileAction": "SpeedProfileEntry",
    "RoutingAction": "AcquirePositionAction AssignRouteAction FollowTrajectoryAction",
    "AcquirePositionAction": "Position",
    "AssignRouteAction": "Route",
    "Route": "ParameterDeclarations Waypoint",
    "Waypoint": "Position",
    "FollowTrajectoryAction": "TrajectoryRef TimeReference TrajectoryFollowingMode",
    "TrajectoryRef": "Trajectory",
    "Trajectory": "ParameterDeclarations Shape",
    "Shape": "Polyline",
    "Polyline": "Vertex",
    "Vertex": "Position",
    "TimeReference": "Timing",
    "Story": "ParameterDeclarations Act",
    "Act": "ManeuverGroup StartTrigger StopTrigger",
    "ManeuverGroup": "Actors Maneuver",
    "Actors": "EntityRef",
    "Maneuver": "ParameterDeclarations Event",
    "Event": "Action StartTrigger",
    "Action": "PrivateAction GlobalAction",
    "GlobalAction": "EntityAction",
    "EntityAction": "AddEntityAction DeleteEntityAction",
    "AddEntityAction": "Position",
    "StartTrigger": "ConditionGroup",
    "StopTrigger": "ConditionGroup",
    "ConditionGroup": "Condition",
    "Condition": "ByValueCondition ByEntityCondition",
    "ByValueCondition": "SimulationTimeCondition",
    "ByEntityCondition": "TriggeringEntities EntityCondition",
    "TriggeringEntities": "EntityRef",
    "EntityCondition": "CollisionCondition DistanceCondition",
    "CollisionCondition": "EntityRef",
    "DistanceCondition": "Position",
}
_LEAVES: Final = frozenset(name for names in _CHILDREN.values() for name in names.split()) - _CHILDREN.keys()

KNOWN: Final[Mapping[str, frozenset[str]]] = MappingProxyType(  # the elements that each element may contain
    {name: frozenset(children.split()) for name, children in _CHILDREN.items()} | dict.fromkeys(_LEAVES, frozenset())
)

_ROOT: Final = "OpenSCENARIO"
_KINDS: Final = MappingProxyType(  # of other files, by their roots
    {
        _ROOT: "an OpenSCENARIO file of another program, or for CARLA",
        "OpenDRIVE": "an OpenDRIVE road",
        "commonRoad": "a CommonRoad scenario",
    }
)
_FROM_THEN_ON: Final = ("greaterThan", "greaterOrEqual", "equalTo")
_SAME_TIME: Final = 1e-6  # [s]
_SAME_PLACE: Final = 0.01  # greatest distance between a start and the first point of a trajectory [m]


def read_scene(path: Path) -> SceneFile:
    """Read a scene.

    Raises:
        InputError: if the file is not an OpenSCENARIO XML file, or has something that cannot be taken; the message
            names it.
    """
    root = _parsed(path)
    facts = _properties(root.find("FileHeader"))
    scenario = parse_scenario(facts[scenes.SCENARIO]) if scenes.SCENARIO in facts else None
    if scenario is not None and scenes.ENV_CONFIG in facts and _config(facts[scenes.ENV_CONFIG]):
        raise InputError(f"The property {scenes.ENV_CONFIG} cannot be given: {scenes.SCENARIO} has the configuration")
    n_vehicles = int(facts[scenes.VEHICLES]) if re.fullmatch(r"\d{1,9}", facts.get(scenes.VEHICLES, "")) else 0
    motions = {name: _Motion(name) for name in _names(root)}
    for private in root.iterfind("Storyboard/Init/Actions/Private"):
        _motion(motions, private.get("entityRef"), private).begin(private)
    for act in root.iterfind("Storyboard/Story/Act"):
        _take_act(motions, act)
    movers = tuple(_mover(entity, motions[entity.get("name")]) for entity in root.iterfind("Entities/ScenarioObject"))
    if not movers or movers[0].name != EGO:
        raise InputError(f"{path}: its first entity must be the vehicle named {EGO}")
    road = root.find("RoadNetwork/LogicFile")
    return SceneFile(
        title=root.find("FileHeader").get("description", ""),
        environment=facts[scenes.ENVIRONMENT],
        env_config=_config(facts.get(scenes.ENV_CONFIG, "{}")),
        road_file="" if road is None else road.get("filepath", ""),
        movers=movers,
        is_ego_free=len(movers[0].time) == 1,
        scenario=scenario,
        n_vehicles=n_vehicles,
        is_changed=scenario is not None and facts.get(scenes.RECORDED) != scenario_digest(scenario, n_vehicles),
    )


def _take_act(motions: dict[str, "_Motion"], act: Element) -> None:
    trigger = _trigger(act)
    for group in act.iterfind("ManeuverGroup"):
        if group.get("maximumExecutionCount", "1") != "1":
            raise _refused(group, "a maximumExecutionCount other than 1")
        actors = [_motion(motions, actor.get("entityRef"), actor) for actor in group.iterfind("Actors/EntityRef")]
        for event in group.iterfind("Maneuver/Event"):
            latest = max(_trigger(event), trigger, key=lambda one: one.time)
            for entity in event.iterfind("Action/GlobalAction/EntityAction"):
                _motion(motions, entity.get("entityRef"), entity).appear_or_leave(entity, latest.time)
            for actor in actors:
                actor.add(event, latest)


def _parsed(path: Path) -> Element:
    """Return the root of a file, in which all references to parameters are replaced by their values."""
    root = read_xml(path)
    header = root.find("FileHeader")
    if root.tag != _ROOT or header is None or scenes.ENVIRONMENT not in _properties(header):
        is_catalog = root.find("Catalog") is not None
        kind = "an OpenSCENARIO catalog" if is_catalog else _KINDS.get(root.tag, "another XML file")
        raise InputError(
            f"{path} is {kind}, and not a scene of behavexplor's environments: only what `behavexplor export` has "
            f"written in OpenSCENARIO 1.2 can be taken, also if it was changed since. The FileHeader of such a file "
            f"has the property {scenes.ENVIRONMENT}"
        )
    _check_known(root)
    _insert_parameters(root)
    return root


def _check_known(element: Element) -> None:
    """Refuse an element that is not known in its place."""
    for child in element:
        if child.tag not in KNOWN[element.tag]:
            raise _refused(child, f"{child.tag} in {element.tag}")
        _check_known(child)


def _insert_parameters(root: Element) -> None:
    declared = {one.get("name"): one.get("value", "") for one in root.iterfind("ParameterDeclarations/*")}
    for element in root.iter():
        for key, value in element.items():
            if value.startswith("$"):
                if value[1:] not in declared:
                    raise _refused(element, f"{key}={value!r} (an expression, or a parameter that is not declared)")
                element.set(key, declared[value[1:]])


def _refused(element: Element, what: str) -> InputError:
    return InputError(f"Line {element.sourceline}: {what} cannot be taken; docs/exchange.md lists what can")


def _properties(parent: Element) -> dict[str, str]:
    return {one.get("name", ""): one.get("value", "") for one in parent.iterfind("Properties/Property")}


def _one(parent: Element, path: str) -> Element:
    """Return the element at a path."""
    found = parent.find(path)
    if found is None:
        raise _refused(parent, f"{parent.tag} without {path}")
    return found


def _names(root: Element) -> list[str]:
    names = [entity.get("name", "") for entity in root.iterfind("Entities/ScenarioObject")]
    twice = [name for i, name in enumerate(names) if name in names[:i]]
    if twice:
        raise InputError(f"Two entities are named {brief(twice[0])}: give each a name of its own")
    return names


def _motion(motions: dict[str, "_Motion"], name: str | None, element: Element) -> "_Motion":
    if name not in motions:
        raise _refused(element, f"the entity {brief(name)}, which is not declared,")
    return motions[name]


def _config(text: str) -> dict[str, Any]:
    values = parse_json(text, "a configuration")
    if not isinstance(values, dict):
        raise InputError(f"The property {scenes.ENV_CONFIG} must be an object in JSON, got {brief(values)}")
    return values


class _Motion:
    """What a file says of the motion of one entity.

    Attributes:
        name: name of the entity.
        speed: speed at the beginning [m/s].
        start: time, x, y and heading at the beginning as they are written, shape (4,).
        trajectory: the same of each point of the trajectory, shape (T, 4); None without one.
        route: x and y of each point of the route.
        profile: speed [m/s] and duration [s] of each entry of the speed profile.
        leaves: whether the entity is deleted.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.speed = 0.0
        self.start: Floats | None = None
        self.trajectory: Floats | None = None
        self.route: list[list[float]] = []
        self.profile: list[list[float]] = []
        self.leaves = False

    def begin(self, private: Element) -> None:
        """Take the actions at the start."""
        for action in private.iterfind("PrivateAction"):
            if (place := action.find("TeleportAction/Position/WorldPosition")) is not None:
                self.start = np.array([0.0, *_pose(place)])
            elif (speed := action.find("LongitudinalAction/SpeedAction/SpeedActionTarget/*")) is not None:
                self.speed = _number(speed, "value")
            elif action.find("RoutingAction/AcquirePositionAction") is None or self.name != EGO:
                raise _refused(action, f"this action of {self.name} at the start")

    def appear_or_leave(self, entity: Element, time: float) -> None:
        """Take an action by which the entity appears or leaves at a time [s]."""
        self.leaves |= entity.find("DeleteEntityAction") is not None
        for place in entity.iterfind("AddEntityAction/Position/WorldPosition"):
            self.start = np.array([time, *_pose(place)])

    def add(self, event: Element, trigger: "_Trigger") -> None:
        """Take the entity's own actions in an event."""
        for follow in event.iterfind("Action/PrivateAction/RoutingAction/FollowTrajectoryAction"):
            if self.trajectory is not None:
                raise _refused(follow, f"a second trajectory of {self.name}")
            if follow.get("initialDistanceOffset") is not None and _number(follow, "initialDistanceOffset") != 0:
                raise _refused(follow, "an initialDistanceOffset")
            self.trajectory = _rows(follow, trigger)
        driving = event.find("Action/PrivateAction/RoutingAction/AssignRouteAction/Route")
        for place in () if driving is None else driving.iterfind("Waypoint/Position/WorldPosition"):
            self.route.append([_number(place, "x"), _number(place, "y")])
        for entry in event.iterfind("Action/PrivateAction/LongitudinalAction/SpeedProfileAction/SpeedProfileEntry"):
            self.profile.append([_number(entry, "speed"), _number(entry, "time")])
        known, moved = ("RoutingAction", "LongitudinalAction/SpeedProfileAction"), "RoutingAction/AcquirePositionAction"
        for action in event.iterfind("Action/PrivateAction"):
            if all(action.find(name) is None for name in known) or action.find(moved) is not None:
                raise _refused(action, f"this action of {self.name} during the scene")

    @property
    def rows(self) -> Floats:
        """Time, x, y and heading of each point as they are written, shape (T, 4)."""
        if self.start is None:
            raise InputError(f"{self.name} is nowhere: it needs a TeleportAction to a WorldPosition at the start")
        if self.trajectory is None:
            return self.start[None]
        if math.dist(self.start[1:3], self.trajectory[0, 1:3]) > _SAME_PLACE:
            raise InputError(f"{self.name} begins at another place than its trajectory: change both or neither")
        return self.trajectory


class _Trigger(NamedTuple):
    """When an act or an event starts."""

    time: float  # [s]
    condition: Element  # the condition that says so


def _trigger(element: Element) -> _Trigger:
    """Return when an act or an event starts."""
    conditions = list(element.iterfind("StartTrigger/ConditionGroup/Condition"))
    values = [condition.find("ByValueCondition/SimulationTimeCondition") for condition in conditions]
    if len(values) != 1 or values[0] is None or values[0].get("rule") not in _FROM_THEN_ON:
        raise _refused(element, f"the start of this {element.tag}, which is not at a simulation time,")
    return _Trigger(_number(values[0], "value") + _number(conditions[0], "delay"), values[0])


def _rows(follow: Element, trigger: _Trigger) -> Floats:
    trajectory = follow.find("TrajectoryRef/Trajectory")
    timing = follow.find("TimeReference/Timing")
    vertices = [] if trajectory is None else list(trajectory.iterfind("Shape/Polyline/Vertex"))
    if timing is None or not vertices:
        raise _refused(follow, "a trajectory that is not a polyline with times")
    if trajectory.get("closed", "false") not in ("false", "0"):
        raise _refused(follow, "a closed trajectory")
    rows = np.array([[_number(vertex, "time"), *_pose(_one(vertex, "Position/WorldPosition"))] for vertex in vertices])
    with np.errstate(over="ignore", invalid="ignore"):  # such times are refused below
        rows[:, 0] = rows[:, 0] * _number(timing, "scale") + _number(timing, "offset")
    if timing.get("domainAbsoluteRelative") == "relative":
        rows[:, 0] += trigger.time
    if not np.isfinite(rows).all() or (np.diff(rows[:, 0]) <= 0).any():
        raise _refused(follow, "a trajectory whose times do not increase")
    if trigger.time > rows[0, 0] + _SAME_TIME:
        raise _refused(trigger.condition, f"a start at {trigger.time:g} s, after the beginning of the trajectory,")
    return rows


def _pose(place: Element) -> tuple[float, float, float]:
    heading = _number(place, "h") if place.get("h") is not None else 0.0
    return _number(place, "x"), _number(place, "y"), heading


def _number(element: Element, name: str) -> float:
    text = element.get(name)
    try:
        value = float(text)
    except (TypeError, ValueError):
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"Line {element.sourceline}: {name} of {element.tag} must be a number, got {brief(text)}")
    return value


def _mover(entity: Element, motion: _Motion) -> Mover:
    vehicle = _one(entity, "Vehicle")
    center, box = (_one(vehicle, f"BoundingBox/{part}") for part in ("Center", "Dimensions"))
    facts, rows = _properties(vehicle), motion.rows
    kind = str(vehicle.get("name", ""))
    script = None
    if scenes.ROUTE in facts:
        waypoints = facts.get(scenes.WAYPOINTS, "")
        script = scenes.read_script(motion.name, kind, facts[scenes.ROUTE], waypoints)
    ahead, aside = _number(center, "x"), _number(center, "y")
    mover = Mover(
        name=motion.name,
        type=kind,
        size=(_number(box, "length"), _number(box, "width")),
        time=rows[:, 0],
        pose=axes.shifted(axes.mirrored(rows[:, 1:]), ahead),
        speed=motion.speed,
        is_gone=motion.leaves,
        script=script,
        center=(ahead, aside),
    )
    digest = motion_digest(mover, rows, np.array(motion.route), np.array(motion.profile))
    return replace(mover, is_changed=facts.get(scenes.RECORDED, "" if script is None else digest) != digest)
