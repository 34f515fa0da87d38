"""What comes out of an episode with scripted vehicles: the trace, and the terms of the reward.

The reward is a sum of terms for R1-R3, progress, time and effort; see `behavexplor.envs.driving.DrivingEnv`.
"""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, TypeAlias

import numpy as np

from behavexplor.data.array_types import Array, Bools, Floats, Ints
from behavexplor.data.npc_motion import HEADING, SPEED, X, Y
from behavexplor.data.roadmap import RoadMap
from behavexplor.data.trace import ENDS, RESOLUTION, Trace
from behavexplor.envs.engine.state import Records, record_type
from behavexplor.jit import kernel_in_place, kernel_inner

Pose: TypeAlias = np.record

POSE: Final = record_type(  # of the ego in a frame
    x=np.float64,  # [m]
    y=np.float64,
    heading=np.float64,  # [rad]
    vx=np.float64,  # [m/s]
    vy=np.float64,
)
WEIGHTS: Mapping[str, float] = MappingProxyType(  # the default of `config["reward"]`
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
TERMS: Final = tuple(WEIGHTS)
COLLISION, ARRIVED = ENDS.index("collision"), ENDS.index("arrived")


def episode_trace(
    roadmap: RoadMap,
    *,
    time: Floats,
    ego: Records,
    motion: Floats,
    sizes: Floats,
    actions: Floats,
    action_frames: Ints,
    end: str,
) -> Trace:
    """Build the trace of a finished episode of T frames at the times `time` [s], shape (T,).

    `ego` has its poses, shape (T,) of `POSE`, and `motion` is the NPCs' motion table, shape (T, n_npcs, 5). `sizes` has
    lengths and widths, the ego's first, shape (1 + n_npcs, 2) [m]; the array becomes part of the trace. The `actions`,
    shape (D, A), were given at the frames `action_frames`, shape (D,). `end` is one of `ENDS`.
    """
    shape = len(time), len(sizes)
    position, heading, velocity = np.empty((*shape, 2)), np.empty(shape), np.empty((*shape, 2))
    turned = motion[..., HEADING]
    directions = np.empty((2, *turned.shape))
    np.cos(turned, out=directions[0])  # numpy's own functions, whose last bits differ from C's
    np.sin(turned, out=directions[1])
    is_finite = fill_record(ego, motion, directions, RESOLUTION, position, heading, velocity)
    made = Trace.of_valid if is_finite else Trace  # which refuses it
    return made(
        time=_read_only(time),
        position=_read_only(position),
        heading=_read_only(heading),
        velocity=_read_only(velocity),
        size=_read_only(sizes),
        actions=_read_only(np.array(actions, dtype=np.float64)),
        action_frame=_read_only(action_frames),
        route=roadmap.ego_line,
        destination=roadmap.destination_point,
        illegal_lines=roadmap.illegal_lines,
        end=end,
    )


def _read_only(array: Array) -> Array:
    array.setflags(write=False)
    return array


@kernel_in_place
def fill_record(
    ego: Records,
    motion: Floats,
    directions: Floats,
    resolution: float,
    position: Floats,
    heading: Floats,
    velocity: Floats,
) -> bool:
    """Fill in the motion of all vehicles, the ego first, in multiples of the resolution of traces.

    `ego` has the shape (T,) of `POSE`, the motion table (T, n_npcs, 5), and `directions`, the cosine and sine of the
    NPCs' headings, (2, T, n_npcs). Position and velocity, shape (T, 1 + n_npcs, 2), and heading, (T, 1 + n_npcs), are
    filled. Return whether the ego's motion is finite.
    """
    is_finite = True
    for t in range(len(ego)):
        pose = ego[t]
        position[t, 0, 0], position[t, 0, 1] = _rounded(pose.x, resolution), _rounded(pose.y, resolution)
        heading[t, 0] = _rounded(pose.heading, resolution)
        velocity[t, 0, 0], velocity[t, 0, 1] = _rounded(pose.vx, resolution), _rounded(pose.vy, resolution)
        is_placed = math.isfinite(pose.x) and math.isfinite(pose.y) and math.isfinite(pose.heading)
        is_finite = is_finite and is_placed and math.isfinite(pose.vx) and math.isfinite(pose.vy)
        for i in range(motion.shape[1]):
            position[t, 1 + i, 0] = _rounded(motion[t, i, X], resolution)
            position[t, 1 + i, 1] = _rounded(motion[t, i, Y], resolution)
            heading[t, 1 + i] = _rounded(motion[t, i, HEADING], resolution)
            velocity[t, 1 + i, 0] = _rounded(motion[t, i, SPEED] * directions[0, t, i], resolution)
            velocity[t, 1 + i, 1] = _rounded(motion[t, i, SPEED] * directions[1, t, i], resolution)
    return is_finite


@kernel_inner
def _rounded(value: float, step: float) -> float:
    rounded: float = np.rint(value / step) * step
    return rounded


def reward_terms(weights: Mapping[str, float], runs: Records, active: Bools) -> Floats:
    """Compute the terms of the reward of the latest decision, in the order of `TERMS`, shape (8, B).

    They are 0 in slots that were not stepped, where `active`, shape (B,), is false. Their sum is the reward.
    """
    terms = np.zeros((len(TERMS), len(active)))
    _fill_terms(np.array([weights[name] for name in TERMS]), runs, active, terms)
    return terms


@kernel_in_place
def _fill_terms(weights: Floats, runs: Records, active: Bools, terms: Floats) -> None:
    for b in range(len(active)):
        if not active[b]:
            continue
        run = runs[b]
        happened = (  # in the order of `TERMS`
            run.progress,
            1.0,
            run.mean_acceleration**2,
            1.0 if run.touched else 0.0,
            1.0 if run.end == COLLISION and not run.rear_end else 0.0,
            1.0 if run.end == COLLISION and run.rear_end else 0.0,
            1.0 if run.end == ARRIVED else 0.0,
            1.0 if run.end >= 0 and run.end not in (COLLISION, ARRIVED) else 0.0,
        )
        for i in range(len(weights)):
            terms[i, b] = weights[i] * happened[i]
