"""Scenes as OpenSCENARIO XML 1.2, or 1.0 for CARLA's ScenarioRunner, written by the library scenariogeneration.

Every vehicle has a bounding box, and there are no catalogs. The motion of a vehicle is a trajectory with times.
In 1.2, properties, whose names begin with "behavexplor:", hold what OpenSCENARIO has no element for.
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np
from scenariogeneration import xosc
from scenariogeneration.helpers import prettify

from behavexplor.data.array_types import Floats
from behavexplor.data.conventions import ARRIVAL_DISTANCE
from behavexplor.data.durable import write_durably
from behavexplor.data.npc_motion import BEGIN, N_PHASE_COLUMNS, PHASE_SPEED, fill_phases, waypoint_array
from behavexplor.data.scripted import NPC
from behavexplor.exchange import axes, scenes
from behavexplor.exchange.scenes import EGO, Mover, SceneFile, motion_digest, scenario_digest

AUTHOR: Final = "behavexplor"
TIME_LIMIT: Final = "TimeLimit"  # parameter: time at which the storyboard stops [s]
ARRIVAL: Final = "ArrivalDistance"  # parameter: distance from the destination at which the ego has arrived [m]
_HEIGHT: Final = {"school-bus": 3.1}  # heights are not simulated [m]
_CAR_HEIGHT: Final = 1.5  # [m]
_WHEEL: Final = 0.65  # diameter [m]
_TRACK: Final = 0.8  # track, as a share of the width
_SETTLING: Final = 1.0  # time after which a standing vehicle has a second point [s]
_STEERING: Final = 0.6  # greatest angle [rad]
_MAX_SPEED, _MAX_ACCELERATION, _MAX_DECELERATION = 60.0, 10.0, 10.0  # [m/s] [m/s2]
_BLUEPRINTS: Final[Mapping[str, str]] = MappingProxyType(  # CARLA's vehicles for the types of scripted ones
    {
        "sedan": "vehicle.tesla.model3",
        "suv": "vehicle.audi.etron",
        "jeep": "vehicle.jeep.wrangler_rubicon",
        "hatchback": "vehicle.nissan.micra",
        "school-bus": "vehicle.mitsubishi.fusorosa",
    }
)
_BLUEPRINT: Final = "vehicle.lincoln.mkz_2017"  # for all others: the ego has the size of a Lincoln MKZ


class Dialect(NamedTuple):
    """What distinguishes the files for some players from those for others."""

    revision: int  # minor revision of OpenSCENARIO XML 1
    axle: float  # distance of a vehicle's reference point behind its center, as a share of its length
    since: Any  # rule by which a time has come
    within: Any  # rule by which a distance is short enough


STANDARD: Final = Dialect(2, axes.REAR_AXLE, xosc.Rule.greaterOrEqual, xosc.Rule.lessOrEqual)
CARLA: Final = Dialect(0, 0.0, xosc.Rule.greaterThan, xosc.Rule.lessThan)  # ScenarioRunner moves centers of vehicles


def write_scene(
    scene: SceneFile, path: Path, date: datetime, *, as_routes: bool = False, dialect: Dialect = STANDARD
) -> None:
    """Write a scene as an OpenSCENARIO file; scripted vehicles get trajectories, or routes with speed profiles.

    The date stands in the header. For CARLA, no vehicle may appear or leave, and `as_routes` must be False.
    """
    stop = _stop(scene, dialect)
    init, entities = xosc.Init(), xosc.Entities()
    act = xosc.Act("motion", _at(0.0, dialect), stop if dialect is CARLA else None)  # ScenarioRunner stops acts only
    for mover in scene.movers:
        rows = _rows(mover, dialect)
        speed = _rounded(mover.speed) if mover.time[0] == 0 else 0.0  # the file has none for one that appears later
        written = replace(mover, speed=speed, center=(_rounded(dialect.axle * mover.size[0]), 0.0))
        if as_routes and mover.script is not None:
            profile = _speed_profile(mover.script)
            rows = rows[:1]
            actions = _drive(mover, profile)
            digest = motion_digest(written, rows, mover.route, profile)
        else:
            actions = _follow(mover, rows)
            digest = motion_digest(written, rows)
        entities.add_scenario_object(mover.name, _vehicle(written, digest, dialect))
        _begin(init, written, rows[0])
        if scene.is_ego_free and mover.name == EGO:
            actions = _reach(init, scene.destination, dialect)
        group = _group(mover, rows[0], actions, dialect)
        if group is not None:
            act.add_maneuver_group(group)
    storyboard = xosc.StoryBoard(init, stop)
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
        osc_minor_version=dialect.revision,
        creation_date=date,
        header_properties=_properties(_facts(scene)) if dialect is STANDARD else None,
    )
    write_durably(path, prettify(made.get_element(), encoding="utf-8"))


def _facts(scene: SceneFile) -> dict[str, str]:
    facts = {scenes.ENVIRONMENT: scene.environment, scenes.VEHICLES: str(len(scene.movers))}
    if scene.env_config:
        facts[scenes.ENV_CONFIG] = json.dumps(dict(scene.env_config), sort_keys=True)
    if scene.scenario is not None:
        facts[scenes.SCENARIO] = scene.scenario.to_json()
        facts[scenes.RECORDED] = scenario_digest(scene.scenario, len(scene.movers))
    return facts


def _properties(facts: dict[str, str]) -> Any:
    made = xosc.Properties()
    for name, value in facts.items():
        made.add_property(name, value)
    return made


def _parameters(scene: SceneFile) -> Any:
    declared = xosc.ParameterDeclarations()
    values = {TIME_LIMIT: scene.time_limit, **({ARRIVAL: ARRIVAL_DISTANCE} if scene.stops_there else {})}
    for name, value in values.items():
        declared.add_parameter(xosc.Parameter(name, xosc.ParameterType.double, str(value)))
    return declared


def _vehicle(mover: Mover, digest: str, dialect: Dialect) -> Any:
    """Return a vehicle whose reference point is the middle of its rear axle, or its center for CARLA."""
    length, width = mover.size
    height = _HEIGHT.get(mover.type, _CAR_HEIGHT)
    rear, track = (dialect.axle - axes.REAR_AXLE) * length, _rounded(_TRACK * width)  # from the reference point
    category = xosc.VehicleCategory.bus if mover.type.endswith("bus") else xosc.VehicleCategory.car
    made = xosc.Vehicle(
        mover.type if dialect is STANDARD else _BLUEPRINTS.get(mover.type, _BLUEPRINT),
        category,
        xosc.BoundingBox(width, length, height, *mover.center, height / 2),
        xosc.Axle(_STEERING, _WHEEL, track, _rounded(rear + 2 * axes.REAR_AXLE * length), _WHEEL / 2),
        xosc.Axle(0.0, _WHEEL, track, _rounded(rear), _WHEEL / 2),
        _MAX_SPEED,
        _MAX_ACCELERATION,
        _MAX_DECELERATION,
    )
    if dialect is CARLA:
        made.add_property("type", "ego_vehicle" if mover.name == EGO else "simulation")
        return made
    if mover.script is not None:
        made.add_property(scenes.ROUTE, mover.script.route)
        made.add_property(scenes.WAYPOINTS, scenes.waypoint_text(mover.script))
    made.add_property(scenes.RECORDED, digest)
    return made


def _rows(mover: Mover, dialect: Dialect) -> Floats:
    """Return time, x, y and heading of a vehicle's reference point as they are written, shape (T, 4).

    Of the points at which the vehicle stands, the first, the one a second later and the last are written: players that
    smooth a trajectory would let it creep from the first to the last.
    """
    pose = axes.mirrored(axes.shifted(mover.pose, -dialect.axle * mover.size[0]))
    pose[:, 2] = (pose[:, 2] + np.pi) % (2 * np.pi) - np.pi
    stands = np.concatenate([[False], (np.diff(mover.pose, axis=0) == 0).all(1), [False]])  # since the point before
    since = np.maximum.accumulate(np.where(stands[:-1], -np.inf, mover.time))  # when it came to where it is
    settled = mover.time - since >= _SETTLING
    first_settled = settled & ~np.concatenate([[False], settled[:-1]])
    left_out = stands[:-1] & stands[1:] & ~first_settled
    rows = np.round(np.column_stack([mover.time, pose]), axes.DIGITS) + 0.0  # no negative zeros
    return np.asarray(rows[~left_out])


def _begin(init: Any, mover: Mover, row: Floats) -> None:
    """Place a vehicle that is there from the beginning."""
    if row[0] > 0:
        return
    init.add_init_action(mover.name, xosc.TeleportAction(_place(row)))
    step = xosc.TransitionDynamics(xosc.DynamicsShapes.step, xosc.DynamicsDimension.time, 0)
    init.add_init_action(mover.name, xosc.AbsoluteSpeedAction(mover.speed, step))


def _follow(mover: Mover, rows: Floats) -> list[tuple[str, Any]]:
    """Return the action that follows the trajectory of a vehicle, with its name; none if it has a single point."""
    if len(rows) < 2:
        return []
    trajectory = xosc.Trajectory(f"trajectory of {mover.name}", closed=False)
    trajectory.add_shape(xosc.Polyline(rows[:, 0].tolist(), [_place(row) for row in rows]))
    mode, absolute = xosc.FollowingMode.position, xosc.ReferenceContext.absolute
    return [(f"{mover.name} drives", xosc.FollowTrajectoryAction(trajectory, mode, absolute, 1, 0))]


def _reach(init: Any, destination: Floats, dialect: Dialect) -> list[tuple[str, Any]]:
    """Let a free ego drive to its destination: by an initial action, or for CARLA by the returned action with its name.

    ScenarioRunner would start the ego at the destination of an initial action.
    """
    reaching = xosc.AcquirePositionAction(_point(destination))
    if dialect is CARLA:
        return [(f"{EGO} drives to its destination", reaching)]
    init.add_init_action(EGO, reaching)
    return []


def _speed_profile(npc: NPC) -> Floats:
    """Return the speed at the end of each phase [m/s] and the duration of the phase [s], shape (P, 2).

    A last phase of one second is added, in which the vehicle stands: a player might go on with the last deceleration.
    """
    waypoints = waypoint_array(npc)
    table = np.empty((len(waypoints) + 1, N_PHASE_COLUMNS))
    n_phases = fill_phases(waypoints, table)
    phases = table[:n_phases]
    profile = np.column_stack([phases[1:, PHASE_SPEED], np.diff(phases[:, BEGIN])])
    profile = np.concatenate([profile, [[0.0, 1.0]]])
    return np.asarray(np.round(profile, axes.DIGITS))


def _drive(mover: Mover, profile: Floats) -> list[tuple[str, Any]]:
    """Return the actions that drive a scripted vehicle along its route, with their names."""
    route = xosc.Route(f"route of {mover.name}")
    for x, y in mover.route.tolist():
        route.add_waypoint(xosc.WorldPosition(x, y), xosc.RouteStrategy.shortest)
    speeds, durations = profile.T.tolist()
    keeping = xosc.SpeedProfileAction(speeds, xosc.FollowingMode.position, durations)
    taking = xosc.AssignRouteAction(route)
    return [(f"{mover.name} takes its route", taking), (f"{mover.name} keeps its speeds", keeping)]


def _group(mover: Mover, row: Floats, actions: list[tuple[str, Any]], dialect: Dialect) -> Any:
    """Return the maneuver group of a vehicle: it appears, moves and leaves; None if it does none of these."""
    maneuver = xosc.Maneuver(f"maneuver of {mover.name}")
    begin, end = float(row[0]), float(mover.time[-1])
    if begin > 0:
        actions = [(f"{mover.name} appears", xosc.AddEntityAction(mover.name, _place(row))), *actions]
    for name, action in actions:
        maneuver.add_event(_event(name, action, begin, dialect))
    if mover.is_gone:
        maneuver.add_event(_event(f"{mover.name} leaves", xosc.DeleteEntityAction(mover.name), end, dialect))
    if not maneuver.events:
        return None
    group = xosc.ManeuverGroup(f"group of {mover.name}")
    group.add_actor(mover.name)
    group.add_maneuver(maneuver)
    return group


def _event(name: str, action: Any, time: float, dialect: Dialect) -> Any:
    event = xosc.Event(name, xosc.Priority.parallel)
    event.add_action(name, action)
    event.add_trigger(_at(time, dialect))
    return event


def _at(time: float, dialect: Dialect) -> Any:
    condition = xosc.SimulationTimeCondition(_rounded(time), dialect.since)
    return xosc.ValueTrigger(f"at {time:g} s", 0, xosc.ConditionEdge.none, condition)


def _stop(scene: SceneFile, dialect: Dialect) -> Any:
    """Return the trigger that stops the storyboard: a collision of the ego, its arrival, or the time limit."""
    limit = xosc.SimulationTimeCondition(f"${TIME_LIMIT}", dialect.since)
    conditions = [xosc.ValueTrigger("time limit", 0, xosc.ConditionEdge.none, limit, "stop")]
    events = {f"collision with {mover.name}": xosc.CollisionCondition(mover.name) for mover in scene.movers[1:]}
    if scene.stops_there:
        events["arrival"] = xosc.DistanceCondition(
            f"${ARRIVAL}",
            dialect.within,
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
