"""Compiled episodes with scripted vehicles, in lock-step, and what of an environment they do not support."""

from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from highway_env.envs.common.action import ContinuousAction, DiscreteAction, DiscreteMetaAction
from highway_env.vehicle.controller import MDPVehicle
from highway_env.vehicle.kinematics import Vehicle

from behavexplor.data.array_types import Array, Bools, Floats, Ints
from behavexplor.data.npc_motion import N_COLUMNS
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.data.trace import ARRIVED, ENDS, Trace
from behavexplor.envs.engine.actions import make_commands
from behavexplor.envs.engine.observing import make_view
from behavexplor.envs.engine.state import make_scratch
from behavexplor.envs.observation_types import Kinematics, SceneObservation
from behavexplor.envs.source_gate import replaced
from behavexplor.envs.tasks.scripted_outcome import TERMS, episode_trace, reward_terms
from behavexplor.envs.tasks.scripted_slots import begin_episodes, fill_table, make_slots, npc_arrays
from behavexplor.envs.tasks.scripted_step import observe_kinematics, observe_scene, step
from behavexplor.envs.tasks.scripted_world import make_world
from behavexplor.errors import InputError
from behavexplor.jit import compiled_for

WHOLE: Final = 2**31 - 1  # `n_frames` for a whole decision
_ALL: Final = np.ones(1, dtype=bool)  # the only slot is chosen


