"""The compiled form of highway-env's environments whose episodes are given by their random draws."""

import math
from typing import Any, Final

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from highway_env.envs import IntersectionEnv
from highway_env.road.road import RoadNetwork
from numpy.typing import NDArray

from behavexplor.data.drawn_logical import NORMAL, UNIFORM, DrawnLogicalScenario
from behavexplor.data.drawn_scenario import DrawnScenario
from behavexplor.envs.drawn.course import LaneIndex
from behavexplor.envs.drawn.drawn_env import DrawnEnv
from behavexplor.envs.drawn.episode_record import Frame
from behavexplor.envs.drawn.generator import DrawnGenerator
from behavexplor.envs.drawn.terms import has_arrived
from behavexplor.envs.stock.lane_network import lane_indexes
from behavexplor.envs.stock.source_gate import changed_sources
from behavexplor.envs.stock.stock_env import StockVectorEnv
from behavexplor.errors import InputError

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]

_SPAWN: Final = "_spawn_vehicle"
_SPAWN_KINDS: Final = (UNIFORM, UNIFORM, UNIFORM, NORMAL, NORMAL)  # of its draws, before that of `DELTA`
_ORIGINS: Final = 4  # roads from which vehicles enter an intersection


class DrawnVectorEnv(VectorEnv[NDArray[Any], NDArray[Any], NDArray[Any]]):
    """`num_envs` environments of highway-env in lock-step, whose episodes are given by their random draws.

    highway-env itself begins each episode, with the draws of its scenario. The compiled engine drives it.
    `reset(options={"scenarios": [...], "reset_mask": ...})` begins episodes, and at the end of an episode
    `infos["trace"]` has its trace. Autoreset is disabled.

    Args:
        env: the environment; its episodes are used up.
        num_envs: number of sub-environments.

    Raises:
        InputError: if the compiled engine does not support the environment or its configuration.
    """

    def __init__(self, env: DrawnEnv, num_envs: int) -> None:
        check_compiled(env)
        self._env = env
        self._engine = StockVectorEnv(
            type(env.inner),
            num_envs,
            env.config,
            AutoresetMode.DISABLED,
            max_episode_steps=env.max_decisions,
            log_frames=True,
            rewards=False,
        )
        self.num_envs = num_envs
        self.metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.DISABLED}
        self.single_observation_space = self._engine.single_observation_space
        self.single_action_space = self._engine.single_action_space
        self.observation_space = self._engine.observation_space
        self.action_space = self._engine.action_space
        self.logical: DrawnLogicalScenario = env.logical
        self._records: list[Any] = [None] * num_envs
        self._networks: list[RoadNetwork] = [env.inner.road.network] * num_envs
        self._ended = np.ones(num_envs, dtype=bool)
        self._lanes: list[LaneIndex] = lane_indexes(env.inner.road.network)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[NDArray[Any], dict[str, Any]]:
        """Begin episodes.

        Args:
            seed: has no effect, since the scenarios decide.
            options: `scenarios`, one for each sub-environment, and `reset_mask`, shape (num_envs,), which selects the
                sub-environments to reset.

        Raises:
            InputError: if a scenario is not one of this environment.
        """
        del seed
        options = options or {}
        mask = np.asarray(options.get("reset_mask", np.ones(self.num_envs, dtype=bool)))
        result: tuple[NDArray[Any], dict[str, Any]] | None = None
        for b in np.flatnonzero(mask).tolist():
            scenario = options["scenarios"][b]
            self._env.begin_blindly(scenario)
            self._records[b], self._networks[b] = self._env.record, self._env.inner.road.network
            chosen = np.arange(self.num_envs) == b
            given: dict[str, Any] = {"reset_mask": chosen, "starts": {b: self._env.inner}}
            if isinstance(self._env.inner, IntersectionEnv):
                given["spawn_draws"] = {b: self._spawn_draws(scenario)}
            with self._env.vehicle_classes.applied():
                result = self._engine.reset(options=given)
        self._ended = self._ended & ~mask
        if result is None:
            raise InputError("reset_mask: no sub-environment is selected")
        return result

    def step(self, actions: NDArray[Any]) -> tuple[NDArray[Any], Floats, Bools, Bools, dict[str, Any]]:
        """Take an action in every sub-environment. A sub-environment whose episode has ended rests."""
        rest = self._ended
        for b in np.flatnonzero(~rest).tolist():
            self._records[b].decide(actions[b])
        observations, rewards, terminated, truncated, infos = self._engine.step(actions)
        self._ended = terminated | truncated
        ended = self._ended & ~rest
        traces = np.full(self.num_envs, None, dtype=object)
        for b in np.flatnonzero(~rest).tolist():
            self._log(b)
            self._records[b].judge(has_arrived(_own(infos, b)))
        for b in np.flatnonzero(ended).tolist():
            traces[b] = self._records[b].trace(self._networks[b], terminated=bool(terminated[b]))
        return observations, rewards, terminated, truncated, {**infos, "trace": traces, "_trace": ended}

    def _log(self, b: int) -> None:
        """Record the frames of the latest decision of sub-environment b."""
        log, record = self._engine.frame_log, self._records[b]
        rows = zip(log.frames[b].tolist(), log.things[b].copy(), strict=True)
        for (count, ego, lane, is_on_road), things in rows:
            record.frames.append(Frame(things[:count], ego, self._lanes[lane], is_on_road))
        for number in log.things[b, -1]["number"][:count].tolist():
            record.sizes.setdefault(number, _SIZE)

    def _spawn_draws(self, scenario: DrawnScenario) -> Floats:
        """Return the draws by which vehicles appear at an intersection after each decision, shape (decisions, 6)."""
        config = self._env.config
        played = DrawnGenerator(dict(scenario.draws), scenario.seed, __file__)
        decisions = math.ceil(config["duration"] * config["policy_frequency"]) + 1
        rows = []
        for decision in range(decisions):
            call = f"step#{decision}/{_SPAWN}" if decision else f"step/{_SPAWN}"
            share, first, second, station, speed = played.forms(call, _SPAWN_KINDS)
            delta = played.forms(f"{call}/randomize_behavior", (UNIFORM,))[0]
            origin = int(first * _ORIGINS)
            others = [road for road in range(_ORIGINS) if road != origin]
            rows.append([share, origin, others[int(second * len(others))], station, speed, delta])
        return np.array(rows)

    def close_extras(self, **_: Any) -> None:
        """Release the engine."""
        self._engine.close()


_SIZE: Final = (5.0, 2.0)  # length and width of highway-env's vehicles that appear in an episode [m]


def check_compiled(env: DrawnEnv) -> None:
    """Check that the compiled engine draws as the environment does.

    Raises:
        InputError: if it does not.
    """
    changed = changed_sources()
    if changed:
        raise InputError(f"This release of highway-env has another {', '.join(changed[:3])} than the compiled engine")
    for draw in env.logical.draws:
        call, _, function = draw.name.partition("/")
        is_spawn = isinstance(env.inner, IntersectionEnv) and function.startswith(_SPAWN)
        if "observe" in draw.name or (call.partition("#")[0] == "step" and not is_spawn):
            raise InputError(f"The compiled engine does not know the draws of {draw.name}")


def _own(infos: dict[str, Any], b: int) -> dict[str, Any]:
    """Return what sub-environment b has of the infos that tell an arrival."""
    own: dict[str, Any] = {}
    if "is_success" in infos:
        own["is_success"] = infos["is_success"][b]
    if "arrived_reward" in infos.get("rewards", {}):
        own["rewards"] = {"arrived_reward": infos["rewards"]["arrived_reward"][b]}
    return own
