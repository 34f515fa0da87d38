"""Whether a system under test is fit to be tested: what is wrong with it is said before a campaign, not after."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.trace import Trace
from behavexplor.execution.rollout import ADSError, rollout
from behavexplor.execution.simulation import Simulation

SCENARIOS: Final = 4
MOVING: Final = 0.3  # [m/s]
MARGIN: Final = 0.25  # of the range seen, by which a value may lie outside of it
FOREIGN: Final = 0.2  # greatest share of values outside


class _Witness:
    """An ADS that also keeps what it saw and answered."""

    def __init__(self, ads: Any) -> None:
        self.ads = ads
        self.observations: list[NDArray[Any]] = []
        self.actions: list[NDArray[Any]] = []

    def predict(self, observation: NDArray[Any], *arguments: Any, **keywords: Any) -> Any:
        answer = self.ads.predict(observation, *arguments, **keywords)
        self.observations.append(np.array(observation))
        self.actions.append(np.array(answer[0]))
        return answer


def preflight_warnings(simulation: Simulation) -> list[str]:
    """Drive a few scenarios and say what no driver that can be tested should do.

    Returns:
        A sentence for each finding: the ADS fails, it always answers the same, it never moves, or it was trained on
        observations of another kind, as it is when its `VecNormalize` statistics are missing.
    """
    witness = _Witness(simulation.ads)
    generator = np.random.default_rng(0)
    traces = []
    for _ in range(SCENARIOS):
        scenario = simulation.logical.sample(generator)
        try:
            traces.append(rollout(simulation.env, witness, scenario))
        except ADSError as error:
            return [f"In its first scenarios {error}"]
    prepare = getattr(simulation.ads, "prepare", lambda observation: observation)
    seen = np.concatenate([prepare(observation) for observation in witness.observations])
    trained_on = getattr(simulation.ads, "last_trained_on", None)
    findings = (_constant(witness.actions), _motionless(traces), _foreign(seen, trained_on))
    return [finding for finding in findings if finding]


def _constant(actions: list[NDArray[Any]]) -> str | None:
    stacked = np.concatenate(actions)
    if (stacked != stacked[0]).any():
        return None
    return f"The ADS answered {stacked[0]} in each of {len(stacked)} decisions in {SCENARIOS} scenarios: it is constant"


def _motionless(traces: list[Trace]) -> str | None:
    if max(np.hypot(*trace.velocity[:, 0].T).max() for trace in traces) >= MOVING:
        return None
    return f"The ego never moved in {SCENARIOS} scenarios"


def _foreign(seen: NDArray[Any], trained_on: NDArray[Any] | None) -> str | None:
    """Whether what a policy was last trained on lies outside of what it sees here.

    Args:
        seen: shape (n, ...).
        trained_on: shape (m, ...), frames stacked along the last axis or not; None if unknown.
    """
    if trained_on is None or trained_on.shape[1:-1] != seen.shape[1:-1]:
        return None
    last = trained_on[..., -seen.shape[-1] :]
    low, high = seen.min(axis=0), seen.max(axis=0)
    margin = MARGIN * (high - low) + 1e-3
    share = float(np.mean((last < low - margin) | (last > high + margin)))
    if share <= FOREIGN:
        return None
    return (
        f"{share:.0%} of the values that the policy was last trained on lie outside of what it sees here: "
        f"are the statistics of VecNormalize missing, or was it trained on other observations?"
    )
