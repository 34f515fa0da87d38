"""Traces: the record of one episode, as arrays; and the names of weaknesses in the log of the rule planner."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from behavexplor.data.array_types import Array, Bools, Floats, Ints
from behavexplor.data.motion_bytes import MOST_VALUES, pack_arrays, pack_motion, unpack_arrays, unpack_motion
from behavexplor.data.untrusted import MAX_ARRAY_BYTES
from behavexplor.errors import InputError

RESOLUTION = 1e-9  # precision of recorded motion, in m, rad and m/s
TRACE_FORMAT = 3
MOST_FRAMES = 1_000_000
MOST_PLACES = MOST_VALUES // 2  # of all vehicles in all frames
LONGEST = 100_000.0  # duration of an episode [s]; 10 000 decisions may take so long
MOST_POINTS = 200_000  # of a route
MOST_CONTACTS = 100_000_000  # of frames and illegal lines that are compared
_COUNTED = ("frames", "vehicles times frames", "seconds", "points of the route", "illegal lines times frames")
ENDS = ("collision", "arrived", "passed", "standstill", "timeout", "error", "off-road", "ended")
ABSENT = 1e5  # both coordinates of a vehicle while it is absent, far from every road [m]
CRASHED, OFF_ROAD, ARRIVED = "crashed", "off_road", "arrived"  # names of signals; `ARRIVED` is a kind of end, too
CHANGING, WAY, WRECKS = "changing_lanes", "way", "wrecks"
PARTNER, PARTNER_LANES = "partner", "partner_lanes"
WAYS: Final = (  # what an ego does on the road on which it is, by the value of the signal `WAY`
    "going-straight",
    "turning-left",
    "turning-right",
    "entering-the-ring",
    "driving-in-the-ring",
    "leaving-the-ring",
)
ELSEWHERE, ON_ITS_WAY, OBSTACLE = range(3)  # values of the signal `PARTNER`
_MOTION = ("position", "heading", "velocity")
_PACKED = (*_MOTION, "present")  # arrays whose elements are single bytes in a file
_NO_ARRAYS: Mapping[str, Floats] = MappingProxyType({})
_ALL_PRESENT = np.ones((0, 0), dtype=bool)
_ALL_PRESENT.setflags(write=False)  # all traces share it
_NOTHING_MORE = {"decisions": _NO_ARRAYS, "signals": _NO_ARRAYS, "present": _ALL_PRESENT, "partner": -1}
_OTHERS = ("end", "decisions", "signals", "present", "partner")  # fields that are no arrays, or need not be given
# The weaknesses that the paper found in Apollo 6.0 (section 4.1.2); each is a bit in the log of the rule planner.
WEAKNESS_NAMES: Final = (
    *(f"R1-{i}" for i in range(1, 9)),
    *(f"R2-{i}" for i in range(1, 5)),
    *(f"R3-{i}" for i in range(1, 5)),
)
ENVIRONMENT: Final = "environment"  # cause of a failure that no weakness explains: the planner without any fails too
UNKNOWN: Final = "unknown"  # cause of a failure for which no single weakness is to blame


@dataclass(frozen=True, eq=False)
class Trace:
    """The record of one episode with T frames and N vehicles, of which the ego is the first.

    Every simulation step is a frame, so a trace lacks nothing that the simulator computed. Motion is rounded to
    `RESOLUTION`, so a trace that is read from a file equals the recorded one. Arrays are read-only.

    Attributes:
        time: time of each frame, increasing from 0, shape (T,) [s]; T >= 1.
        position: centers, shape (T, N, 2) [m].
        heading: headings, shape (T, N) [rad].
        velocity: velocities, shape (T, N, 2) [m/s].
        size: length and width, shape (N, 2) [m].
        actions: commands of the driving system (ADS), shape (D, A), in the units of its action space.
        action_frame: frame at which each command was given, shape (D,).
        route: center line of the ego's route, from its start to past its destination, shape (P, 2) [m].
        destination: the ego's destination, shape (2,) [m].
        illegal_lines: end points of the lines that must not be touched, shape (L, 2, 2) [m].
        end: kind of end: "collision", "arrived", "passed" (the destination), "standstill", "timeout", "off-road",
            "ended" (by another rule of the environment), or "error" if the ADS failed instead of returning an action.
        decisions: the ADS's own log, as arrays by name, each of shape (D, ...).
        signals: what a highway-env environment itself says in each frame, as arrays by name, each of shape (T,). A
            signal is missing if it means nothing in the environment. Without signals, the specs judge by the vehicles'
            boxes. "crashed", "off_road" and "arrived" are 1 or 0 for the ego; so is "wrecks" for all vehicles, but of
            shape (T, N). "changing_lanes" is -1 while the ego changes lanes to the left, 1 to the right, else 0. "way"
            is what the ego does, a place in `WAYS`. "partner" says where the vehicle `partner` is: `ELSEWHERE`,
            `ON_ITS_WAY` (on the ego's road or one that follows or precedes it), or whether it is an `OBSTACLE`.
            "partner_lanes" says how many lanes it is to the right of the ego's, if it is on its way.
        present: whether each vehicle is present, shape (T, N); empty if all vehicles are present in all frames. An
            absent vehicle stands at `ABSENT`.
        partner: the vehicle that the ego crashed into, as far as the environment tells, an index of `size`; -1 if there
            is none, or if the vehicles' boxes tell.

    Raises:
        InputError: if the trace is too large, or the shape or a value of a field is wrong; the message names the field.
    """

    time: Floats
    position: Floats
    heading: Floats
    velocity: Floats
    size: Floats
    actions: Floats
    action_frame: Ints
    route: Floats
    destination: Floats
    illegal_lines: Floats
    end: str
    decisions: Mapping[str, Floats] = field(default_factory=dict)
    signals: Mapping[str, Floats] = field(default_factory=dict)
    present: Bools = field(default_factory=lambda: np.ones((0, 0), dtype=bool))
    partner: int = field(default_factory=lambda: -1)  # a default of the class would hide it from `__getattr__`

    def __post_init__(self) -> None:
        self._freeze(step=RESOLUTION)
        self._validate()

    def _freeze(self, step: float | None) -> None:
        """Make all arrays read-only. Motion is rounded to multiples of `step` if that is given."""
        for name in _ARRAYS:
            kind = np.int64 if name == "action_frame" else np.float64
            rounded = step if name in _MOTION else None
            object.__setattr__(self, name, _frozen(name, getattr(self, name), kind, rounded))
        for name in ("decisions", "signals"):
            object.__setattr__(self, name, _frozen_mapping(name, getattr(self, name)))
        present = _frozen("present", self.present, np.bool_)
        object.__setattr__(self, "present", present[:0, :0] if present.ndim == 2 and present.all() else present)

    def _validate(self) -> None:
        frames, vehicles, decisions = _rows(self.time), _rows(self.size), _rows(self.action_frame)
        shapes: dict[str, tuple[int | None, ...]] = {
            "time": (frames,),
            "position": (frames, vehicles, 2),
            "heading": (frames, vehicles),
            "velocity": (frames, vehicles, 2),
            "size": (vehicles, 2),
            "actions": (decisions, None),
            "action_frame": (decisions,),
            "route": (None, 2),
            "destination": (2,),
            "illegal_lines": (None, 2, 2),
            "present": (frames, vehicles) if self.present.size else (0, 0),
        }
        for name, expected in shapes.items():
            _check_shape(name, getattr(self, name), expected)
        self._validate_decisions()
        for name, values in self.signals.items():
            _check_shape(f"signals[{name!r}]", values, (frames, vehicles) if name == WRECKS else (frames,))
        if frames == 0 or vehicles == 0:
            raise InputError("time: a trace needs at least one frame, and an ego in size")
        self._check_extent()
        if self.time[0] != 0 or (self.time[1:] <= self.time[:-1]).any():
            raise InputError("time: must begin at 0 and increase")
        if len(self.route) < 2:
            raise InputError("route: at least two points are needed")
        if ((self.action_frame < 0) | (self.action_frame >= frames)).any():
            raise InputError(f"action_frame: must lie in [0, {frames})")
        if self.end not in ENDS:
            raise InputError(f"end: expected one of {', '.join(ENDS)}, got {self.end!r}")
        if not (isinstance(self.partner, int) and -1 <= self.partner < vehicles and self.partner != 0):
            raise InputError(f"partner: expected a vehicle other than the ego, or -1, got {self.partner!r:.80}")

    def _check_extent(self) -> None:
        """Refuse a trace that would take minutes or gigabytes to judge and to draw."""
        frames, vehicles, lines = len(self.time), len(self.size), len(self.illegal_lines)
        counts = (frames, vehicles * frames, self.time[-1], len(self.route), lines * frames)
        limits = (MOST_FRAMES, MOST_PLACES, LONGEST, MOST_POINTS, MOST_CONTACTS)
        for what, count, most in zip(_COUNTED, counts, limits, strict=True):
            if count > most:
                raise InputError(f"A trace has at most {most:,.0f} {what}, not {count:,.0f}")

    def _validate_decisions(self) -> None:
        for name, values in self.decisions.items():
            _check_shape(f"decisions[{name!r}]", values, (len(self.action_frame), *values.shape[1:]))

    def __deepcopy__(self, memo: object) -> Self:
        return self  # a trace is immutable

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self).from_bytes, (self.to_bytes(),)

    @property
    def duration(self) -> float:
        """Simulated time [s]."""
        return float(self.time[-1])

    @property
    def destination_distance(self) -> float:
        """Distance of the ego's last position from the destination [m]."""
        return float(np.hypot(*(self.position[-1, 0] - self.destination)))

    def recent(self, frame: int, seconds: float) -> Ints:
        """Return the frames of the last `seconds` [s] up to and including a frame."""
        return np.arange(np.searchsorted(self.time, self.time[frame] - seconds - 1e-9), frame + 1)

    def until(self, frames: int, end: str) -> Self:
        """Return the trace of the first `frames` frames, at least 1, as if the episode had ended there by `end`."""
        given = self.action_frame < frames
        return replace(
            self,
            time=self.time[:frames],
            position=self.position[:frames],
            heading=self.heading[:frames],
            velocity=self.velocity[:frames],
            actions=self.actions[given],
            action_frame=self.action_frame[given],
            end=end,
            decisions={name: values[given] for name, values in self.decisions.items()},
            signals={name: values[:frames] for name, values in self.signals.items()},
            present=self.present[:frames],
        )

    def with_decisions(self, decisions: Mapping[str, Array]) -> Self:
        """Return the same trace with another log of the ADS: arrays by name, each of shape (D, ...).

        Raises:
            InputError: if the shape or a value of an array is wrong.
        """
        changed = object.__new__(type(self))
        changed.__dict__.update(self.__dict__)  # what is already validated
        object.__setattr__(changed, "decisions", _frozen_mapping("decisions", decisions))
        changed._validate_decisions()
        return changed

    @classmethod
    def of_valid(cls, *, end: str, **arrays: Array) -> Self:
        """Return a trace of arrays that are known to be valid, without the time that checking and copying them takes.

        Args:
            end: kind of end.
            arrays: all fields but the optional ones, as this class keeps them: contiguous and read-only, motion in
                multiples of `RESOLUTION`.

        Raises:
            InputError: if the trace is too large.
        """
        trace = object.__new__(cls)
        trace.__dict__.update(arrays, end=end, **_NOTHING_MORE)
        trace._check_extent()
        return trace

    def to_bytes(self) -> bytes:
        """Return the trace as compressed bytes. Equal traces give equal bytes, and `from_bytes` restores them."""
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        for name in _MOTION:
            arrays[name] = pack_motion(arrays[name], RESOLUTION)
        arrays |= {f"decisions.{name}": values for name, values in self.decisions.items()}
        arrays |= {f"signals.{name}": values for name, values in self.signals.items()}
        if self.present.size:
            arrays["present"] = self.present
        if self.partner >= 0:
            arrays["partner"] = np.array(self.partner)
        end = np.frombuffer(self.end.encode(), dtype=np.uint8)
        return pack_arrays({"format": np.array(TRACE_FORMAT), "end": end, **arrays})

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """Read a trace from bytes that `to_bytes` wrote. No code in them is executed.

        Raises:
            InputError: if the data is not a trace, or is damaged.
        """
        try:
            values = unpack_arrays(data)
        except ValueError as error:
            raise InputError(f"Not a trace, or a damaged one: {error}") from None
        missing = {"format", "end", *_ARRAYS} - values.keys()
        if missing:
            raise InputError(f"Not a trace: {', '.join(sorted(missing))} is missing")
        if values["format"].shape or values["format"] != TRACE_FORMAT:
            raise InputError(f"This trace has format {values['format']}; this version reads format {TRACE_FORMAT}")
        if sum(array.size for name, array in values.items() if name not in _PACKED) > MAX_ARRAY_BYTES // 8:
            raise InputError("Not a trace: its arrays would take more memory than those that are written")
        arrays = {name: values[name] for name in _ARRAYS}
        for name in _MOTION:
            arrays[name] = unpack_motion(arrays[name], arrays["time"].size, RESOLUTION)
        trace = object.__new__(cls)
        trace.__dict__.update(
            arrays,
            end=values["end"].tobytes().decode(errors="replace"),
            decisions=_part(values, "decisions."),
            signals=_part(values, "signals."),
            present=values.get("present", _ALL_PRESENT),
            partner=_whole_number("partner", values["partner"]) if "partner" in values else -1,
        )
        trace._freeze(step=None)  # unpacked motion consists of multiples of the resolution
        trace._validate()
        return trace

    @classmethod
    def of_packed(cls, data: bytes, **computed: NDArray[Any]) -> Self:
        """Return the trace in valid bytes. They are read when a field is asked for.

        Args:
            data: bytes that `to_bytes` wrote.
            computed: what has been computed from the trace, by names that are not those of fields.
        """
        trace = object.__new__(cls)
        trace.__dict__.update(computed, _packed=data)
        return trace

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Read the bytes of `of_packed`, and return an attribute that was missing before."""
            data = self.__dict__.get("_packed")
            if data is None or name not in _FIELDS:
                raise AttributeError(f"a trace has no attribute {name!r}")
            self.__dict__.update(vars(self.from_bytes(data)) | self.__dict__)
            return self.__dict__[name]


_FIELDS = frozenset(f.name for f in fields(Trace))
_ARRAYS = tuple(f.name for f in fields(Trace) if f.name not in _OTHERS)


def _whole_number(name: str, value: Array) -> int:
    if np.shape(value) != () or value.dtype.kind not in "iu":
        raise InputError(f"{name}: expected a whole number, got {' '.join(repr(value).split())[:80]}")
    return int(value)


def _part(values: Mapping[str, Array], prefix: str) -> dict[str, Array]:
    """Return the arrays whose names begin with a prefix, without the prefix."""
    return {name.removeprefix(prefix): values[name] for name in values if name.startswith(prefix)}


def _frozen_mapping(name: str, values: Any) -> Mapping[str, Floats]:
    """Return arrays by name as a read-only mapping of read-only arrays, sorted by name."""
    if not isinstance(values, Mapping):
        raise InputError(f"{name}: expected arrays by name, got {values!r:.80}")
    return MappingProxyType({key: _frozen(f"{name}[{key!r}]", values[key], np.float64) for key in sorted(values)})


def _frozen(name: str, values: Any, kind: type[np.generic], step: float | None = None) -> Array:
    """Return a read-only array of the same values, rounded to multiples of `step` if that is given.

    Values that are not numbers, or would lose a fraction, are refused.
    """
    try:
        given = np.asarray(values)
    except ValueError:  # rows of different lengths
        given = np.asarray(None)
    if given.dtype.kind not in "biuf":
        raise InputError(f"{name}: expected an array of numbers, got {' '.join(repr(values).split())[:80]}")
    if kind is np.int64 and given.dtype.kind == "f" and not (np.isfinite(given) & (given == np.rint(given))).all():
        raise InputError(f"{name}: every value must be a whole number")
    if step is None and given.dtype == kind and given.base is None and not given.flags.writeable:
        return given  # the arrays of a map belong to all its traces
    array: Array = given.astype(kind)
    if step is not None:
        array /= step
        np.rint(array, out=array)
        array *= step
    array.setflags(write=False)
    return array


def _rows(array: Array) -> int:
    return array.shape[0] if array.ndim else 1


def _check_shape(name: str, array: NDArray[np.generic], expected: tuple[int | None, ...]) -> None:
    fits = len(expected) == array.ndim
    for size, actual in zip(expected, array.shape, strict=False):
        fits = fits and size in (None, actual)
    if not fits:
        wanted = tuple("any" if size is None else size for size in expected)
        raise InputError(f"{name}: expected shape {wanted}, got {array.shape}")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise InputError(f"{name}: every value must be finite")


def bit_of(name: str) -> int:
    """Return the bit of a weakness in an entry of the decision log."""
    return 1 << WEAKNESS_NAMES.index(name)


def weakness_names(bits: int) -> tuple[str, ...]:
    """Return the weaknesses in an entry of the decision log, such as `trace.decisions["triggered"][i]`."""
    return tuple(name for i, name in enumerate(WEAKNESS_NAMES) if int(bits) >> i & 1)
