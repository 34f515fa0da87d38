"""What happened before a crash, read from highway-env's own objects, and which words about it are untrue.

Nothing here knows how the package finds its names: the lanes are told apart by the names of highway-env's nodes.
"""

import math

from behavexplor.envs.making import make_recorded

SECOND = 1.0
RING = ("se", "ex", "ee", "nx", "ne", "wx", "we", "sx")
STANDING = 0.3


def seen_in(scenario, actions):
    """Drive plain highway-env by actions up to the crash, and return what is known of every vehicle in each frame."""
    env = make_recorded(scenario.setup)
    env.reset(options={"scenario": scenario})
    inner, frames = env.inner, []
    step = inner.road.step

    def look():
        things = [*inner.road.vehicles, *(thing for thing in inner.road.objects if thing.solid and thing.collidable)]
        frames.append({id(thing): state(thing) for thing in things})

    def watched(dt):
        step(dt)
        look()

    inner.road.step = watched
    look()
    kept = [*inner.road.vehicles, *inner.road.objects]  # so that no identity is used again
    for action in actions:
        env.step(action)
        kept += inner.road.vehicles
        if inner.vehicle.crashed:
            break
    ego = id(inner.vehicle)
    crash = next((k for k, frame in enumerate(frames) if frame[ego]["crashed"]), None)
    return {"frames": frames[: None if crash is None else crash + 1], "ego": ego, "has_crashed": crash is not None,
            "rate": inner.config["simulation_frequency"], "kind": type(inner).__name__}  # fmt: skip


def state(thing):
    lane = tuple(thing.lane_index)
    target = getattr(thing, "target_lane_index", None)
    return {
        "obstacle": type(thing).__name__ == "Obstacle",
        "lane": lane,
        "target": lane if target is None else tuple(target),
        "position": tuple(map(float, thing.position)),
        "heading": float(thing.heading),
        "speed": float(thing.speed),
        "length": float(thing.LENGTH),
        "crashed": bool(thing.crashed),
    }


def partner_of(seen):
    last, ego = seen["frames"][-1], seen["ego"]
    others = [key for key, one in last.items() if key != ego and one["crashed"]]
    return min(others, key=lambda key: math.dist(last[key]["position"], last[ego]["position"]), default=None)


def recent(seen, seconds):
    count = round(seconds * seen["rate"]) + 1
    return [frame[seen["ego"]] for frame in seen["frames"]][-count:]


def side_of_change(seen, seconds):
    """The side of the last change of lanes: one that the ego aims at, or that happened within a road."""
    ego, sides = recent(seen, seconds), []
    for k, now in enumerate(ego):
        before = ego[k - 1] if k else now
        if now["target"][:2] == now["lane"][:2] and now["target"][2] != now["lane"][2] and not is_settling(now, seen):
            sides.append(now["target"][2] - now["lane"][2])
        elif before["target"][:2] == now["target"][:2] and before["target"][2] != now["target"][2]:
            sides.append(now["target"][2] - before["target"][2])
        elif now["lane"] == now["target"] and before["lane"] != now["lane"] and before["target"] == now["target"]:
            sides += [now["lane"][2] - before["lane"][2]] if before["lane"][:2] == now["lane"][:2] else []
    sides = [side for side in sides if side]
    return "" if not sides else "right" if sides[-1] > 0 else "left"


def is_settling(now, seen):
    """An ego that has just come from an entry steers to the lane that highway-env gave it, without any command."""
    ego = recent(seen, 3.0)
    return in_ring(now["lane"]) and now["target"] == next(one["target"] for one in ego if in_ring(one["target"]))


def in_ring(lane):
    return lane[0] in RING and lane[1] in RING


def ways(seen, seconds):
    """What the ego did on its roads, in order: the lane at which it aims, but before a junction the one it is on."""
    said = []
    for one in recent(seen, seconds):
        origin, target, _ = one["lane"] if one["lane"][0] in ("o0", "o1", "o2", "o3") else one["target"]
        if origin in RING or target in RING:
            said.append("driving-in" if in_ring(one["target"]) else "entering" if target in RING else "leaving")
        elif origin[:2] == "ir":
            corners = (int(target[2]) - int(origin[2])) % 4
            said.append({1: "turning-left", 2: "going-straight", 3: "turning-right"}[corners])
        else:
            said.append("going-straight")
    return said


def is_true_maneuver(seen, word):
    now, before = side_of_change(seen, SECOND), side_of_change(seen, 3.0)
    if word.startswith("changing-"):
        return word == f"changing-{now}"
    if now:
        return False
    if word.startswith("having-changed-"):
        return word == f"having-changed-{before}" and not {"entering", "leaving"} & set(ways(seen, SECOND))
    return word.removesuffix("-the-ring") in ways(seen, SECOND)


