"""Traits of highway-env's vehicles and obstacles: how they drive, as far as it does not change in an episode.

The parameters of their classes, which an environment may change, are kept apart for each environment.
"""

import inspect
import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, Final

import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.utils import class_from_path
from highway_env.vehicle.behavior import IDMVehicle, LinearVehicle
from highway_env.vehicle.controller import MDPVehicle
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import Obstacle, RoadObject

from behavexplor.envs.engine.state import IDM, LINEAR, MDP, OBSTACLE, PLAIN, TRAITS, Traits
from behavexplor.envs.source_gate import replaced
from behavexplor.errors import InputError

_CLASSES: Final[dict[int, type[RoadObject]]] = {
    PLAIN: Vehicle,
    MDP: MDPVehicle,
    IDM: IDMVehicle,
    LINEAR: LinearVehicle,
    OBSTACLE: Obstacle,
}
_PARAMETERS: Final = {  # fields of `TRAITS`, and their names in highway-env
    "max_acceleration": "ACC_MAX",
    "comfort_acceleration": "COMFORT_ACC_MAX",
    "comfort_braking": "COMFORT_ACC_MIN",
    "distance_wanted": "DISTANCE_WANTED",
    "time_wanted": "TIME_WANTED",
    "delta": "DELTA",
    "politeness": "POLITENESS",
    "min_gain": "LANE_CHANGE_MIN_ACC_GAIN",
    "max_braking": "LANE_CHANGE_MAX_BRAKING_IMPOSED",
    "lane_change_delay": "LANE_CHANGE_DELAY",
}
TRAFFIC_PARAMETERS: Final = frozenset(  # parameters that are read from the classes of the traffic
    {*_PARAMETERS.values(), "DELTA_RANGE", "ACCELERATION_PARAMETERS", "STEERING_PARAMETERS"}
)
_CHANGEABLE: Final = TRAFFIC_PARAMETERS | {"LENGTH", "WIDTH", "MIN_SPEED", "MAX_SPEED"}  # by subclasses
_ACCELERATION_GAINS: Final = ("speed_gain", "front_speed_gain", "front_gap_gain")
_STEERING_GAINS: Final = ("heading_gain", "offset_gain")
Parameters = dict[type, dict[str, Any]]  # by class and name


def kind_of(cls: type[RoadObject]) -> int:
    """Return the kind of a highway-env class. A subclass is of its parent's kind if it changes parameters only.

    Raises:
        InputError: if the class behaves differently from all those that the engine knows.
    """
    computed = _computed(cls)
    for kind, known in _CLASSES.items():
        is_alike = issubclass(cls, known) and replaced(cls, known, _CHANGEABLE) is None
        if is_alike and computed is None:
            return kind
    parent = next((parent for parent in cls.__mro__ if parent in _CLASSES.values()), cls)
    reason = computed or replaced(cls, parent, _CHANGEABLE) or "its class"  # the last one if no parent is known
    names = ", ".join(known.__name__ for known in _CLASSES.values())
    raise InputError(
        f"The compiled engine does not know how a {cls.__name__} drives, because of {reason}; it knows {names} and "
        f"their subclasses with other parameters; use gymnasium.make_vec with vectorization_mode='sync'"
    )


def _computed(cls: type[RoadObject]) -> str | None:
    """Return what may give vehicles of a class other parameters than the class itself has; None if nothing does."""
    if type(cls) is not type(RoadObject):
        return "its metaclass"
    names = (name for name in sorted(_CHANGEABLE) if hasattr(type(inspect.getattr_static(cls, name, 0)), "__get__"))
    name = next(names, None)
    return None if name is None else f"its {name}, which is computed"


def classes_of_vehicles(env: AbstractEnv) -> tuple[type[RoadObject], ...]:
    """Return the classes of the vehicles and obstacles that episodes of an environment may have."""
    traffic = class_from_path(env.config["other_vehicles_type"])
    return *_CLASSES.values(), traffic, *(type(thing) for thing in (*env.road.vehicles, *env.road.objects))


