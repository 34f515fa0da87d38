"""Scenes as OpenSCENARIO XML 1.2, written by the library scenariogeneration.

Every vehicle has a bounding box, and there are no catalogs. The motion of a vehicle is a trajectory with times.
Properties, whose names begin with "behavexplor:", hold what OpenSCENARIO has no element for.
"""

import json
from datetime import datetime
from pathlib import Path
from typing import Any, Final

import numpy as np
from scenariogeneration import xosc
from scenariogeneration.helpers import prettify

from behavexplor.data.array_types import Floats
from behavexplor.data.conventions import ARRIVAL_DISTANCE
from behavexplor.data.durable import write_durably
from behavexplor.exchange import axes
from behavexplor.exchange.scenes import EGO, Mover, SceneFile, motion_digest

REVISION: Final = 2  # minor revision of OpenSCENARIO XML 1
AUTHOR: Final = "behavexplor"
TIME_LIMIT: Final = "TimeLimit"  # parameter: time at which the storyboard stops [s]
ARRIVAL: Final = "ArrivalDistance"  # parameter: distance from the destination at which the ego has arrived [m]
_HEIGHT: Final = {"school-bus": 3.1}  # heights are not simulated [m]
_CAR_HEIGHT: Final = 1.5  # [m]
_WHEEL: Final = 0.65  # diameter [m]
_TRACK: Final = 0.8  # track, as a share of the width
_STEERING: Final = 0.6  # greatest angle [rad]
_MAX_SPEED, _MAX_ACCELERATION, _MAX_DECELERATION = 60.0, 10.0, 10.0  # [m/s] [m/s2]


def write_scene(scene: SceneFile, path: Path, date: datetime, *, as_routes: bool = False) -> None:
    """Write a scene as an OpenSCENARIO file; scripted vehicles get trajectories, or routes with speed profiles."""
    init, act = xosc.Init(), xosc.Act("motion", _at(0.0))
    entities = xosc.Entities()
    for mover in scene.movers:
        rows = _rows(mover)
        if as_routes and mover.script is not None:
            profile = axes.speed_profile(mover.script)
            rows, actions = rows[:1], _drive(mover, profile)
            digest = motion_digest(_first_speed(mover), rows, mover.route, profile)
        else:
            actions, digest = _follow(mover, rows), motion_digest(_first_speed(mover), rows)
        entities.add_scenario_object(mover.name, _vehicle(mover, digest))
        _begin(init, mover, rows[0])
        group = _group(mover, rows[0], actions)
        if group is not None:
            act.add_maneuver_group(group)
    if scene.is_ego_free:
        init.add_init_action(EGO, xosc.AcquirePositionAction(_point(scene.destination)))
    storyboard = xosc.StoryBoard(init, _stop(scene))
    if act.maneuvergroup:
        storyboard.add_act(act)
    made = xosc.Scenario(
        scene.title,
        AUTHOR,
        _parameters(scene),
        entities,
        storyboard,
        xosc.RoadNetwork(scene.road_file),
        xosc.Catalog(),
        osc_minor_version=REVISION,
        creation_date=date,
        header_properties=_properties(_facts(scene)),
    )
    write_durably(path, prettify(made.get_element(), encoding="utf-8"))


def _facts(scene: SceneFile) -> dict[str, str]:
    facts = {axes.ENVIRONMENT: scene.environment, axes.VEHICLES: str(len(scene.movers))}
    if scene.env_config:
        facts[axes.ENV_CONFIG] = json.dumps(dict(scene.env_config), sort_keys=True)
    if scene.scenario is not None:
        facts[axes.SCENARIO] = scene.scenario.to_json()
    return facts


def _properties(facts: dict[str, str]) -> Any:
    properties = xosc.Properties()
    for name, value in facts.items():
        properties.add_property(name, value)
    return properties


def _parameters(scene: SceneFile) -> Any:
    declared = xosc.ParameterDeclarations()
    values = {TIME_LIMIT: scene.time_limit, **({ARRIVAL: ARRIVAL_DISTANCE} if scene.stops_there else {})}
    for name, value in values.items():
        declared.add_parameter(xosc.Parameter(name, xosc.ParameterType.double, str(value)))
    return declared


def _vehicle(mover: Mover, digest: str) -> Any:
    """Return a vehicle whose reference point is the middle of its rear axle."""
    length, width = mover.size
    height = _HEIGHT.get(mover.type, _CAR_HEIGHT)
    ahead, track = _rounded(axes.REAR_AXLE * length), _rounded(_TRACK * width)
    category = xosc.VehicleCategory.bus if mover.type.endswith("bus") else xosc.VehicleCategory.car
    made = xosc.Vehicle(
        mover.type,
        category,
        xosc.BoundingBox(width, length, height, ahead, 0.0, height / 2),
        xosc.Axle(_STEERING, _WHEEL, track, 2 * ahead, _WHEEL / 2),
        xosc.Axle(0.0, _WHEEL, track, 0.0, _WHEEL / 2),
        _MAX_SPEED,
        _MAX_ACCELERATION,
        _MAX_DECELERATION,
    )
    if mover.script is not None:
        made.add_property(axes.ROUTE, mover.script.route)
        made.add_property(axes.WAYPOINTS, axes.waypoint_text(mover.script))
    made.add_property(axes.RECORDED, digest)
    return made