def is_true_partner(seen, word):
    """Return whether a word about the other vehicle, without what it says of its turning, is true."""
    key, word = partner_of(seen), word.removesuffix("-turning")
    history = [frame[key] for frame in seen["frames"] if key in frame]
    if word == "obstacle" or history[-1]["obstacle"]:
        return word == "obstacle" and history[-1]["obstacle"]
    had_crashed = any(one["crashed"] for one in history[:-1])
    if word == "crashed-before" or had_crashed:
        return word == "crashed-before" and had_crashed
    then = max(len(seen["frames"]) - 1 - round(SECOND * seen["rate"]), 0)
    then = next(k for k in range(then, len(seen["frames"])) if key in seen["frames"][k])
    ego, other = seen["frames"][then][seen["ego"]], seen["frames"][then][key]
    return word in true_places(seen["kind"], ego, other)


def true_places(kind, ego, other):
    x, y = (b - a for a, b in zip(ego["position"], other["position"], strict=True))
    cos, sin = math.cos(ego["heading"]), math.sin(ego["heading"])
    ahead, aside = x * cos + y * sin, y * cos - x * sin
    turned = math.remainder(other["heading"] - ego["heading"], math.tau)
    lanes = lanes_apart(kind, ego, other)
    if lanes is not None and abs(turned) < (math.pi * 0.75 if kind == "RoundaboutEnv" else math.pi / 4):
        return placed(lanes, round_ring(ego, other) or ahead, (ego["length"] + other["length"]) / 2)
    if abs(turned) > math.pi * 0.75:
        return {"oncoming"}
    if abs(turned) > math.pi / 4:
        onward = {"leading", "behind"} if shares_way(ego, other) else set()
        return {"crossing-from-left" if turned > 0 else "crossing-from-right", *onward}
    if abs(aside) < 2.0 or shares_way(ego, other):
        return {"leading" if ahead > 0 else "behind", "from-behind" if ahead < 0 else "leading"}
    return {f"merging-from-{'right' if aside > 0 else 'left'}"}


def shares_way(ego, other):
    """Whether one drives on the road on which the other goes on."""
    return ego["target"][1] == other["target"][0] or other["target"][1] == ego["target"][0]


def round_ring(ego, other):
    """How far a vehicle is ahead of the ego around the center, against the clock [m]; 0 if one is not in the ring."""
    if not (in_ring(ego["lane"]) and in_ring(other["lane"])):
        return 0.0
    angles = [math.atan2(*reversed(one["position"])) for one in (ego, other)]
    return -20.0 * math.remainder(angles[1] - angles[0], math.tau)


def lanes_apart(kind, ego, other):
    """How many lanes a vehicle is to the right of the ego, on the same course; None if it is on another."""
    one, two = ego["lane"], other["lane"]
    if kind == "RoundaboutEnv":
        return two[2] - one[2] if (in_ring(one) and in_ring(two)) or one[:2] == two[:2] else None
    if kind == "IntersectionEnv":
        return 0 if one == two else None
    main = [lane[0] in "abc0" and lane[1] in "bcd1" and lane[0] + lane[1] != "kb" for lane in (one, two)]
    return two[2] - one[2] if all(main) else None


def placed(lanes, ahead, room):
    if lanes == 0:
        return {"leading"} if ahead > 0 else {"behind", "from-behind"}
    side = "right" if lanes > 0 else "left"
    if abs(ahead) < room - 0.5:
        return {f"on-the-{side}"}
    beyond = {f"ahead-on-the-{side}" if ahead > 0 else f"behind-on-the-{side}"}
    return beyond | ({f"on-the-{side}"} if abs(ahead) < room + 0.5 else set())


def is_true_fault(seen, fault):
    key = partner_of(seen)
    history = [frame[key] for frame in seen["frames"] if key in frame]
    ego = seen["frames"][-1][seen["ego"]]
    if fault == "ego_cut_in":
        return has_cut_in(seen) and ego["speed"] >= STANDING
    if fault == "struck_stationary":
        return ego["speed"] < STANDING
    if fault == "npc_wreck":
        return any(one["crashed"] for one in history[:-1])
    x, y = (b - a for a, b in zip(ego["position"], history[-1]["position"], strict=True))
    is_behind = x * math.cos(ego["heading"]) + y * math.sin(ego["heading"]) < 0
    if fault != "npc_rear_end":
        return True
    return is_behind and history[-1]["speed"] > ego["speed"] and (ego["speed"] < STANDING or not has_cut_in(seen))


def has_cut_in(seen):
    return bool(side_of_change(seen, 3.0)) or "entering" in ways(seen, 3.0)


def untrue_words(seen, class_id, fault):
    """Return the untrue words of a class of R1 or R3 and of the verdict on a collision, and their number."""
    spec, maneuver, conflict = class_id.split("/")[:3]
    checked = {maneuver: is_true_maneuver(seen, maneuver)}
    if spec == "R1":
        checked |= {conflict: is_true_partner(seen, conflict), str(fault): is_true_fault(seen, fault)}
    return [word for word, is_true in checked.items() if not is_true], len(checked)
