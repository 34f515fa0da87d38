"""The reward of the environments: what R1-R3 and progress are worth, term by term.

The weights are the environment's `config["reward"]`; the defaults are `WEIGHTS`. Each term is a weight times

- `progress`: meters that the ego came forward along its route since the last decision;
- `step`: 1;
- `effort`: the square of the mean acceleration since the last decision [(m/s2)^2];
- `lines`: 1 at the decision in which the ego first touches an illegal line (R2);
- `collision`: 1 at a collision (R1), or `rear_end` instead if a faster vehicle struck the ego from behind;
- `arrived`: 1 on arrival (R3), `missed`: 1 at any other end that is no collision.
"""

import math
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
REAR_END_ANGLE = 0.8  # between the headings at most [rad]


def reward_terms(
    weights: Mapping[str, float],
    *,
    progress: float,
    acceleration: float,
    touched: bool,
    end: str | None,
    rear_end: bool,
) -> dict[str, float]:
    """The terms of the reward of one decision; the reward is their sum.

    Args:
        weights: see `WEIGHTS`.
        progress: along the ego's route [m].
        acceleration: mean since the last decision [m/s2].
        touched: whether the ego has just touched an illegal line for the first time.
        end: how the episode has ended; None if it goes on.
        rear_end: of a collision, whether the ego was struck from behind.
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


def struck_from_behind(ego: tuple[float, float, float, float], npc: tuple[float, float, float, float]) -> bool:
    """Whether a vehicle that touches the ego ran into its back.

    Args:
        ego: x [m], y [m], heading [rad] and speed [m/s].
        npc: the same of the vehicle that it touches.
    """
    x, y, heading, speed = ego
    behind = (npc[0] - x) * math.cos(heading) + (npc[1] - y) * math.sin(heading) < 0
    turned = abs(math.remainder(npc[2] - heading, 2 * math.pi))
    return behind and turned <= REAR_END_ANGLE and npc[3] > speed
