"""The reward of the environments, as a sum of terms for R1-R3, progress, time and effort.

The weights are the environment's `config["reward"]`; the defaults are `WEIGHTS`. Each term is a weight times an amount:

- `progress`: distance that the ego moved forward along its route since the last decision [m];
- `step`: 1;
- `effort`: square of the mean acceleration since the last decision [(m/s2)^2];
- `lines`: 1 at the decision in which the ego first touches an illegal line (R2);
- `collision`: 1 at a collision (R1) that is not a `rear_end`;
- `rear_end`: 1 at a collision in which a faster vehicle struck the ego from behind;
- `arrived`: 1 on arrival (R3);
- `missed`: 1 at any other end.
"""

from collections.abc import Mapping
from types import MappingProxyType

WEIGHTS: Mapping[str, float] = MappingProxyType(
    {
        "progress": 0.1,
        "step": -0.02,
        "effort": -0.002,
        "lines": -8.0,
        "collision": -20.0,
        "rear_end": -2.0,
        "arrived": 10.0,
        "missed": -4.0,
    }
)


def reward_terms(
    weights: Mapping[str, float],
    *,
    progress: float,
    acceleration: float,
    touched: bool,
    end: str | None,
    rear_end: bool,
) -> dict[str, float]:
    """Compute the terms of the reward of one decision. The reward is their sum.

    Args:
        weights: weight of each term, such as `WEIGHTS`.
        progress: distance moved forward along the ego's route [m].
        acceleration: mean acceleration since the last decision [m/s2].
        touched: whether the ego has just touched an illegal line for the first time.
        end: kind of end, one of `behavexplor.data.trace.ENDS`; None if the episode goes on.
        rear_end: whether the ego was struck from behind; read only if the episode ended by a collision.
    """
    kind = {None: None, "arrived": "arrived", "collision": "rear_end" if rear_end else "collision"}.get(end, "missed")
    happened = {
        "progress": progress,
        "step": 1.0,
        "effort": acceleration**2,
        "lines": float(touched),
        "collision": float(kind == "collision"),
        "rear_end": float(kind == "rear_end"),
        "arrived": float(kind == "arrived"),
        "missed": float(kind == "missed"),
    }
    return {name: weights[name] * amount for name, amount in happened.items()}
