"""A careful driver for highway-env's own environments: keeps its distance, gives way, and never changes its lane.

It follows the vehicle ahead by the Intelligent Driver Model (see `behavexplor.ads.idm`), and slows down for a vehicle
ahead on another way that comes near soon. It is a reference to compare a policy with, not a good driver.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from behavexplor.ads.idm import ACCELERATION, BRAKING, EXPONENT, JAM_GAP, TIME_GAP
from behavexplor.data.array_types import Bools, Floats, Ints
from behavexplor.data.conventions import MANEUVERS, with_meta_actions
from behavexplor.data.roadmap import RoadMap
from behavexplor.errors import InputError

FEATURES: Final = ("presence", "x", "y", "vx", "vy", "cos_h", "sin_h")
DESIRED_SPEED: Final = 30.0  # v0 [m/s]; the target speeds of the environment are a limit of their own
LENGTH: Final = 5.0  # of highway-env's vehicles [m]
BESIDE: Final = 2.5  # a vehicle farther aside is not ahead [m]
NEAR: Final = 7.0  # distance of centers that is too near [m]
SOON: Final = 2.5  # time in which a vehicle may come so near [s]
PARALLEL: Final = 0.95  # cosine of the angle between two vehicles on parallel ways
START_SPEED: Final = 5.0  # at which the ego is expected to go on, if it is slower [m/s]
HESITATION: Final = 0.5  # a smaller acceleration is no reason for another target speed [m/s2]

_SLOWER, _IDLE, _FASTER = (MANEUVERS.index(name) for name in ("SLOWER", "IDLE", "FASTER"))


class CarefulDriver:
    """The careful driver, for environments in the configuration that `fitted` returns."""

    vectorized: bool = True
    _OBSERVATION: Final = MappingProxyType(
        {
            "type": "Kinematics",
            "vehicles_count": 15,
            "features": list(FEATURES),
            "absolute": True,
            "normalize": False,
            "clip": False,
            "order": "sorted",
        }
    )

    def fitted(self, config: Mapping[str, Any]) -> dict[str, Any]:
        """Return the configuration in which this driver drives, made from `config`, the environment's own."""
        return {**with_meta_actions(config), "observation": dict(self._OBSERVATION)}

    def predict(
        self,
        observation: Floats,
        state: Any = None,
        episode_start: Bools | None = None,  # noqa: ARG002
        deterministic: bool = True,  # noqa: ARG002
    ) -> tuple[Ints, Any]:
        """Decide for a batch of egos; see `behavexplor.ads.interface.ADS`. Observations have the shape (B, 15, 7)."""
        # no rows that are empty in all observations, which saves time; one of another vehicle stays, for `argmin`
        last = np.flatnonzero(observation[..., 0].any(axis=0)).max(initial=1)
        seen = np.moveaxis(observation[:, : last + 1], -1, 0)
        presence, x, y, vx, vy, cos, sin = np.asarray(seen, dtype=np.float64, order="C")
        present = presence[:, 1:] > 0
        apart = _turned(x[:, 1:] - x[:, :1], y[:, 1:] - y[:, :1], cos[:, :1], sin[:, :1])
        speed = np.hypot(vx[:, 0], vy[:, 0])
        motion = _turned(vx[:, 1:], vy[:, 1:], cos[:, :1], sin[:, :1])
        parallel = cos[:, 1:] * cos[:, :1] + sin[:, 1:] * sin[:, :1]
        wanted = _follow(speed, present, apart, motion)
        gives_way = _meets(speed, present, apart, motion, parallel)
        slower = gives_way | (wanted < -HESITATION)
        return np.where(slower, _SLOWER, np.where(wanted > HESITATION, _FASTER, _IDLE)), state


def careful_driver(roadmap: RoadMap | None, variant: str = "") -> CarefulDriver:
    """Make the driver. It drives in highway-env's own environments only, where `roadmap` is None, and has no variants.

    Raises:
        InputError: if the environment is one of this package, or a variant is given.
    """
    if roadmap is not None:
        raise InputError("careful drives in highway-env's own environments only: use --ads idm or --ads rule here")
    if variant:
        raise InputError(f"careful:{variant}: the careful driver has no variants; use --ads careful")
    return CarefulDriver()


def _turned(x: Floats, y: Floats, cos: Floats, sin: Floats) -> tuple[Floats, Floats]:
    """Return vectors as seen by the egos: ahead and aside, each of the shape of x."""
    return x * cos + y * sin, y * cos - x * sin


def _follow(speed: Floats, present: Bools, apart: tuple[Floats, Floats], motion: tuple[Floats, Floats]) -> Floats:
    """Return the accelerations of the Intelligent Driver Model, shape (B,) [m/s2]."""
    ahead, aside = apart
    is_ahead = present & (ahead > 0) & (np.abs(aside) < BESIDE)
    distance = np.where(is_ahead, ahead, np.inf)
    leader = np.arange(len(speed)), distance.argmin(axis=1)
    gap = np.maximum(distance[leader] - LENGTH, 0.1)
    leader_speed = motion[0][leader]
    approach = speed * (speed - leader_speed) / (2 * np.sqrt(ACCELERATION * BRAKING))
    desired = JAM_GAP + np.maximum(speed * TIME_GAP + approach, 0.0)
    return np.asarray(ACCELERATION * (1 - (speed / DESIRED_SPEED) ** EXPONENT - (desired / gap) ** 2))


def _meets(
    speed: Floats, present: Bools, apart: tuple[Floats, Floats], motion: tuple[Floats, Floats], parallel: Floats
) -> Bools:
    """Return whether a vehicle on another way comes near soon, shape (B,)."""
    distance = np.maximum(np.hypot(*apart), 0.1)
    ahead = motion[0] - np.maximum(speed, START_SPEED)[:, None]
    closing = -(apart[0] * ahead + apart[1] * motion[1]) / distance
    near = distance < NEAR + SOON * np.maximum(closing, 0.0)
    return np.asarray((near & present & (parallel < PARALLEL) & (apart[0] > 0)).any(axis=1))
