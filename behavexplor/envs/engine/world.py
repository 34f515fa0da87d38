"""An environment's road and rules as tables, for the kernels."""

from collections.abc import Callable
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from highway_env import utils
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.common.action import ContinuousAction, DiscreteMetaAction
from highway_env.road.regulation import RegulatedRoad
from highway_env.road.road import LaneIndex, Road, RoadNetwork
from highway_env.vehicle.objects import Obstacle
from numpy.typing import NDArray

from behavexplor.envs.engine.lane_network import Network, make_network
from behavexplor.envs.engine.state import OBSTACLE, TRAITS, Records, record_type
from behavexplor.envs.engine.vehicle_parameters import kind_of, traits_of
from behavexplor.envs.source_gate import replaced
from behavexplor.errors import InputError

Floats = NDArray[np.float64]

Rules: TypeAlias = np.record

EGO, OTHER, BARRIER = range(3)  # rows of `World.templates`

RULES: Final = record_type(
    n_frames=np.int64,  # of a decision
    dt=np.float64,  # duration of a frame [s]
    policy_period=np.float64,  # duration of a decision [s]
    regulation_period=np.int64,  # frames from one check of the right of way to the next; 0: none
)


class World(NamedTuple):
    """An environment's road and rules.

    Attributes:
        network: the road network.
        rules: the numbers that determine how a decision runs, shape (1,) of `RULES`.
        speeds: target speeds of the ego's meta-actions [m/s], shape (speeds,).
        templates: traits of the ego, of new vehicles of the traffic, and of obstacles, shape (3,) of `TRAITS`.
    """

    network: Network
    rules: Records
    speeds: Floats
    templates: Records


def make_world(env: AbstractEnv, is_goal: Callable[[LaneIndex], bool] = lambda _: False) -> World:
    """Return the road and rules of a highway-env environment that has been reset.

    The parameters of the traffic are those that highway-env's classes have at this moment: `IntersectionEnv` changes
    them for the whole process.

    Args:
        env: the environment.
        is_goal: which lanes are marked as goals.

    Raises:
        InputError: if the environment has lanes, vehicles or actions that the engine does not know.
    """
    config = env.config
    _check_road(env)
    return World(
        network=make_network(
            env.road.network,
            connected_lanes=config["neighbour_vehicles_connected_lanes"],
            is_goal=is_goal,
        ),
        rules=_make_rules(env),
        speeds=_target_speeds(env),
        templates=_make_templates(env),
    )


def _check_road(env: AbstractEnv) -> None:
    """Check that the road is one of highway-env's.

    Raises:
        InputError: if it is another one that behaves differently.
    """
    for thing, known in ((env.road, (RegulatedRoad, Road)), (env.road.network, (RoadNetwork,))):
        parent = next((parent for parent in type(thing).__mro__ if parent in known), None)
        changed = f"{type(thing).__name__}" if parent is None else replaced(type(thing), parent, {"__init__"})
        if changed is not None:
            raise InputError(
                f"The compiled engine does not know {changed}; use gymnasium.make_vec with vectorization_mode='sync'"
            )


def _make_rules(env: AbstractEnv) -> Records:
    config = env.config
    rules = np.zeros(1, RULES)
    row = rules[0]
    row.n_frames = int(config["simulation_frequency"] // config["policy_frequency"])
    row.dt = 1 / config["simulation_frequency"]
    row.policy_period = 1 / config["policy_frequency"]
    if isinstance(env.road, RegulatedRoad):
        row.regulation_period = int(1 / row.dt / env.road.REGULATION_FREQUENCY)
    return rules


def _target_speeds(env: AbstractEnv) -> Floats:
    action = env.action_type
    if isinstance(action, DiscreteMetaAction):
        return np.array(action.target_speeds, dtype=np.float64)
    if isinstance(action, ContinuousAction):
        return np.zeros(2)
    raise InputError(
        f"The compiled engine does not know the action {type(action).__name__}; it knows DiscreteMetaAction, "
        f"DiscreteAction and ContinuousAction; use gymnasium.make_vec with vectorization_mode='sync'"
    )


def _make_templates(env: AbstractEnv) -> Records:
    other = utils.class_from_path(env.config["other_vehicles_type"])
    templates = np.zeros(3, TRAITS)
    templates[EGO] = traits_of(env.vehicle, kind_of(type(env.vehicle)))
    if isinstance(env.action_type, ContinuousAction) and env.action_type.speed_range:
        templates[EGO].min_speed, templates[EGO].max_speed = env.action_type.speed_range
    templates[OTHER] = traits_of(other, kind_of(other))
    templates[BARRIER] = traits_of(Obstacle, OBSTACLE)
    return templates
