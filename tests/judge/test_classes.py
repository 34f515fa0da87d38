"""Classes of violations, on traces made by hand: the ego drives along the x axis."""

from dataclasses import replace

import numpy as np
import pytest

from behavexplor.data.trace import Trace
from behavexplor.judge.classes import ViolationClass, event_class, violation_class, words_of
from behavexplor.judge.events import ViolationEvent, first_line_touch, violation_event
from behavexplor.judge.specs import judge
from tests.judge.test_fault import BEHIND, SIZE, trace
from tests.judge.traces import CAR, driven, other_side, views

BUS = np.array([SIZE[0], [9.21, 3.26]])
RIGHT_OF_IT = np.array([[[-300.0, 1.75 + 1.75], [300.0, 1.75 + 1.75]]])  # a line beside the ego's lane


def class_of(recorded):
    found = violation_class(recorded, judge(recorded).violated)
    return None if found is None else found.id


@pytest.mark.parametrize(
    ("recorded", "expected", "detail"),
    [
        (trace(5.0, BEHIND, 9.0), "from-behind/car-sized", "with contact at its rear"),
        (trace(5.0, (4.6, 0.2), 1.0), "leading/car-sized", "with contact at its front; the other vehicle was creeping"),
        (trace(5.0, (4.6, 0.2), 0.0), "leading/car-sized", "with contact at its front; the other vehicle was standing"),
        (trace(5.0, (4.6, 0.0), 6.0, np.pi), "oncoming/car-sized", "with contact at its front"),
        (
            trace(0.0, (0.0, 3.2), 6.0, -np.pi / 2),
            "crossing-from-right/car-sized",
            "standing, with contact at its right",
        ),
        (trace(1.0, (0.0, -3.2), 6.0, np.pi / 2), "crossing-from-left/car-sized", "creeping, with contact at its left"),
        (replace(trace(5.0, (6.5, 0.0), 3.0), size=BUS), "leading/large", "with contact at its front"),
    ],
)
def test_collisions_are_told_apart_by_what_a_person_would_say(recorded, expected, detail):
    assert class_of(recorded) == f"R1/going-straight/{expected}"
    assert violation_class(recorded, judge(recorded).violated).detail == detail


def test_lane_changes_are_a_maneuver():
    assert class_of(trace(5.0, (0.5, 2.0), 6.0, swerve=0.5)) == "R1/changing-right/on-the-right/car-sized"


@pytest.mark.parametrize("seed", range(20))
def test_a_little_otherwise_is_the_same_class(seed):
    rng = np.random.default_rng(seed)
    dx, dy, dv, turned = rng.uniform(-1, 1, 4) * (0.1, 0.15, 0.4, 0.05)
    other = trace(5.0 + dv, (4.5 + dx / 2, 0.2 + dy), 1.0 + dv / 2, turned)
    assert class_of(other) == class_of(trace(5.0, (4.6, 0.2), 1.0))


def test_the_decision_log_is_not_looked_at():
    recorded = trace(5.0, BEHIND, 9.0)
    logged = replace(recorded, actions=np.zeros((1, 2)), action_frame=np.zeros(1), decisions={"reached": np.ones(1)})
    assert class_of(logged) == class_of(recorded)


def test_a_class_is_a_value_with_a_line_of_words():
    first, again = (violation_class(t, judge(t).violated) for t in (trace(5.0, BEHIND, 9.0), trace(5.2, BEHIND, 9.0)))
    assert first == again
    assert first.words == (
        "Collision with a car-sized vehicle from behind; the ego was going straight, with contact at its rear"
    )


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (
            ViolationClass("R1", "turning-left", "oncoming", "car-sized", "braking"),
            "Collision with an oncoming car-sized vehicle; the ego was turning left, braking",
        ),
        (
            ViolationClass("R1", "going-straight", "crossing-from-right-turning", "large"),
            "Collision with a large vehicle that had turned in from the right; the ego was going straight",
        ),
        (
            ViolationClass("R2", "changing-right", "right", "fast"),
            "Touched a line on its right at speed while changing lanes right",
        ),
        (
            ViolationClass("R3", "changing-left", "passed-it-on-the-left", "never-in-its-lane"),
            "Missed the destination: passed it on the left without ever being in its lane; "
            "the ego was changing lanes left",
        ),
        (
            ViolationClass("R3", "going-straight", "ended-by-timeout", "behind-a-moving-vehicle", "creeping"),
            "Missed the destination: ran out of time behind a moving vehicle; the ego was going straight, creeping",
        ),
        (
            ViolationClass("my-spec", "going-straight", "ended-by-arrived", ""),
            "Violated my-spec (end of the episode: arrived); the ego was going straight",
        ),
    ],
)
def test_words_are_a_sentence(kind, words):
    assert kind.words == words


