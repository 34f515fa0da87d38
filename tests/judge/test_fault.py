"""Whose fault a contact was, on traces made by hand: the ego drives along the x axis."""

from dataclasses import replace

import numpy as np
import pytest

from behavexplor.data.trace import Trace
from behavexplor.judge.fault import collision_fault, contact_fault, is_at_fault, own_violations
from tests.judge.traces import CAR, driven, views

STEP = 0.1
SIZE = np.array([[4.7, 2.06], [4.57, 2.08]])


def trace(ego_speed, npc_end, npc_speed, npc_heading=0.0, swerve=None, seconds=6.0, extra=()):
    """A trace at the end of which the ego is at the origin, heading along x.

    Args:
        ego_speed: [m/s].
        npc_end: where the NPC is in the end.
        npc_speed: [m/s].
        npc_heading: [rad].
        swerve: seconds before the end at which the ego came over from 3.5 m aside, for 2 s.
        seconds: of the whole trace.
        extra: last positions of NPCs that stand.
    """
    time = np.arange(0, seconds + STEP / 2, STEP)
    left = seconds - time
    ego = np.stack([-ego_speed * left, np.zeros_like(time)], -1)
    if swerve is not None:
        ego[:, 1] = -3.5 * np.clip((left - swerve) / 2, 0, 1)
    direction = np.array([np.cos(npc_heading), np.sin(npc_heading)])
    npc = np.array(npc_end) - npc_speed * left[:, None] * direction
    others = [np.broadcast_to(np.array(place, dtype=float), ego.shape) for place in extra]
    position = np.stack([ego, npc, *others], 1)
    heading = np.zeros(position.shape[:2])
    heading[:, 1] = npc_heading
    return Trace(
        time=time,
        position=position,
        heading=heading,
        velocity=np.gradient(position, STEP, axis=0),
        size=np.vstack([SIZE, *[SIZE[1]] * len(extra)]),
        actions=np.zeros((0, 2)),
        action_frame=np.zeros(0, dtype=int),
        route=np.array([[-200.0, 0.0], [200.0, 0.0]]),
        destination=np.array([100.0, 0.0]),
        illegal_lines=np.empty((0, 2, 2)),
        end="collision",
    )


BEHIND = (-4.6, 0.3)


def test_a_faster_vehicle_that_drives_into_the_ego_from_behind_is_at_fault():
    assert contact_fault(trace(5.0, BEHIND, 9.0)) == "npc_rear_end"
    assert contact_fault(trace(0.0, BEHIND, 9.0)) == "npc_rear_end"


@pytest.mark.parametrize(("swerve", "verdict"), [(0.5, "ego_cut_in"), (2.8, "ego_cut_in"), (3.3, "npc_rear_end")])
def test_for_three_seconds_after_its_own_lane_change_the_ego_is(swerve, verdict):
    assert contact_fault(trace(5.0, BEHIND, 9.0, swerve=swerve)) == verdict


def test_a_lane_change_does_not_excuse_who_is_struck_from_elsewhere():
    assert contact_fault(trace(5.0, (4.6, 0.0), 1.0, swerve=0.5)) == "other"


@pytest.mark.parametrize(
    ("npc_end", "npc_speed", "npc_heading"),
    [((0.0, 3.0), 6.0, -np.pi / 2), ((4.6, 0.0), 3.0, np.pi), ((2.0, 2.0), 6.0, 0.0)],
    ids=["from the side", "head on", "alongside"],
)
def test_a_standing_ego_is_struck_and_a_moving_one_leaves_it_open(npc_end, npc_speed, npc_heading):
    assert contact_fault(trace(0.0, npc_end, npc_speed, npc_heading)) == "struck_stationary"
    assert contact_fault(trace(2.0, npc_end, npc_speed, npc_heading)) == "other"


def test_an_ego_that_backs_no_slower_than_the_one_behind_was_not_struck_from_behind():
    assert contact_fault(trace(9.0, BEHIND, 5.0)) == "other"


def test_one_that_comes_from_behind_but_across_is_no_rear_end():
    assert contact_fault(trace(2.0, (-3.4, 0.5), 6.0, npc_heading=1.0)) == "other"


def test_without_contact_there_is_no_verdict():
    assert contact_fault(trace(5.0, (-9.0, 0.0), 9.0)) is None
    assert contact_fault(trace(5.0, (0.0, 3.5), 9.0)) is None


def test_of_several_the_nearest_is_judged_and_those_apart_do_not_matter():
    assert contact_fault(trace(5.0, BEHIND, 9.0, extra=[(0.0, 6.0), (30.0, 0.0)])) == "npc_rear_end"
    assert contact_fault(trace(5.0, BEHIND, 9.0, extra=[(3.0, 1.8)])) == "other"


def test_the_ego_alone_has_no_contact():
    alone = trace(5.0, BEHIND, 9.0)
    fields = {name: getattr(alone, name) for name in ("time", "actions", "action_frame", "route", "destination")}
    motion = {name: getattr(alone, name)[:, :1] for name in ("position", "heading", "velocity")}
    rest = {"size": SIZE[:1], "illegal_lines": alone.illegal_lines, "end": "arrived"}
    assert contact_fault(Trace(**fields, **motion, **rest)) is None


@pytest.mark.parametrize(
    ("fault", "at_fault"),
    [
        (None, True),
        ("other", True),
        ("ego_cut_in", True),
        ("npc_wreck", True),
        ("preventable", True),
        ("npc_rear_end", False),
        ("struck_stationary", False),
        ("unpreventable", False),
    ],
)
def test_a_driver_is_at_fault_unless_another_is(fault, at_fault):
    assert is_at_fault(fault) == at_fault