def traits_of(source: Any, kind: int) -> Traits:
    """Return the traits of a vehicle or an obstacle, or of a highway-env class for those that are still to be made.

    Raises:
        InputError: if it has parameters that the engine does not read.
    """
    own = () if isinstance(source, type) else vars(source)
    for name in own:
        if name not in _CHANGEABLE and hasattr(type(source), name):
            raise InputError(f"The compiled engine does not support a vehicle with a {name} of its own")
    traits: Traits = np.zeros(1, TRAITS)[0]
    traits.kind, traits.length, traits.width = kind, source.LENGTH, source.WIDTH
    traits.diameter = math.sqrt(source.LENGTH**2 + source.WIDTH**2)
    traits.checks_collisions = getattr(source, "check_collisions", True)
    if not (getattr(source, "collidable", True) and getattr(source, "solid", True)):
        raise InputError("The compiled engine knows only vehicles and obstacles that are collidable and solid")
    if kind == OBSTACLE:
        return traits
    traits.min_speed, traits.max_speed = source.MIN_SPEED, source.MAX_SPEED
    if kind in (IDM, LINEAR):
        _read_driver(traits, source)
    if kind == LINEAR:
        _put(traits, _ACCELERATION_GAINS, source.ACCELERATION_PARAMETERS)
        _put(traits, _STEERING_GAINS, source.STEERING_PARAMETERS)
        traits.speed_exponent = 2.0
    return traits


def _read_driver(traits: Traits, source: Any) -> None:
    """Read the parameters of the reactive traffic."""
    _put(traits, tuple(_PARAMETERS), [getattr(source, name) for name in _PARAMETERS.values()])
    traits.low_delta, traits.high_delta = source.DELTA_RANGE
    traits.gap_divisor = 2 * math.sqrt(-source.COMFORT_ACC_MAX * source.COMFORT_ACC_MIN)
    traits.changes_lanes = getattr(source, "enable_lane_change", True)


def _put(traits: Traits, fields: tuple[str, ...], values: Iterable[float]) -> None:
    for field, value in zip(fields, values, strict=True):
        traits[field] = value


class VehicleClasses:
    """The parameters of highway-env's vehicle classes as one environment has left them.

    `IntersectionEnv` sets attributes of the class of its vehicles in each reset, and relies on them while it runs, so
    it would change all other environments. Each begins with the parameters that it finds, as without this class.
    """

    def __init__(self) -> None:
        self._own: Parameters | None = None

    @contextmanager
    def applied(self) -> Iterator[None]:
        """Let the environment run with the parameters that it left, and give all others theirs back afterwards."""
        others = parameters()
        if self._own is not None:
            set_parameters(self._own)
        try:
            yield
        finally:
            self._own = parameters()
            set_parameters(others)


@contextmanager
def kept_parameters() -> Iterator[None]:
    """Undo afterwards what `IntersectionEnv` does to the class of its vehicles, which all other environments share."""
    before = parameters()
    try:
        yield
    finally:
        set_parameters(before)


def parameters() -> Parameters:
    """Return the parameters of `IDMVehicle` and all its subclasses: their own attributes that are named in capitals."""
    found: Parameters = {}
    classes: list[type] = [IDMVehicle]
    while classes:
        cls = classes.pop()
        found[cls] = {name: value for name, value in vars(cls).items() if name.isupper()}
        classes += cls.__subclasses__()
    return found


def set_parameters(kept: Parameters) -> None:
    """Give classes the parameters that `parameters` has returned, and remove those that they did not have then."""
    for cls, wanted in kept.items():
        present = {name: value for name, value in vars(cls).items() if name.isupper()}
        for name in present.keys() - wanted.keys():
            delattr(cls, name)
        for name, value in wanted.items():
            if present.get(name, ...) is not value:
                setattr(cls, name, value)
