"""The elements of OpenSCENARIO XML that a scene may have, and where."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

_CHILDREN: Final = {
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
