"""Whose fault a collision was: what the trace alone tells, and for the rest whether it could have been avoided."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from behavexplor.data.roadmap import RoadMap
from behavexplor.data.scenario import Scenario
from behavexplor.data.trace import Trace
from behavexplor.execution.simulation import Simulation
from behavexplor.judge.events import R1, violation_event
from behavexplor.judge.fault import AT_FAULT, contact_fault
from behavexplor.triage.findings import Witness
from behavexplor.triage.witness import find_witness

Kind = Literal["ego_cut_in", "npc_rear_end", "struck_stationary", "preventable", "unpreventable", "other"]


@dataclass(frozen=True)
class Blame:
    """The verdict on a collision.

    Attributes:
        kind: `ego_cut_in`, `npc_rear_end` and `struck_stationary` as in `behavexplor.judge.fault.contact_fault`;
            else `preventable` if there is a witness, `unpreventable` if none was found, and `other` if none could be
            looked for, in an environment that cannot run in lock-step.
        in_junction: whether the ego was inside a junction.
        witness: how it could have been avoided, None unless `preventable`.
        tried: how many ways of avoiding it were driven.
    """

    kind: Kind
    in_junction: bool
    witness: Witness | None = None
    tried: int = 0

    @property
    def at_fault(self) -> bool:
        """Whether the ego answers for it."""
        return self.kind in AT_FAULT


def blame(simulation: Simulation, scenario: Scenario, trace: Trace, rng: np.random.Generator) -> Blame | None:
    """The verdict on the collision with which a drive ends.

    Args:
        simulation: in whose environment it happened; its ADS is not asked.
        scenario: that was driven.
        trace: of it.
        rng: for the ways of avoiding it that are drawn.

    Returns:
        None if the ego touches nobody in the end.
    """
    quick, event = contact_fault(trace), violation_event(trace, ("collision",))
    if quick is None or event is None or event.spec != R1:
        return None
    inside = in_junction(simulation.logical.roadmap, trace)
    if quick != "other":
        return Blame(quick, inside)
    witness, tried = find_witness(simulation, scenario, trace, event, rng)
    if witness is not None:
        return Blame("preventable", inside, witness, tried)
    return Blame("unpreventable" if tried else "other", inside, None, tried)


def in_junction(roadmap: RoadMap, trace: Trace) -> bool:
    """Whether the ego's middle is inside a junction at the end of a trace."""
    route = roadmap.ego_route
    station, _ = route.project(*trace.position[-1, 0])
    index = min(max(int(np.searchsorted(route.bounds, station, side="right")) - 1, 0), len(route.lanes) - 1)
    return route.lanes[index].junction