def test_a_collision_with_no_vehicle_has_words():
    assert words_of("R1") == "Collision with something that is not known"


def braking(recorded):
    """The same, but the ego has come from twice its speed in the last two seconds."""
    time = recorded.time
    speed = 5.0 + 2.5 * np.clip(time[-1] - time, 0, 2)
    x = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * np.diff(time))])
    position, velocity = recorded.position.copy(), recorded.velocity.copy()
    position[:, 0, 0], velocity[:, 0, 0] = x - x[-1], speed
    return replace(recorded, position=position, velocity=velocity)


def test_who_brakes_is_told_from_who_drives():
    slower = braking(trace(5.0, (4.6, 0.2), 3.0))
    assert violation_class(slower, judge(slower).violated).detail == "braking, with contact at its front"


def test_a_touched_line_is_to_a_side():
    apart = {"end": "passed", "illegal_lines": RIGHT_OF_IT}
    drifting = trace(9.0, (-60.0, 30.0), 9.0, swerve=0.0)
    shifted = drifting.position + np.array([0.0, 2.6]) * (np.arange(drifting.position.shape[1]) == 0)[:, None]
    touching = replace(drifting, position=shifted, **apart)
    assert class_of(touching) == "R2/changing-right/right/fast"
    mirrored = replace(touching, position=shifted * (1, -1), velocity=touching.velocity * (1, -1))
    mirrored = replace(mirrored, illegal_lines=RIGHT_OF_IT * (1, -1))
    assert class_of(mirrored) == "R2/changing-left/left/fast"


def test_the_first_touch_is_the_first_frame_that_the_spec_would_call_one():
    drifting = trace(9.0, (-60.0, 30.0), 9.0, swerve=0.0)
    shifted = drifting.position + np.array([0.0, 2.6])
    touching = replace(drifting, position=shifted, illegal_lines=RIGHT_OF_IT, end="passed")
    event = first_line_touch(touching)
    assert "lines" in judge(upto(touching, event.frame)).violated
    assert "lines" not in judge(upto(touching, event.frame - 1)).violated
    assert first_line_touch(upto(touching, event.frame - 1)) is None


def upto(recorded: Trace, frame: int) -> Trace:
    motion = {name: getattr(recorded, name)[: frame + 1] for name in ("time", "position", "heading", "velocity")}
    return replace(recorded, **motion)


def test_missed_destinations_by_how_it_ended_and_behind_whom():
    standing = trace(0.0, (9.0, 0.0), 0.0)
    ended = replace(standing, end="standstill")
    assert class_of(ended) == "R3/going-straight/ended-by-standstill/behind-a-standing-vehicle"
    alone = trace(0.0, (40.0, 0.0), 0.0)
    assert class_of(replace(alone, end="timeout")) == "R3/going-straight/ended-by-timeout/nobody-ahead"
    beside = replace(standing, end="passed", destination=np.array([-1.0, -3.5]))
    assert class_of(beside) == "R3/going-straight/passed-it-on-the-right/having-left-its-lane"


def test_a_collision_goes_before_the_missed_destination_and_nothing_has_no_class():
    recorded = trace(5.0, BEHIND, 9.0)
    assert judge(recorded).violated == ("collision", "destination")
    assert violation_event(recorded, judge(recorded).violated).spec == "R1"
    arrived = replace(trace(5.0, (50.0, 9.0), 0.0), destination=np.zeros(2), end="arrived")
    assert class_of(arrived) is None


