"""The infos of vector environments in gymnasium's format: arrays, each with a mask that says for whom it is."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from behavexplor.envs.stock.episodes import CRASHED, FIRST_FLAG, FIRST_TERM, REWARD, SPEED, STEPPED
from behavexplor.envs.tasks.task import TaskKind

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]


def infos_of(kind: TaskKind, numbers: Floats, flags: Bools, actions: NDArray[Any], chosen: Bools) -> dict[str, Any]:
    """Return the infos of highway-env's single environments as gymnasium's vector environments collect them.

    The infos consist of parts of the given arrays, in which what is not chosen becomes 0.

    Args:
        kind: the kind of task.
        numbers: a copy of `Outcome.numbers`.
        flags: a copy of `Outcome.flags`.
        actions: a copy of the egos' actions, shape (B, ...).
        chosen: which sub-environments have an info, shape (B,).
    """
    beside = None if all(chosen.tolist()) else ~chosen
    if beside is not None:
        numbers[SPEED:, beside] = flags[CRASHED:, beside] = actions[beside] = 0
    rewards: dict[str, Any] = {}
    for k, (name, (_, wanted)) in enumerate(kind.terms.items()):
        if wanted is float:
            rewards[name] = numbers[FIRST_TERM + k]
        elif wanted is int:
            rewards[name] = numbers[FIRST_TERM + k].astype(int)
        else:
            rewards[name] = _flag(flags[FIRST_FLAG + k], wanted, beside)
        rewards[f"_{name}"] = chosen
    infos: dict[str, Any] = {
        "speed": numbers[SPEED],
        "_speed": chosen,
        "crashed": flags[CRASHED],
        "_crashed": chosen,
        "action": actions,
        "_action": chosen,
        "rewards": rewards,
        "_rewards": chosen,
    }
    if kind.has_agents:
        ended = flags[CRASHED] | flags[FIRST_FLAG + kind.position(kind.arrival)]
        infos |= {"agents_rewards": _tuples(numbers[REWARD], beside), "_agents_rewards": chosen}
        infos |= {"agents_terminated": _tuples(ended, beside), "_agents_terminated": chosen}
    if kind.success is not None:
        infos |= _success(flags[FIRST_FLAG + kind.position(kind.success)], flags[STEPPED] & chosen)
    return infos


def _success(is_success: Bools, stepped: Bools) -> dict[str, Any]:
    """Return the info that highway-env's exit environment gives after a decision, but not after a reset."""
    return {"is_success": is_success & stepped, "_is_success": stepped} if np.count_nonzero(stepped) else {}


def _flag(values: Bools, wanted: type, beside: Bools | None) -> NDArray[Any]:
    return values if wanted is bool else _without(values.astype(object), beside)


def _tuples(values: NDArray[Any], beside: Bools | None) -> NDArray[np.object_]:
    """Return each value as a tuple of one, as highway-env's multi-agent environments have it."""
    return _without(np.fromiter(zip(values.tolist(), strict=True), dtype=object), beside)


def _without(objects: NDArray[np.object_], beside: Bools | None) -> NDArray[np.object_]:
    if beside is not None:
        objects[beside] = None
    return objects
