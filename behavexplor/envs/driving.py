"""The base environment of all functional scenarios: an ego among NPCs that play back a concrete scenario."""

import logging
from collections.abc import Mapping
from functools import reduce
from operator import add
from typing import Any

import gymnasium
from highway_env.envs.common.action import action_factory
from highway_env.envs.common.observation import observation_factory
from highway_env.road.road import Road
from highway_env.vehicle.kinematics import Vehicle

from behavexplor.data.array_types import Array, Bytes
from behavexplor.data.conventions import TERMINAL
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.data.scripted_logical import ScriptedLogicalScenario
from behavexplor.data.trace import Trace
from behavexplor.envs.engine.actions import check_actions
from behavexplor.envs.engine.lock_step_vector_env import chosen_options
from behavexplor.envs.env_config import changed_config, changed_logical, default_config, default_observation
from behavexplor.envs.observation_types import Kinematics, SceneObservation
from behavexplor.envs.plain_simulation import MapViewer, PlainSimulation
from behavexplor.envs.source_gate import ChangedError, ChangeGuard, classes_of, guard_of, replaced_in
from behavexplor.envs.tasks.scripted_episodes import OneSlot, odd_action, odd_method, odd_observation
from behavexplor.errors import InputError

RENDER_MODES = ("human", "rgb_array")
_OF_OUTCOMES = frozenset({"_reward", "_rewards", "_is_terminated", "_is_truncated", "_info"})  # which `step` calls