def assert_class(recorded, violated, expected, mirror=True):
    """The class and its detail, in every view of the trace."""
    for seen, changed in views(recorded):
        if mirror or changed is str:
            found = violation_class(seen, violated)
            assert (found.id, found.detail) == tuple(map(changed, expected))


@pytest.mark.parametrize(("length", "size"), [(6.9, "car-sized"), (7.0, "car-sized"), (7.1, "large")])
def test_a_vehicle_longer_than_seven_meters_is_large(length, size):
    ahead = driven([0.0, 0.0, 0.0, 5.0], [length / 2 + 1.9, 0.1, 0.0, 1.0], sizes=[CAR, (length, 2.0)])
    expected = f"R1/going-straight/leading/{size}", "with contact at its front; the other vehicle was creeping"
    assert_class(ahead, ["collision"], expected)


@pytest.mark.parametrize(
    ("place", "heading", "speed", "side", "pace"),
    [
        ((0.0, 4.0), 0.0, 5.9, "right", "slow"),
        ((0.0, 4.0), 0.0, 6.0, "right", "fast"),
        ((0.0, 4.0), 0.0, 6.5, "right", "fast"),
        ((0.0, 6.0), np.pi, 6.5, "right", "fast"),
        ((-30.0, 6.0), 0.1, 6.5, "left", "fast"),
        ((30.0, 4.0), -0.1, 6.5, "right", "fast"),
        ((48.0, 4.5), 0.0, 6.5, "right", "fast"),
        ((51.9, 4.9), -1.0, 6.5, "left", "fast"),  # its end, not its straight continuation
        ((-51.9, 4.9), 1.0, 6.5, "left", "fast"),
    ],
)
def test_a_line_is_on_the_side_of_its_nearest_point_and_touched_fast_from_six_meters_per_second(
    place, heading, speed, side, pace
):
    line = np.array([[[-50.0, 5.0], [50.0, 5.0]]])
    route = ((-99.0, place[1]), (99.0, place[1]))
    recorded = driven([*place, heading, speed], illegal_lines=line, route=route)
    event = ViolationEvent("R2", 0, 0)
    assert event_class(recorded, event).id == f"R2/going-straight/{side}/{pace}"
    for seen, changed in views(recorded) if speed != 6.0 else ():
        assert event_class(seen, event).id == changed(f"R2/going-straight/{side}/{pace}")


def test_an_ego_leaves_the_road_on_the_side_of_its_route_in_that_frame():
    ego = np.column_stack([np.arange(3.0), [-5.0, 5.0, -5.0], np.zeros(3), [5.0, 5.0, 9.0]])
    recorded = driven(ego, signals={"off_road": np.array([0.0, 1.0, 1.0])})
    for seen, changed in views(recorded):
        assert violation_class(seen, ["lines"]).conflict == changed("off-right")
    assert violation_class(recorded, ["lines"]).mark == "slow"
    on_it = driven(np.zeros(4), signals={"off_road": np.ones(1)})
    assert violation_class(on_it, ["lines"]).words == "Left the road on its left at low speed while going straight"


@pytest.mark.parametrize(
    ("offsets", "mark"),
    [
        ((9.0, 1.76, 9.0), "never-in-its-lane"),
        ((9.0, 1.75, 9.0), "having-left-its-lane-again"),
        ((-9.0, 1.0, 9.0), "having-left-its-lane-again"),
        ((1.75, 9.0, 9.0), "having-left-its-lane"),
        ((-1.7, 0.0, 0.0), "having-left-its-lane"),
        ((1.8, -1.0, 0.0), "having-left-its-lane-again"),
    ],
)
def test_a_way_past_the_destination_is_told_by_the_offsets_from_the_route(offsets, mark):
    ego = np.column_stack([np.arange(3.0) / 99, offsets, np.zeros(3), np.zeros(3)])
    for sign, side in ((1, "right"), (-1, "left")):
        place = [0.0, offsets[-1] - 3.0 * sign]  # the ego is to the right of it
        passed = driven(ego, end="passed", destination=place)
        assert violation_class(passed, ["destination"]).id == f"R3/going-straight/passed-it-on-the-{side}/{mark}"
        for seen, changed in views(passed) if 1.75 not in offsets else ():
            found = violation_class(seen, ["destination"])
            assert (found.conflict, found.mark) == (changed(f"passed-it-on-the-{side}"), mark)


