"""The infos of vector environments in gymnasium's format: arrays, each with a mask that says for whom it is."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from behavexplor.envs.stock.episodes import Outcome
from behavexplor.envs.stock.task import EXIT, INTERSECTION, TERMS

Bools = NDArray[np.bool_]

_GOAL = list(TERMS[EXIT]).index("goal_reward")
_ARRIVED = list(TERMS[INTERSECTION]).index("arrived_reward")


def infos_of(kind: int, outcome: Outcome, actions: NDArray[Any], chosen: Bools, stepped: Bools) -> dict[str, Any]:
    """Return the infos of highway-env's single environments as gymnasium's vector environments collect them.

    Args:
        kind: the environment's kind.
        outcome: what the egos observed and received.
        actions: their actions, shape (B, ...).
        chosen: which sub-environments have an info, shape (B,).
        stepped: which of them have taken an action, while the others have been reset, shape (B,).
    """
    mask = chosen.copy()
    speeds, crashed, taken = outcome.speeds.copy(), outcome.crashed.copy(), actions.copy()
    terms = outcome.terms.T.copy()
    if not chosen.all():
        beside = ~chosen
        speeds[beside] = crashed[beside] = taken[beside] = terms[:, beside] = 0
    rewards: dict[str, Any] = {}
    for values, (name, wanted) in zip(terms, TERMS[kind].items(), strict=False):
        rewards[name] = values if wanted is float else _typed(values, wanted, mask)
        rewards[f"_{name}"] = mask
    infos: dict[str, Any] = {"speed": speeds, "crashed": crashed, "action": taken, "rewards": rewards}
    if kind == INTERSECTION:
        ended = outcome.crashed | (outcome.terms[:, _ARRIVED] != 0)
        infos |= {"agents_rewards": _tuples(outcome.rewards, mask), "agents_terminated": _tuples(ended, mask)}
    infos |= {f"_{key}": mask for key in infos}
    if kind == EXIT and (mask & stepped).any():
        infos |= {"is_success": (outcome.terms[:, _GOAL] != 0) & mask & stepped, "_is_success": mask & stepped}
    return infos


def final_infos(observations: NDArray[Any], infos: dict[str, Any], ended: Bools) -> dict[str, Any]:
    """Return the last observations and infos of episodes that have ended, for autoreset in the same step.

    Args:
        observations: the observations, shape (B, ...).
        infos: the infos.
        ended: which episodes have ended, shape (B,).
    """
    last = np.full(len(ended), None, dtype=object)
    for b in np.flatnonzero(ended).tolist():
        last[b] = observations[b].copy()
    mask = ended.copy()
    return {"final_obs": last, "_final_obs": mask, "final_info": infos, "_final_info": mask}


def _typed(values: NDArray[Any], wanted: type, mask: Bools) -> NDArray[Any]:
    if wanted is not np.bool_:
        return values.astype(wanted, copy=False)
    shown = np.full(len(values), None, dtype=object)
    shown[mask] = values[mask] != 0
    return shown


def _tuples(values: NDArray[Any], mask: Bools) -> NDArray[np.object_]:
    """Return each value as a tuple of one, as highway-env's multi-agent environments have it; None beside the mask."""
    shown = np.full(len(values), None, dtype=object)
    listed = values.tolist()
    for b in np.flatnonzero(mask).tolist():
        shown[b] = (listed[b],)
    return shown