class DrivingEnv(PlainSimulation):
    """Drive to a destination among scripted vehicles.

    Each functional scenario is a subclass with its own `logical` scenario: a map, and the range of concrete scenarios
    that are possible on it.

    ## Concrete scenarios

    `reset(options={"scenario": scenario})` runs a `behavexplor.data.scripted.ScriptedScenario`. Without the option, the
    environment samples a scenario from the logical scenario with its own random generator, so the same environment can
    train a policy. `env.unwrapped.logical.sample(generator)` samples a scenario without running it, and
    `logical.check(scenario)` raises an error that says what is wrong with an invalid scenario.

    NPCs follow their waypoints blindly and never yield: their motion is a function of the scenario alone. They park at
    their last waypoint, which lies behind the ego's destination. The ego starts at rest.

    ## Actions

    The action types are those of highway-env, and `config["action"]` selects one. The default is `ContinuousAction`:

    | index | action | range | meaning |
    |---|---|---|---|
    | 0 | acceleration | -1 to 1 | `acceleration_range`, -5 to 5 m/s2 by default |
    | 1 | steering | -1 to 1 | `steering_range`, -45 to 45 degrees by default, positive to the right |

    `DiscreteAction` and `DiscreteMetaAction` are available as well.

    ## Observations

    The observation types are those of highway-env and one more, and `config["observation"]` selects one. The default is
    `Kinematics` with one row for each vehicle: first the ego, then the other vehicles by distance. Its columns are
    presence, x, y, vx and vy. The positions and velocities of other vehicles are relative to the ego's, and all are
    scaled to [-1, 1] by highway-env's ranges.

    The additional type is `Scene`. It is float64 and unscaled. Its rows follow the order of the scenario, and the rows
    of absent vehicles are 0:

    | column | meaning | unit |
    |---|---|---|
    | 0 | present | 1 or 0 |
    | 1, 2 | x (to the right), y (down) of the center | m |
    | 3 | heading, from x toward y | rad |
    | 4 | speed | m/s |
    | 5 | acceleration | m/s2 |
    | 6, 7 | length, width | m |

    ## Reward

    The reward is the sum of the terms in `info["rewards"]`. Each term is a weight in `config["reward"]` times an amount
    that is measured from one decision to the next:

    | term | weight | amount |
    |---|---|---|
    | progress | 0.1 | distance driven forward along the ego's route [m] |
    | step | -0.02 | 1 |
    | effort | -0.002 | square of the mean acceleration [(m/s2)^2] |
    | lines | -8 | 1 when the ego touches an illegal line for the first time (R2) |
    | collision | -20 | 1 at a collision (R1) that is not a `rear_end` |
    | rear_end | -2 | 1 at a collision in which a faster vehicle struck the ego from behind |
    | arrived | 10 | 1 on arrival (R3) |
    | missed | -4 | 1 at any other end of the episode |

    ## End of the episode

    The episode is terminated if the ego's box touches another vehicle's box ("collision"), if the ego's center is
    within 1 m of the destination ("arrived"), or if it has passed the destination by 5 m ("passed"). It is truncated if
    the ego has been slower than 0.3 m/s for 30 s ("standstill"), or if the time limit is reached ("timeout"). Touching
    a line does not end the episode.

    `info["end"]` names the end, and `info["trace"]` holds the whole episode as a `behavexplor.data.trace.Trace`.
    `reset` returns the running scenario as `info["scenario"]`.

    ## Arguments

    `gymnasium.make(id, config={...}, render_mode=...)`. An unknown key is refused, and the error suggests the most
    similar key. A value that cannot be used or would have no effect is refused as well.

    | key of `config` | default | meaning |
    |---|---|---|
    | observation, action | see above | highway-env's observation and action configuration |
    | simulation_frequency | 20 | simulation steps [Hz], a multiple of `policy_frequency` |
    | policy_frequency | 10 | decisions [Hz] |
    | duration | 200 | time limit [s] |
    | reward | see above | weights to change |
    | logical | {} | parameters of `behavexplor.data.scripted.ScriptedRanges` to change: `n_npcs`, ... |

    The other keys are highway-env's. Most of them concern rendering: `screen_width`, `screen_height`, `scaling`,
    `centering_position`, `real_time_rendering`, ... `render_mode` is None, "human" or "rgb_array".

    Raises:
        InputError: if the config contains an unknown key, or a value that is out of range.
    """

    logical: ScriptedLogicalScenario
    scenario: ScriptedScenario
    viewer: MapViewer | None
    observation_type: Any  # highway-env has no annotations
    _has_new_config = True  # whether the spaces must be made again
    _has_begun = False
    _is_made = False  # False while highway-env's constructor resets the environment
    _road: Road | None = None
    _egos: list[Vehicle]
    _is_shown = False  # whether there are vehicles that show the running episode
    _slot: OneSlot | None = None  # the episode in the engine; None if it runs on highway-env's objects
    _guard: ChangeGuard | None = None  # of the classes for which the engine stands

    def __init__(self, config: Mapping[str, Any] | None = None, render_mode: str | None = None) -> None:
        self.metadata = {"render_modes": list(RENDER_MODES)}
        if render_mode not in (None, *RENDER_MODES):
            raise InputError(f"render_mode: expected None, {' or '.join(RENDER_MODES)}, got {render_mode!r:.80}")
        super().__init__(config, render_mode)
        self._has_begun = False  # highway-env's constructor has reset the environment without a seed
        self._is_made = True

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "viewer": None}  # a window cannot be pickled

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        """Return the default configuration."""
        return default_config(super().default_config(), cls.logical)

    def configure(self, config: dict[str, Any]) -> None:
        """Change the configuration (see the class). A running episode is abandoned."""
        changes = {} if config is None else config
        changed = changed_config(self.config, changes)
        logical = changed_logical(type(self).logical, changed["logical"])
        if "observation" not in changes and self.config["observation"] == default_observation(self.logical):
            changed["observation"] = default_observation(logical)
        self.config, self.logical = changed, logical
        self._has_new_config, self._has_begun = True, False
        self._slot = self._guard = None  # made for the former configuration
        super().configure({})

    def define_spaces(self) -> None:
        """Create the observation and action types of an episode. The spaces are made once per configuration."""
        observation = self.config["observation"]
        own = {"Scene": SceneObservation, "Kinematics": Kinematics}.get(observation.get("type"))
        self.observation_type = own(self, **observation) if own else observation_factory(self, observation)
        self.action_type = action_factory(self, self.config["action"])
        if self._has_new_config:
            self.observation_space = self.observation_type.space()
            self.action_space = self.action_type.space()
            self._has_new_config = False

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begin an episode.

        `options` has the concrete scenario to run, under the key `scenario`. Without it, a scenario is sampled;
        `seed` seeds the generator that samples.

        Raises:
            InputError: if the scenario cannot be run in this environment, or an option is unknown.
        """
        gymnasium.Env.reset(self, seed=seed)
        scenario = chosen_options(options, ("scenario",)).get("scenario")
        if scenario is None:
            scenario = self.logical.sample(self.np_random)
        if not isinstance(scenario, ScriptedScenario):
            raise InputError(
                f"options['scenario'] must be a behavexplor.data.scripted.ScriptedScenario, got {scenario!r:.80}"
            )
        self.logical.check(scenario)
        self.update_metadata()
        self.time = self.steps = 0
        self.done = False
        self._end = None
        self._has_begun = True
        self._terms = {}
        self.scenario = scenario
        self._is_shown = False
        self.define_spaces()  # the type of its actions determines the class of the ego
        if self._is_made:
            self._begin()
        observation = self._observed()
        if self.render_mode == "human":
            self.render()
        return observation, {"scenario": scenario}

    def _begin(self) -> None:
        """Begin the episode in the engine, or on highway-env's objects if it does not support this environment."""
        unsupported = self._unsupported()
        if unsupported is None:
            self._slot = self._slot or OneSlot(self)
            self._is_shown = False
            self._slot.begin(self.scenario)
            return
        self._slot, self._is_shown = None, False  # `_unsupported` may have shown vehicles of the last episode
        _report_plain_simulation(type(self), unsupported)
        self._show()

    def _unsupported(self) -> str | None:
        """Return what the engine does not support of this environment; None if it can simulate it."""
        odd = odd_method(self, DrivingEnv, _OF_OUTCOMES) or odd_action(self.action_type)
        odd = odd or replaced_in(self, _OF_OUTCOMES)
        if odd:
            return odd
        engine_observes = odd_observation(self.observation_type) is None
        try:
            if self._guard is None or not self._guard.is_current():
                classes = classes_of(self, map(type, self.road.vehicles), with_observation=engine_observes)
                self._guard = guard_of(classes)
        except ChangedError as error:
            return f"this program: the {error.reason}"
        return None

    @property
    def road(self) -> Any:  # highway-env has no annotations
        """The road with all vehicles. They are made when they are asked for, and show the episode from then on."""
        self._show()
        return self._road

    @road.setter
    def road(self, road: Road | None) -> None:
        self._road = road

    @property
    def controlled_vehicles(self) -> list[Vehicle]:
        """The ego; see `road`."""
        self._show()
        return self._egos

    @controlled_vehicles.setter
    def controlled_vehicles(self, vehicles: list[Vehicle]) -> None:
        self._egos = vehicles

    def _show(self) -> None:
        """Make vehicles that show the running episode, if there are none yet."""
        if self._is_shown or not hasattr(self, "scenario"):
            return
        self._is_shown = True
        self._place(self.scenario)
        if self._slot is not None and self._has_begun:
            self._slot.show(self)

    def _observed(self) -> Any:
        if self._slot is not None and self._slot.observes:
            return self._slot.observation()
        return self.observation_type.observe()

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Simulate until the next decision, or until the episode ends (see the class).

        Raises:
            gymnasium.error.ResetNeeded: if no episode is running.
            InputError: if the action is not in the action space. Numbers beyond the bounds of a Box are accepted, and
                clipped by highway-env.
        """
        if not self._has_begun:
            raise gymnasium.error.ResetNeeded("No episode has begun: call reset before step")
        if self._end is not None:
            raise gymnasium.error.ResetNeeded("The episode has ended: call reset before step")
        check_actions(self.action_space, action)
        self.time += 1 / self.config["policy_frequency"]
        self._simulate(action)
        observation = self._observed()
        reward, terminated, truncated = self._reward(action), self._is_terminated(), self._is_truncated()
        info = self._info(observation, action)
        if self.render_mode == "human":
            self.render()
        return observation, reward, terminated, truncated, info

    def _simulate(self, action: Any = None) -> None:
        """Simulate until the next decision, or until the episode ends."""
        if self._slot is None:
            super()._simulate(action)
            return
        if self._is_shown:
            self._slot.take(self)
        if self.viewer is not None and self.enable_auto_render:
            self._simulate_in_pictures(self._slot, action)
        else:
            self._slot.decide(action)
        self.enable_auto_render = False
        self._note_state(self._slot)
        self._terms = self._slot.terms()

    def _simulate_in_pictures(self, slot: OneSlot, action: Any) -> None:
        """Simulate a decision frame by frame, and draw the frames between this decision and the next one."""
        substeps = self.config["simulation_frequency"] // self.config["policy_frequency"]
        for substep in range(substeps):
            slot.decide(action, 1)
            self._note_state(slot)
            if self._end is not None:
                break
            if substep < substeps - 1:
                self._automatic_rendering()

    def _note_state(self, slot: OneSlot) -> None:
        self.steps, self._end = slot.frame, slot.end
        if self._is_shown:
            slot.show(self)

    def _rewards(self, action: Any) -> dict[str, float]:  # noqa: ARG002 - highway-env's signature
        return self._terms

    def _reward(self, action: Any) -> float:
        return reduce(add, self._rewards(action).values())  # not `sum`, which compensates rounding since Python 3.12

    def _is_terminated(self) -> bool:
        return self._end in TERMINAL

    def _is_truncated(self) -> bool:
        return self._end is not None and self._end not in TERMINAL

    def _info(self, obs: Any, action: Any = None) -> dict[str, Any]:  # noqa: ARG002 - highway-env's signature
        speed = self.vehicle.speed if self._slot is None else self._slot.speed
        info = {"speed": speed, "rewards": dict(self._rewards(action))}
        if self._end is not None:
            info |= {"end": self._end, "trace": self._trace(self._end)}
        return info

    def _trace(self, end: str) -> Trace:
        return super()._trace(end) if self._slot is None else self._slot.trace()

    def render(self) -> Bytes | None:
        """Render the scene from above: double yellow lines, curbs, routes, and every vehicle at its own size."""
        if self.render_mode is not None and self.viewer is None:
            self.viewer = MapViewer(self)
        return super().render()  # type: ignore[no-any-return]


_reported: set[tuple[type, str]] = set()


def _report_plain_simulation(env_class: type, unsupported: str) -> None:
    """Report, once for each reason, that an environment is simulated on highway-env's objects.

    The report is a log message of level WARNING, so that it shows without any logging configuration.
    """
    if (env_class, unsupported) not in _reported:
        _reported.add((env_class, unsupported))
        logging.getLogger(__name__).warning(
            "%s is simulated on highway-env's objects, many times as slow as compiled: the engine does not support %s",
            env_class.__name__,
            unsupported,
        )
