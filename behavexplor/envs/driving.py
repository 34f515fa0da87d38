"""The base environment of all functional scenarios: an ego among NPCs that play back a concrete scenario."""

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.envs.common.action import action_factory
from highway_env.envs.common.observation import observation_factory
from highway_env.road.road import Road
from numpy.typing import NDArray

from behavexplor.data.conventions import ARRIVAL_DISTANCE, STANDING_SPEED, STANDSTILL_TIME
from behavexplor.data.npc_motion import motion_table
from behavexplor.data.scripted import ScriptedScenario
from behavexplor.data.scripted_logical import ScriptedLogicalScenario
from behavexplor.data.vehicle_sizes import VEHICLE_SIZES
from behavexplor.envs.actions import check_actions
from behavexplor.envs.env_config import changed_config, changed_logical, default_config, default_observation
from behavexplor.envs.kinematics import Kinematics
from behavexplor.envs.network import road_network
from behavexplor.envs.recorder import Recorder
from behavexplor.envs.scene_observation import SceneObservation
from behavexplor.envs.vehicles import ScriptedVehicle, place_ego
from behavexplor.envs.viewer import MapViewer
from behavexplor.errors import InputError, unknown_name

PASSED_DISTANCE = 5.0  # distance beyond the destination, along its lane [m]

RENDER_MODES = ("human", "rgb_array")
TERMINAL = ("collision", "arrived", "passed")  # ends that terminate the episode; all other ends truncate it


class DrivingEnv(AbstractEnv):  # type: ignore[misc]
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
    | logical | {} | parameters of `behavexplor.data.scripted_ranges.ScriptedRanges` to change: `n_npcs`, ... |

    The other keys are highway-env's. Most of them concern rendering: `screen_width`, `screen_height`, `scaling`,
    `centering_position`, `real_time_rendering`, ... `render_mode` is None, "human" or "rgb_array".

    Raises:
        InputError: if the config contains an unknown key, or a value that is out of range.
    """

    logical: ScriptedLogicalScenario
    config: dict[str, Any]
    scenario: ScriptedScenario
    viewer: MapViewer | None
    observation_type: Any  # highway-env has no annotations
    action_type: Any
    _has_new_config = True
    _has_begun = False
    _recorder: Recorder
    _end: str | None = None
    _terms: dict[str, float]

    def __init__(self, config: Mapping[str, Any] | None = None, render_mode: str | None = None) -> None:
        self.metadata = {"render_modes": list(RENDER_MODES)}
        if render_mode not in (None, *RENDER_MODES):
            raise InputError(f"render_mode: expected None, {' or '.join(RENDER_MODES)}, got {render_mode!r:.80}")
        super().__init__(config, render_mode)
        self._has_begun = False  # highway-env's constructor has reset the environment without a seed

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

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[Any], dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: seed of the generator that samples scenarios.
            options: the concrete scenario to run, under the key `scenario`. Without it a scenario is sampled.

        Raises:
            InputError: if the scenario cannot be run in this environment, or an option is unknown.
        """
        gymnasium.Env.reset(self, seed=seed)
        options = options or {}
        for key in options:
            if key != "scenario":
                raise unknown_name("reset option", str(key), ["scenario"])
        scenario = options.get("scenario")
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
        self.action_type = action_factory(self, self.config["action"])  # determines the ego's class
        self._place(scenario)
        self.define_spaces()
        observation = self.observation_type.observe()
        if self.render_mode == "human":
            self.render()
        return observation, {"scenario": scenario}

    def _place(self, scenario: ScriptedScenario) -> None:
        """Put the ego and the NPCs of a scenario on the road."""
        roadmap = self.logical.roadmap
        network = road_network(roadmap)
        self.road = Road(network, np_random=self.np_random)
        vehicle_class = self.action_type.vehicle_class
        ego = place_ego(vehicle_class, self.road, roadmap.start_pose, network.indexes(roadmap.ego_route))
        n_frames = int(self.config["duration"] * self.config["simulation_frequency"]) + 1
        time = np.arange(n_frames + 1) / self.config["simulation_frequency"]
        motion = motion_table(scenario, roadmap, time)
        npcs = [
            ScriptedVehicle(
                self.road, VEHICLE_SIZES[npc.type], motion[:, i], network.indexes(roadmap.routes[npc.route])
            )
            for i, npc in enumerate(scenario.npcs)
        ]
        self.controlled_vehicles = [ego]
        self.road.vehicles = [ego, *npcs]
        self._recorder = Recorder(roadmap, time, motion, [(v.LENGTH, v.WIDTH) for v in self.road.vehicles])
        self._recorder.frame(ego)

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
        return super().step(action)  # type: ignore[no-any-return]

    def _simulate(self, action: Any = None) -> None:
        """Simulate until the next decision, or until the episode ends."""
        self._recorder.action(action)
        self.action_type.act(action)
        substeps = self.config["simulation_frequency"] // self.config["policy_frequency"]
        for substep in range(substeps):
            self.road.act()
            self.road.step(1 / self.config["simulation_frequency"])
            self.steps += 1
            self._recorder.frame(self.vehicle)
            self._end = self._find_end()
            if self._end is not None:
                break
            if substep < substeps - 1:
                self._automatic_rendering()
        self.enable_auto_render = False
        self._terms = self._recorder.reward_terms(self.config["reward"], self._end)

    def _find_end(self) -> str | None:
        roadmap = self.logical.roadmap
        if self._recorder.touched_npcs():
            return "collision"
        gap = self.vehicle.position - roadmap.destination_point
        if np.hypot(*gap) <= ARRIVAL_DISTANCE:
            return "arrived"
        if gap @ roadmap.destination_direction > PASSED_DISTANCE:
            return "passed"
        if self._recorder.standing_frames(STANDING_SPEED) >= STANDSTILL_TIME * self.config["simulation_frequency"]:
            return "standstill"
        if self.steps >= self.config["duration"] * self.config["simulation_frequency"]:
            return "timeout"
        return None

    def _rewards(self, action: Any) -> dict[str, float]:  # noqa: ARG002 - highway-env's signature
        return self._terms

    def _reward(self, action: Any) -> float:
        return sum(self._rewards(action).values())

    def _is_terminated(self) -> bool:
        return self._end in TERMINAL

    def _is_truncated(self) -> bool:
        return self._end is not None and self._end not in TERMINAL

    def _info(self, obs: Any, action: Any = None) -> dict[str, Any]:  # noqa: ARG002 - highway-env's signature
        info = {"speed": self.vehicle.speed, "rewards": dict(self._rewards(action))}
        if self._end is not None:
            info |= {"end": self._end, "trace": self._recorder.trace(self._end)}
        return info

    def render(self) -> NDArray[np.uint8] | None:
        """Render the scene from above: double yellow lines, curbs, routes, and every vehicle at its own size."""
        if self.render_mode is not None and self.viewer is None:
            self.viewer = MapViewer(self)
        return super().render()  # type: ignore[no-any-return]