def test_a_collision_by_another_takes_the_missed_destination_with_it():
    violated = ("collision", "lines", "destination", "mine")
    struck, cut_in = trace(5.0, BEHIND, 9.0), trace(5.0, BEHIND, 9.0, swerve=0.5)
    assert own_violations(struck, violated) == ("lines", "mine")
    assert own_violations(cut_in, violated) == violated
    assert own_violations(trace(5.0, (50.0, 9.0), 9.0), ("destination",)) == ("destination",)
    assert collision_fault(struck, violated) == "npc_rear_end"
    assert collision_fault(struck, ("lines", "collision")) is collision_fault(struck, ()) is None


def contact(ego=(0.0, 0.0, 0.0, 5.0), npc=(-3.5, 0.0, 0.0, 9.0), frames=2, **fields):
    """A contact of an ego of 4 m times 2 m and an NPC of 6 m times 2 m that are as given in each frame."""
    rows = np.tile(ego, (frames, 1)), np.tile(npc, (frames, 1))
    return driven(*rows, sizes=[CAR, (6.0, 2.0)], end="collision", **fields)


@pytest.mark.parametrize(
    ("ego_speed", "npc", "verdict"),
    [
        (5.0, (-2.1, 0.0, 0.0, 9.0), "npc_rear_end"),
        (5.0, (-2.0, 0.0, 0.0, 9.0), "other"),  # beside
        (5.0, (-3.5, 0.0, 0.0, 5.1), "npc_rear_end"),
        (5.0, (-3.5, 0.0, 0.0, 5.0), "other"),  # no faster
        (5.0, (-3.5, 0.0, 0.79, 9.0), "npc_rear_end"),
        (5.0, (-3.5, 0.0, 0.8, 9.0), "other"),
        (5.0, (-3.5, 0.0, -0.81, 9.0), "other"),
        (0.29, (2.0, 0.0, 0.0, 0.0), "struck_stationary"),
        (0.3, (2.0, 0.0, 0.0, 0.0), "other"),
    ],
)
def test_who_struck_whom_by_place_heading_and_speed(ego_speed, npc, verdict):
    found = contact((0.0, 0.0, 0.0, ego_speed), npc)
    assert contact_fault(found) == verdict
    is_on_a_bound = npc[0] == -2.0 or npc[2] == 0.8 or ego_speed in (0.3, npc[3])
    for seen, _ in views(found) if not is_on_a_bound else ():
        assert contact_fault(seen) == verdict


def test_the_poses_of_the_last_frame_tell_who_struck_whom():
    """An NPC that came from the front, stopped, and turned before it struck."""
    npc = np.array([[9.0, 5.0, 3.0, 1.0], [5.0, 5.0, 2.0, 1.0], [-2.5, 3.0, 1.0, 1.0], [-3.5, 0.0, 0.0, 9.0]])
    struck = driven(np.tile([0.0, 0.0, 0.0, 5.0], (4, 1)), npc, end="collision")
    assert contact_fault(struck) == "npc_rear_end"
    stopped = driven([(0.0, 0.0, 0.0, v) for v in (5.0, 5.0, 0.0)], np.tile([3.5, 0.0, 0.0, 0.0], (3, 1)))
    assert contact_fault(stopped) == "struck_stationary"


@pytest.mark.parametrize(
    ("across", "left", "verdict"),
    [
        (0.29, 0.0, "npc_rear_end"),
        (0.31, 0.0, "ego_cut_in"),
        (0.31, 2.9, "ego_cut_in"),
        (0.31, 3.0, "ego_cut_in"),
        (9.0, 3.1, "npc_rear_end"),
    ],
)
def test_a_cut_in_is_a_motion_across_the_route_in_the_last_three_seconds(across, left, verdict):
    """Across the route, whatever the ego's heading; once, so many seconds before the end."""
    found = contact(frames=41)
    velocity = found.velocity.copy()
    velocity[40 - round(10 * left), 0, 1] = across
    found = replace(found, velocity=velocity)
    assert contact_fault(found) == verdict
    for seen, _ in views(found):
        assert contact_fault(seen) == verdict


def test_a_motion_across_is_one_across_the_route_where_the_ego_is():
    """The NPC comes from behind a bend of the route; the ego is along the route before it, and then across."""
    route = ((-90.0, 0.0), (90.0, 0.0), (90.0, 90.0))
    npc = [(90.0, 70.0, 1.6, 9.0), (-3.5, 0.0, 0.0, 9.0)]
    for heading, verdict in ((0.0, "npc_rear_end"), (0.5, "ego_cut_in")):
        ego = [(0.0, 0.0, heading, 5.0), (0.0, 0.0, 0.0, 5.0)]
        for seen, _ in views(driven(ego, npc, route=route, sizes=[CAR, (6.0, 2.0)], end="collision")):
            assert contact_fault(seen) == verdict


def test_in_an_environment_with_lanes_the_partner_is_told_and_the_frame_before_the_crash_counts():
    way = {"way": np.zeros(3), "changing_lanes": np.zeros(3)}
    ego, npc = np.tile([0.0, 0.0, 0.0, 5.0], (3, 1)), np.tile([-9.0, 0.0, 0.0, 9.0], (3, 1))
    npc[-1, 2:] = 2.0, 0.0  # turned and stopped by the crash
    assert contact_fault(driven(ego, npc, signals=way, partner=1)) == "npc_rear_end"
    assert contact_fault(driven(ego, npc, signals=way, partner=-1)) is None
    assert contact_fault(driven(ego[:1], npc[:1], signals={name: [0.0] for name in way}, partner=1)) == "npc_rear_end"
