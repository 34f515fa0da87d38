"""Contact of the ego with lines, and collisions of all vehicles: `RoadObject.handle_collisions`.

There are two tests of boxes. They decide differently where boxes touch without overlapping: `boxes_touch` of
`behavexplor.data.box_kernels`, and `_contact` here, which is highway-env's and also foresees contact.
"""

import math
from typing import Final

from behavexplor.data.array_types import Floats
from behavexplor.data.box_kernels import Corners, corners, line_distance, line_meets_box, span
from behavexplor.data.conventions import EGO_SIZE
from behavexplor.envs.engine.state import OBSTACLE, Records, Traits, Vehicle
from behavexplor.jit import kernel_inner

RADIUS: Final = math.hypot(*EGO_SIZE) / 2  # distance of the ego's corners from its center [m]


@kernel_inner
def touches_line(lines: Floats, x: float, y: float, cos: float, sin: float) -> bool:
    """Return whether the ego's box touches any of the lines, shape (lines, 4): x and y of both ends [m].

    `x` and `y` are the ego's center [m], `cos` and `sin` those of its heading.
    """
    for i in range(len(lines)):
        ax, ay, bx, by = lines[i, 0], lines[i, 1], lines[i, 2], lines[i, 3]
        # farther from the ego than its radius, along x or y
        if min(ax, bx) - x > RADIUS or x - max(ax, bx) > RADIUS or min(ay, by) - y > RADIUS or y - max(ay, by) > RADIUS:
            continue
        if line_distance(x, y, ax, ay, bx, by) > RADIUS:
            continue
        if line_meets_box(corners(x, y, cos, sin, EGO_SIZE[0], EGO_SIZE[1]), ax, ay, bx, by):
            return True
    return False


@kernel_inner
def collide(vehicles: Records, traits: Records, n_vehicles: int, n_obstacles: int, dt: float, xs: Floats) -> None:
    """Find collisions of all pairs, and note the crashes and the pushes that part them in `vehicles`.

    `vehicles` has the vehicles, then the obstacles. `dt` is the duration of a frame, for which a collision is foreseen
    [s], and `xs` working memory for the positions along x, shape (N,).

    Most pairs are passed over at once, because they are too far apart along x, or because neither checks collisions.
    """
    longest = 0.0
    end_of_checking = 0  # after the last one that checks collisions
    for j in range(n_vehicles + n_obstacles):
        xs[j] = vehicles[j].x
        longest = max(longest, traits[j].diameter)
        if traits[j].checks_collisions:
            end_of_checking = j + 1
    for i in range(n_vehicles):
        x, reach = xs[i], (traits[i].diameter + longest) / 2 + vehicles[i].speed * dt
        end = n_vehicles + n_obstacles if traits[i].checks_collisions else end_of_checking
        after = xs[i + 1 : end]
        for k in range(_count_within(after, x, reach)):
            j = i + 1 + k
            if abs(xs[j] - x) <= reach:
                _collide_pair(vehicles[i], traits[i], vehicles[j], traits[j], dt)


@kernel_inner
def _count_within(xs: Floats, x: float, reach: float) -> int:
    """Return how many of the first positions contain all that are within reach of x [m]: one pass without branches."""
    end = 0
    for k in range(len(xs)):
        end = max(end, k + 1 if abs(xs[k] - x) <= reach else 0)
    return end


@kernel_inner
def _collide_pair(vehicle: Vehicle, traits: Traits, other: Vehicle, other_traits: Traits, dt: float) -> None:
    """Find a collision of two vehicles, or of a vehicle and an obstacle: `RoadObject.handle_collisions`."""
    if not (traits.checks_collisions or other_traits.checks_collisions):
        return
    dx, dy = other.x - vehicle.x, other.y - vehicle.y
    if math.sqrt(dx * dx + dy * dy) > (traits.diameter + other_traits.diameter) / 2 + vehicle.speed * dt:
        return
    a, b = _box(vehicle, traits), _box(other, other_traits)
    motion_x = vehicle.speed * vehicle.cos * dt - other.speed * other.cos * dt
    motion_y = vehicle.speed * vehicle.sin * dt - other.speed * other.sin * dt
    is_now, is_soon, push_x, push_y = _contact(a, b, motion_x, motion_y)
    if is_soon:
        parts = 1.0 if other_traits.kind == OBSTACLE else 2.0  # an obstacle does not move
        vehicle.impact_x, vehicle.impact_y, vehicle.has_impact = push_x / parts, push_y / parts, True
        if other_traits.kind != OBSTACLE:
            other.impact_x, other.impact_y, other.has_impact = -push_x / 2, -push_y / 2, True
    if is_now:
        vehicle.crashed = other.crashed = True


@kernel_inner
def _box(vehicle: Vehicle, traits: Traits) -> Corners:
    """Compute the corners of a vehicle. They are those of `RoadObject.polygon`, which lists the third of them first."""
    return corners(vehicle.x, vehicle.y, vehicle.cos, vehicle.sin, traits.length, traits.width)


@kernel_inner
def _contact(a: Corners, b: Corners, dx: float, dy: float) -> tuple[bool, bool, float, float]:
    """Return whether two boxes overlap, whether they will within the frame, and the push that parts them [m].

    `dx` and `dy` are the motion of box a relative to box b [m].

    This is `highway_env.utils.are_polygons_intersecting`. It ends early only if the rest cannot change the result.
    """
    is_now = is_soon = True
    least = math.inf
    push_x = push_y = 0.0
    for side in range(8):
        xs, ys = a if side < 4 else b
        start, end = (side + 2) % 4, (side + 3) % 4  # as in `RoadObject.polygon`: the first of equal gaps counts
        nx, ny = -ys[end] + ys[start], xs[end] - xs[start]
        norm = math.sqrt(nx * nx + ny * ny)
        nx, ny = nx / norm, ny / norm
        low_a, high_a = span(a, nx, ny)
        low_b, high_b = span(b, nx, ny)
        if _gap(low_a, high_a, low_b, high_b) > 0:
            is_now = False
        motion = nx * dx + ny * dy
        if motion < 0:
            low_a += motion
        else:
            high_a += motion
        gap = _gap(low_a, high_a, low_b, high_b)
        if gap > 0:
            is_soon = False
        if not is_now and not is_soon:
            break
        if abs(gap) < least:
            least = abs(gap)
            ax, ay = _center(a)
            bx, by = _center(b)
            sign = 1.0 if (ax - bx) * nx + (ay - by) * ny > 0 else -1.0
            push_x, push_y = sign * nx, sign * ny
    return is_now, is_soon, least * push_x, least * push_y


@kernel_inner
def _gap(low_a: float, high_a: float, low_b: float, high_b: float) -> float:
    """Compute the distance of two intervals, negative if they overlap: `highway_env.utils.interval_distance`."""
    return low_b - high_a if low_a < low_b else low_a - high_b


@kernel_inner
def _center(box: Corners) -> tuple[float, float]:
    """Compute a box's center. Its corners are added in the order of `RoadObject.polygon`, for equal roundings."""
    xs, ys = box
    return (xs[2] + xs[3] + xs[0] + xs[1]) / 4, (ys[2] + ys[3] + ys[0] + ys[1]) / 4