@pytest.mark.parametrize(
    ("leader", "behind"),
    [
        ([9.0, 0.0, 0.0, 0.0], "behind-a-standing-vehicle"),
        ([9.0, 0.0, 0.0, 1.0], "behind-a-creeping-vehicle"),
        ([9.0, 0.0, 0.0, 5.0], "behind-a-moving-vehicle"),
        ([30.0, 0.0, 0.0, 5.0], "nobody-ahead"),
    ],
)
@pytest.mark.parametrize("end", ["timeout", "standstill"])
def test_a_missed_destination_is_told_by_its_end_and_the_leader(leader, behind, end):
    recorded = driven([0.0, 0.0, 0.0, 1.0], leader, end=end)
    assert_class(recorded, ["destination"], (f"R3/going-straight/ended-by-{end}/{behind}", "creeping"))
    event = violation_event(recorded, ["destination"])
    assert event_class(recorded, event, "collision").id == f"R3/going-straight/ended-by-collision/{behind}"
    passed = event_class(recorded, event, "passed")
    assert passed.id == "R3/going-straight/passed-it-on-the-left/having-left-its-lane"
    own = violation_event(recorded, ["mine"])
    assert event_class(recorded, own).words == (
        f"Violated mine (end of the episode: {end}); the ego was going straight, creeping"
    )
    assert event_class(recorded, own, "arrived").id == "mine/going-straight/ended-by-arrived"
    assert violation_class(recorded, []) is violation_class(recorded, ["error"]) is None


@pytest.mark.parametrize("mark", ["", "large"])
@pytest.mark.parametrize(
    "parts", [("R1", "turning-left", "oncoming"), ("R3", "going-straight", "ended-by-timeout"), ("mine", "a", "b")]
)
def test_a_class_is_its_id_and_back(parts, mark):
    kind = ViolationClass(*parts, mark, "in detail")
    assert kind.id == "/".join([*parts, mark]).removesuffix("/")
    assert ViolationClass.from_id(kind.id) == kind
    assert ViolationClass.from_id(kind.id).detail == ""
    assert ViolationClass(*parts, "other") != kind


def test_every_other_vehicle_has_words_and_so_has_its_mirror_image():
    for conflict in (*CONFLICTS, *(f"{one}-turning" for one in CONFLICTS[:7])):
        words = words_of(f"R1/going-straight/{conflict}/large")
        assert words.startswith(
            "Collision with a large vehicle " if "oncoming" not in conflict else "Collision with an"
        )
        assert words_of(f"R1/going-straight/{other_side(conflict)}/large") == other_side(words)
        assert ("turned" in words) == conflict.endswith("-turning")


CONFLICTS = (
    "leading",
    "from-behind",
    "on-the-right",
    "on-the-left",
    "oncoming",
    "crossing-from-right",
    "crossing-from-left",
    "behind",
    "ahead-on-the-right",
    "ahead-on-the-left",
    "behind-on-the-right",
    "behind-on-the-left",
    "merging-from-right",
    "merging-from-left",
    "crashed-before",
)


@pytest.mark.parametrize("unknown", ["", "R1/going-straight", "R1/going-straight/from-above/large", "error/new"])
def test_a_class_that_is_not_known_is_its_own_sentence(unknown):
    assert words_of(unknown) == unknown
    assert words_of("error/raised") == "The driving system raised an exception"
    assert words_of("R1/going-straight/obstacle") == "Collision with an obstacle; the ego was going straight"