class ScriptedEpisodes:
    """Episodes of a `DrivingEnv` in lock-step, one in each slot, with its map, rules, actions and observations."""

    def __init__(self, env: Any, n_slots: int) -> None:
        self.logical, self.world = env.logical, make_world(env)
        rules = self.world.rules[0]
        n_frames = int(np.ceil(rules.max_frames)) + 1
        self._time = np.arange(n_frames) / env.config["simulation_frequency"]
        self._substeps, n_decisions = int(rules.substeps), -(-n_frames // int(rules.substeps))
        self._n_values = int(np.prod(env.action_space.shape or ()))  # of an action
        self.slots = make_slots(n_slots, n_frames, (n_decisions, self._n_values), self.logical)
        self._n_waypoints = self.slots.phases.shape[2] - 1
        self._commands = make_commands(env.action_type)
        self._weights = env.config["reward"]
        self._observe_arguments = self._arguments_for(env.observation_type)
        self.observes = bool(self._observe_arguments)  # whether the engine knows the observation
        space = env.observation_space
        self.observations: Array = np.zeros((n_slots, *(space.shape or ())), dtype=space.dtype)
        self._compile(n_slots)

    @property
    def ends(self) -> Ints:
        """The end of each episode, shape (n_slots,): `RUNNING`, `IDLE` or an index of `behavexplor.data.trace.ENDS`."""
        ends: Ints = self.slots.runs["end"]
        return ends

    @property
    def speeds(self) -> Floats:
        """The egos' speeds, shape (n_slots,) [m/s]."""
        speeds: Floats = self.slots.state.vehicles["speed"][:, 0]
        return speeds

    def begin(self, chosen: Ints, scenarios: Iterable[ScriptedScenario]) -> None:
        """Begin episodes in the chosen slots, shape (E,), with a scenario for each.

        Raises:
            InputError: if a scenario has no room in a slot. No episode has begun then.
        """
        npcs = npc_arrays(list(scenarios), self.logical.roadmap, self._n_waypoints)
        if not self._begin_slots(self.world, self.slots, chosen, *npcs):
            raise InputError(f"A scenario has more than {self.slots.scripts.shape[1]} NPCs, for which there is room")

    def decide(self, actions: Array, active: Bools, n_frames: int = WHOLE) -> tuple[Bools, int]:
        """Simulate one decision in each active slot.

        Return whether each episode is terminated and truncated, shape (2, n_slots), and how many have ended now. At
        most `n_frames` frames are simulated; see `behavexplor.envs.tasks.scripted_step.step`.

        Raises:
            InputError: if the record of an episode has no room for it.
        """
        values = np.ascontiguousarray(actions.reshape(len(active), self._n_values), dtype=np.float64)
        ends = np.zeros((2, len(active)), dtype=bool)
        ended = self._step_slots(self.world, self.slots, values, self._commands(actions), active, ends, n_frames)
        if ended < 0:
            raise InputError("An episode is longer than its record has room for: make the environment again")
        return ends, ended

    def observe(self, chosen: Bools) -> None:
        """Renew the observations of the chosen slots, shape (n_slots,)."""
        self._observe_slots(*self._observe_arguments, chosen, self.observations)

    def terms(self, active: Bools) -> Floats:
        """Return the terms of the rewards of the latest decision; see `behavexplor.envs.tasks.scripted_outcome`."""
        return reward_terms(self._weights, self.slots.runs, active)

    def trace(self, b: int, first: int = 0) -> Trace:
        """Return the trace of the episode that has ended in slot b, from a frame on."""
        run, n_vehicles = self.slots.runs[b], int(self.slots.state.episodes["n_vehicles"][b])
        frames = int(run["frame"]) + 1
        decisions = np.arange(0, frames - 1, self._substeps)  # their frames
        skipped = -(-first // self._substeps)  # decisions before the first frame
        traits, sizes = self.slots.state.traits[b, :n_vehicles], np.empty((n_vehicles, 2))
        sizes[:, 0], sizes[:, 1] = traits["length"], traits["width"]
        motion = np.empty((frames - first, n_vehicles - 1, N_COLUMNS))
        self._fill_table(*self._motion_of(b), self._time[first:frames], motion)
        return episode_trace(
            self.logical.roadmap,
            time=self._time[: frames - first],
            ego=self.slots.poses[b, first:frames],
            motion=motion,
            sizes=sizes,
            actions=self.slots.actions[b, skipped : len(decisions)],
            action_frames=decisions[skipped:] - first,
            end=ENDS[run["end"]],
        )

    def ending(self, b: int) -> Trace | None:
        """Return the last two frames of the episode in slot b, which tell whether it failed; None if it surely did.

        An ego that arrives is judged at the moment of its arrival, which lies between these frames.
        """
        run = self.slots.runs[b]
        has_touched = 0 <= run["line_frame"] < run["frame"]
        return None if has_touched or ENDS[run["end"]] != ARRIVED else self.trace(b, max(int(run["frame"]) - 1, 0))

    def _arguments_for(self, observation: Any) -> tuple[Any, ...]:
        """Prepare the slots for an observation, and return its kernel's arguments; none if the engine has no kernel."""
        if type(observation) is SceneObservation:
            return (self.slots,)
        if odd_observation(observation):
            return ()
        self.slots.state.episodes["n_side_lanes"] = observation.n_side_lanes()
        scratch = make_scratch(len(self.world.network.lanes), self.slots.state.vehicles.shape[1])
        return self.world, self.slots, make_view(observation), scratch

    def _motion_of(self, b: int) -> tuple[Any, ...]:
        """Return what determines the motion of the NPCs in slot b."""
        return self.world.npc_routes, self.slots.scripts[b], self.slots.phases[b]

    def _compile(self, n_slots: int) -> None:
        """Compile the kernels for the types of these arrays, or read them from the cache."""
        values, commands = np.zeros((n_slots, self._n_values)), np.zeros((n_slots, 2))
        mask, ends = np.zeros(n_slots, dtype=bool), np.zeros((2, n_slots), dtype=bool)
        self._step_slots: Any = compiled_for(step, self.world, self.slots, values, commands, mask, ends, WHOLE)
        if self.observes:
            is_scene = len(self._observe_arguments) == 1  # see `_arguments_for`
            observe: Any = observe_scene if is_scene else observe_kinematics
            self._observe_slots: Any = compiled_for(observe, *self._observe_arguments, mask, self.observations)
        npcs = npc_arrays([], self.logical.roadmap, self._n_waypoints)
        self._begin_slots = compiled_for(begin_episodes, self.world, self.slots, np.flatnonzero(mask), *npcs)
        table = np.empty((1, 1, N_COLUMNS))
        self._fill_table: Any = compiled_for(fill_table, *self._motion_of(0), self._time[:1], table)


def odd_method(env: Any, known: type, free: frozenset[str] = frozenset()) -> str | None:
    """Return a method of `known` that an environment's class replaces and that is not in `free`; None without one."""
    method = replaced(type(env), known, free | {"logical"})  # a subclass has a `logical` of its own
    return method and f"the method {method}"


def odd_observation(observation: Any) -> str | None:
    """Return what the engine does not support of an observation; None if there is nothing."""
    if type(observation) is SceneObservation:
        return None
    if type(observation) is not Kinematics:
        return f"the observation {type(observation).__name__}"
    return "the order 'shuffled' of the Kinematics observation" if observation.order == "shuffled" else None


def odd_action(action: Any) -> str | None:
    """Return what the engine does not support of an action; None if there is nothing."""
    if type(action) is DiscreteMetaAction:
        return None
    if type(action) not in (ContinuousAction, DiscreteAction):
        return f"the action {type(action).__name__}"
    return f"dynamical vehicles in {type(action).__name__}" if action.dynamical else None


class OneSlot:
    """An episode of a `behavexplor.envs.driving.DrivingEnv` in the only slot of the engine."""

    def __init__(self, env: Any) -> None:
        self._episodes = ScriptedEpisodes(env, 1)
        self.observes = self._episodes.observes  # whether the engine knows the observation

    @property
    def frame(self) -> int:
        """Number of frames since the episode began."""
        return int(self._episodes.slots.runs["frame"][0])

    @property
    def end(self) -> str | None:
        """Kind of the episode's end; None if it goes on."""
        end = int(self._episodes.ends[0])
        return ENDS[end] if end >= 0 else None

    @property
    def speed(self) -> float:
        """Speed of the ego [m/s]."""
        return float(self._episodes.speeds[0])

    def begin(self, scenario: ScriptedScenario) -> None:
        """Begin an episode."""
        self._episodes.begin(np.zeros(1, dtype=np.int64), [scenario])

    def decide(self, action: Any, n_frames: int = WHOLE) -> None:
        """Simulate a decision, or a part of it; see `ScriptedEpisodes.decide`."""
        self._episodes.decide(np.asarray(action)[None], _ALL, n_frames)

    def observation(self) -> Array:
        """Return the observation of the current state."""
        self._episodes.observe(_ALL)
        return np.array(self._episodes.observations[0])

    def terms(self) -> dict[str, float]:
        """Return the terms of the reward of the latest decision."""
        return dict(zip(TERMS, self._episodes.terms(_ALL)[:, 0].tolist(), strict=True))

    def trace(self) -> Trace:
        """Return the trace of the episode, which has ended."""
        return self._episodes.trace(0)

    def show(self, env: Any) -> None:
        """Give an environment's vehicles the state of the episode."""
        vehicles, slots = env.road.vehicles, self._episodes.slots
        ego, row, network = env.vehicle, slots.state.vehicles[0, 0], env.road.network
        _show_motion(ego, row)
        ego.lane_index = network.get_closest_lane_index(ego.position, ego.heading)
        ego.lane = network.get_lane(ego.lane_index)
        if isinstance(ego, MDPVehicle):
            lanes = list(network.lanes_dict())
            ego.target_lane_index, ego.speed_index = lanes[row.target_lane], int(row.speed_index)
            ego.target_speed = float(row.target_speed)
            ego.route = network.indexes(env.logical.roadmap.ego_route)[row.route_position :]
        for npc, motion in zip(vehicles[1:], slots.state.vehicles[0, 1:], strict=False):
            _show_motion(npc, motion)

    def take(self, env: Any) -> None:
        """Take over what a user has changed of the ego."""
        ego, row = env.vehicle, self._episodes.slots.state.vehicles[0, 0]
        (row.x, row.y), row.heading, row.speed = ego.position, ego.heading, ego.speed
        row.cos, row.sin = np.cos(row.heading), np.sin(row.heading)
        if isinstance(ego, MDPVehicle):
            lanes = list(env.road.network.lanes_dict())
            row.target_lane, row.speed_index = lanes.index(tuple(ego.target_lane_index)), ego.speed_index
            row.target_speed = ego.target_speed


def _show_motion(vehicle: Vehicle, row: Any) -> None:
    vehicle.position = np.array([row.x, row.y])
    vehicle.heading, vehicle.speed = float(row.heading), float(row.speed)
    vehicle.action = {"steering": float(row.steering), "acceleration": float(row.acceleration)}