def _rows(mover: Mover) -> Floats:
    """Return time, x, y and heading of a vehicle's reference point as they are written, shape (T, 4).

    The points between two equal ones, at which the vehicle stands, are left out.
    """
    pose = axes.mirrored(axes.shifted(mover.pose, -axes.REAR_AXLE * mover.size[0]))
    pose[:, 2] = (pose[:, 2] + np.pi) % (2 * np.pi) - np.pi
    same = (np.diff(mover.pose, axis=0) == 0).all(1)
    standing = np.concatenate([[False], same[:-1] & same[1:], [False]]) if len(same) else np.zeros(1, dtype=bool)
    rows = np.round(np.column_stack([mover.time, pose]), axes.DIGITS) + 0.0  # no negative zeros
    return np.asarray(rows[~standing])


def _first_speed(mover: Mover) -> float:
    """Return the speed with which a vehicle begins; 0 if it appears later, since the file cannot say it."""
    return _rounded(mover.speed) if mover.time[0] == 0 else 0.0


def _begin(init: Any, mover: Mover, row: Floats) -> None:
    """Place a vehicle that is there from the beginning."""
    if row[0] > 0:
        return
    init.add_init_action(mover.name, xosc.TeleportAction(_place(row)))
    step = xosc.TransitionDynamics(xosc.DynamicsShapes.step, xosc.DynamicsDimension.time, 0)
    init.add_init_action(mover.name, xosc.AbsoluteSpeedAction(_first_speed(mover), step))


def _follow(mover: Mover, rows: Floats) -> list[tuple[str, Any]]:
    """Return the action that follows the trajectory of a vehicle, with its name; none if it has a single point."""
    if len(rows) < 2:
        return []
    trajectory = xosc.Trajectory(f"trajectory of {mover.name}", closed=False)
    trajectory.add_shape(xosc.Polyline(rows[:, 0].tolist(), [_place(row) for row in rows]))
    mode, absolute = xosc.FollowingMode.position, xosc.ReferenceContext.absolute
    return [(f"{mover.name} drives", xosc.FollowTrajectoryAction(trajectory, mode, absolute, 1, 0))]


def _drive(mover: Mover, profile: Floats) -> list[tuple[str, Any]]:
    """Return the actions that drive a scripted vehicle along its route, with their names."""
    route = xosc.Route(f"route of {mover.name}")
    for x, y in mover.route.tolist():
        route.add_waypoint(xosc.WorldPosition(x, y), xosc.RouteStrategy.shortest)
    speeds, durations = profile.T.tolist()
    keeping = xosc.SpeedProfileAction(speeds, xosc.FollowingMode.position, durations)
    taking = xosc.AssignRouteAction(route)
    return [(f"{mover.name} takes its route", taking), (f"{mover.name} keeps its speeds", keeping)]


def _group(mover: Mover, row: Floats, actions: list[tuple[str, Any]]) -> Any:
    """Return the maneuver group of a vehicle: it appears, moves and leaves; None if it does none of these."""
    maneuver = xosc.Maneuver(f"maneuver of {mover.name}")
    begin, end = float(row[0]), float(mover.time[-1])
    if begin > 0:
        actions = [(f"{mover.name} appears", xosc.AddEntityAction(mover.name, _place(row))), *actions]
    for name, action in actions:
        maneuver.add_event(_event(name, action, begin))
    if mover.is_gone:
        maneuver.add_event(_event(f"{mover.name} leaves", xosc.DeleteEntityAction(mover.name), end))
    if not maneuver.events:
        return None
    group = xosc.ManeuverGroup(f"group of {mover.name}")
    group.add_actor(mover.name)
    group.add_maneuver(maneuver)
    return group


def _event(name: str, action: Any, time: float) -> Any:
    event = xosc.Event(name, xosc.Priority.parallel)
    event.add_action(name, action)
    event.add_trigger(_at(time))
    return event


def _at(time: float) -> Any:
    condition = xosc.SimulationTimeCondition(_rounded(time), xosc.Rule.greaterOrEqual)
    return xosc.ValueTrigger(f"at {time:g} s", 0, xosc.ConditionEdge.none, condition)


def _stop(scene: SceneFile) -> Any:
    """Return the trigger that stops the storyboard: a collision of the ego, its arrival, or the time limit."""
    limit = xosc.SimulationTimeCondition(f"${TIME_LIMIT}", xosc.Rule.greaterOrEqual)
    conditions = [xosc.ValueTrigger("time limit", 0, xosc.ConditionEdge.none, limit, "stop")]
    events = {f"collision with {mover.name}": xosc.CollisionCondition(mover.name) for mover in scene.movers[1:]}
    if scene.stops_there:
        events["arrival"] = xosc.DistanceCondition(
            f"${ARRIVAL}",
            xosc.Rule.lessOrEqual,
            _point(scene.destination),
            freespace=False,
            distance_type=xosc.RelativeDistanceType.euclidianDistance,
            coordinate_system=xosc.CoordinateSystem.entity,
        )
    for name, event in events.items():
        edge = xosc.ConditionEdge.none
        conditions.append(xosc.EntityTrigger(name, 0, edge, event, EGO, triggeringpoint="stop"))
    trigger = xosc.Trigger("stop")
    for condition in conditions:
        group = xosc.ConditionGroup("stop")
        group.add_condition(condition)
        trigger.add_conditiongroup(group)
    return trigger


def _place(row: Floats) -> Any:
    _, x, y, heading = row.tolist()
    return xosc.WorldPosition(x, y, h=heading)


def _point(point: Floats) -> Any:
    x, y = axes.mirrored_points(point).tolist()
    return xosc.WorldPosition(_rounded(x), _rounded(y))


def _rounded(value: float) -> float:
    return round(value, axes.DIGITS) + 0.0  # no negative zero
