"""Fault of a collision: by the trace alone where it is clear, otherwise by whether the ego could have avoided it."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from behavexplor.data.roadmap import RoadMap
from behavexplor.data.scenario import Scenario
from behavexplor.data.scripted_logical import require_scripted
from behavexplor.data.trace import OBSTACLE, PARTNER, Trace
from behavexplor.execution.simulation import Simulation
from behavexplor.judge.events import R1, violation_event
from behavexplor.judge.fault import AT_FAULT, Fault, contact_fault
from behavexplor.triage.closed_loop import TrialVerdict, find_driver
from behavexplor.triage.findings import LastChance, OtherDriver, Witness
from behavexplor.triage.witness import find_witness

Kind = Fault | TrialVerdict  # by the trace, or by trials with other drivers and evasions; values in `Blame.kind`


@dataclass(frozen=True)
class Blame:
    """The verdict on a collision."""

    # `ego_cut_in`, `npc_rear_end` or `struck_stationary` if the trace tells, as in
    # `behavexplor.judge.fault.contact_fault`. Otherwise:
    # - `preventable`: there is a witness.
    # - `unpreventable`: nothing that was tried avoids the collision; it is with a vehicle, and no last chance is known.
    # - `standing_still_avoids_it`: in a highway-env environment, all drivers that avoid it fail otherwise, and one of
    #   them stands in the end.
    # - `npc_wreck` (the touched vehicle had crashed before) or `other`, by the trace: none of these holds, or nothing
    #   could be tried, because the environment cannot run in lock-step or other drivers cannot drive in it.
    kind: Kind
    in_junction: bool  # whether the ego was inside a junction; False in highway-env, where it is not known
    # evasion that avoids the collision, or in a highway-env environment another driver that keeps all its requirements;
    # None unless the collision is `preventable`
    witness: Witness | OtherDriver | None = None
    tried: int = 0  # number of evasions, or of other drivers, that were driven

    @property
    def at_fault(self) -> bool:
        """True if the ego was at fault."""
        return self.kind in AT_FAULT


def blame(
    simulation: Simulation, scenario: Scenario, trace: Trace, rng: np.random.Generator, chance: LastChance | None = None
) -> Blame | None:
    """Return the verdict on the collision at the end of an execution; None if the ego touches no vehicle there.

    `simulation` has the environment of the execution; its ADS is not used. `rng` draws random evasions, or the actions
    of random drivers. `chance` is the ego's last chance to avoid the collision, if it is known.
    """
    by_trace, event = contact_fault(trace), violation_event(trace, ("collision",))
    if by_trace is None or event is None or event.spec != R1:
        return None
    if simulation.logical.has_original:  # one of highway-env's own environments, whose vehicles react to the ego
        return _blame_in_reactive_traffic(by_trace, scenario, trace, rng, chance)
    inside = in_junction(require_scripted(simulation.logical, "Blame").roadmap, trace)
    if by_trace != "other":  # scripted vehicles do not crash, so none is a wreck
        return Blame(by_trace, inside)
    witness, tried = find_witness(simulation, scenario, trace, event, rng)
    if witness is not None:
        return Blame("preventable", inside, witness, tried)
    return Blame("unpreventable" if tried else "other", inside, None, tried)


def _blame_in_reactive_traffic(
    by_trace: Kind, scenario: Any, trace: Trace, rng: np.random.Generator, chance: LastChance | None
) -> Blame:
    """Return the verdict on a crash in a highway-env environment, see `behavexplor.triage.closed_loop`."""
    if by_trace not in ("other", "npc_wreck"):
        return Blame(by_trace, in_junction=False)
    others = find_driver(scenario, trace, chance, rng)
    kind = by_trace if others.answer is None else others.answer  # None: they do not decide it
    is_obstacle = PARTNER in trace.signals and trace.signals[PARTNER][-1] == OBSTACLE
    could_avoid_it = is_obstacle or chance is not None  # even if other drivers do not: an obstacle stands still
    if kind == "unpreventable" and could_avoid_it:
        kind = by_trace
    return Blame(kind, in_junction=False, witness=others.driver, tried=others.tried)


def in_junction(roadmap: RoadMap, trace: Trace) -> bool:
    """Return whether the ego's center is inside a junction at the end of a trace."""
    route = roadmap.ego_route
    station, _ = route.project(*trace.position[-1, 0])
    index = min(max(int(np.searchsorted(route.bounds, station, side="right")) - 1, 0), len(route.lanes) - 1)
    return route.lanes[index].junction
