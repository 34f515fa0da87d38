"""A random generator that plays given draws, and records those that it makes.

Every draw has a standard form, from which the same arithmetic as numpy's makes its value, so a recorded draw gives the
same value to the last bit:

- a uniform number: its position u in the range, in [0, 1);
- a choice among n: the middle of the part of [0, 1] that stands for it;
- a normal number: its distance z from the mean, in standard deviations;
- a shuffle: the choices by which it picks one row after the other.
"""

import sys
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import FrameType
from typing import Any, Final

import gymnasium
import numpy as np

from behavexplor.data.array_types import Array, Floats, Ints
from behavexplor.data.drawn_logical import NORMAL, UNIFORM
from behavexplor.errors import InputError

_SKIPPED: Final = (str(Path(gymnasium.__file__).parent), __file__)
_OUTER: Final = frozenset({"reset", "_reset"})  # functions through which every draw of a reset goes


class DrawnGenerator(np.random.Generator):
    """A generator for one episode of an environment, which plays draws and makes those that are not given.

    Args:
        played: standard forms of draws by the name of the call that makes them.
        source: source of draws that are not given: a seed, from which each of them is made by its own name; or a
            generator, which draws as it would without this class.
        root: source file of the environment's caller; see `CallPath`.
        label: function that gives a number to each draw when it is made.

    Attributes:
        drawn: the standard forms of all draws so far, by the name of the call that made them.
        kinds: their kinds, UNIFORM or NORMAL.
        labels: their labels.
        sequence: name, position and kind of all draws so far, in their order.
    """

    def __init__(
        self,
        played: Mapping[str, Sequence[float]],
        source: int | np.random.Generator,
        root: str,
        label: Callable[[], int] = int,
    ) -> None:
        super().__init__(np.random.PCG64(0))
        self._played = played
        self._source = source
        self._path = CallPath(root, _SKIPPED)
        self.drawn: dict[str, list[float]] = {}
        self.kinds: dict[str, list[str]] = {}
        self.labels: dict[str, list[int]] = {}
        self.sequence: list[tuple[str, int, str]] = []
        self._label = label

    @property
    def count(self) -> int:
        """Number of draws so far."""
        return len(self.sequence)

    def forget_calls(self) -> None:
        """Release the environment's calls, after they have ended."""
        self._path.forget()

    def random(self, size: Any = None, dtype: Any = np.float64, out: Any = None) -> Any:
        """See `numpy.random.Generator.random`."""
        if out is not None or dtype not in (np.float64, float, "float64", "d"):
            raise _unknown("random with `out` or another `dtype`")
        return _shaped(self._draw(UNIFORM, _count(size), lambda source, n: source.random(n)), size)

    def uniform(self, low: Any = 0.0, high: Any = 1.0, size: Any = None) -> Any:
        """See `numpy.random.Generator.uniform`."""
        size = _broadcast(size, low, high)
        shares = self._draw(UNIFORM, _count(size), lambda source, n: source.random(n))
        values = low + np.subtract(high, low) * _shaped(shares, size)
        return float(values) if size is None else values

    def normal(self, loc: Any = 0.0, scale: Any = 1.0, size: Any = None) -> Any:
        """See `numpy.random.Generator.normal`."""
        size = _broadcast(size, loc, scale)
        return loc + scale * _shaped(
            self._draw(NORMAL, _count(size), lambda source, n: source.standard_normal(n)), size
        )

    def standard_normal(self, size: Any = None, dtype: Any = np.float64, out: Any = None) -> Any:
        """See `numpy.random.Generator.standard_normal`."""
        if out is not None or dtype not in (np.float64, float, "float64", "d"):
            raise _unknown("standard_normal with `out` or another `dtype`")
        return self.normal(0.0, 1.0, size)

    def integers(
        self, low: Any, high: Any = None, size: Any = None, dtype: Any = np.int64, endpoint: bool = False
    ) -> Any:
        """See `numpy.random.Generator.integers`."""
        if np.ndim(low) or np.ndim(high if high is not None else 0):
            raise _unknown("integers with arrays of bounds")
        first, last = (0, low) if high is None else (low, high)
        n = int(last) - int(first) + bool(endpoint)
        chosen = self._choices(n, _count(size), lambda source, k: source.integers(n, size=k))
        values = (int(first) + chosen).astype(dtype)
        return values[0] if size is None else values.reshape(size)

    def choice(
        self, a: Any, size: Any = None, replace: bool = True, p: Any = None, axis: int = 0, shuffle: bool = True
    ) -> Any:
        """See `numpy.random.Generator.choice`."""
        items = np.arange(a) if isinstance(a, int | np.integer) else np.asanyarray(a)
        n, count = items.shape[axis], _count(size)
        if not replace and count > 1:
            if p is not None:
                raise _unknown("choice with `p` and without replacement")
            chosen = self._picks(n, count, lambda source: source.choice(n, count, replace=False, shuffle=shuffle))
        elif p is not None:
            chosen = self._weighted(np.asarray(p, dtype=np.float64), count)
        else:
            chosen = self._choices(n, count, lambda source, k: source.choice(n, size=k, replace=True))
        if size is None:
            return int(chosen[0]) if isinstance(a, int) else np.take(items, int(chosen[0]), axis=axis)
        return np.take(items, _shaped(chosen, size), axis=axis)

    def shuffle(self, x: Any, axis: int = 0) -> None:
        """See `numpy.random.Generator.shuffle`."""
        if axis != 0:
            raise _unknown("shuffle along another axis than the first one")
        order = self._order(len(x), np.ndim(x))
        if isinstance(x, np.ndarray):
            x[...] = x[order]
        else:
            x[:] = [x[i] for i in order]

    def permutation(self, x: Any, axis: int = 0) -> Any:
        """See `numpy.random.Generator.permutation`."""
        shuffled = np.arange(x) if isinstance(x, int | np.integer) else np.array(x)
        self.shuffle(shuffled, axis)
        return shuffled

    def _draw(self, kind: str, count: int, native: Callable[[np.random.Generator, int], Any]) -> Floats:
        """Return the standard forms of the next draws of the environment's innermost call, shape (count,).

        `native` draws values by a generator and returns their standard forms.
        """
        name = self._path.name()
        drawn, kinds = self.drawn.setdefault(name, []), self.kinds.setdefault(name, [])
        if isinstance(self._source, np.random.Generator):
            forms = np.asarray(native(self._source, count), dtype=np.float64).ravel().tolist()
        else:
            forms = [self.form(name, len(drawn) + k, kind) for k in range(count)]
        self.sequence += [(name, len(drawn) + k, kind) for k in range(count)]
        drawn += forms
        kinds += [kind] * count
        self.labels.setdefault(name, []).extend([self._label()] * count)
        return np.array(forms)

    def form(self, name: str, position: int, kind: str) -> float:
        """Return the standard form of a draw of an episode without a generator as its source.

        An environment may draw a uniform number where it drew a normal one when the draws were recorded. A given value
        outside of [0, 1) then has no meaning, and the draw is made as if nothing were given.
        """
        given = self._played.get(name, ())
        if position < len(given) and (kind == NORMAL or 0.0 <= given[position] < 1.0):
            return given[position]
        words = [int(self._source), zlib.crc32(name.encode()), position]  # type: ignore[arg-type]
        own = np.random.default_rng(words)
        return own.standard_normal() if kind == NORMAL else own.random()

    def _choices(self, n: int, count: int, native: Callable[[np.random.Generator, int], Any]) -> Ints:
        """Return choices among n, shape (count,). A choice among one is no draw."""
        if n < 1:
            raise ValueError("a choice needs at least one possibility")
        if n == 1:
            return np.zeros(count, dtype=np.int64)
        forms = self._draw(UNIFORM, count, lambda source, k: (np.asarray(native(source, k)) + 0.5) / n)
        return np.minimum((forms * n).astype(np.int64), n - 1)

    def _weighted(self, p: Floats, count: int) -> Ints:
        """Return choices with the probabilities p, shape (count,)."""
        upper = np.cumsum(p)
        upper /= upper[-1]
        lower = np.concatenate([[0.0], upper[:-1]])

        def native(source: np.random.Generator, k: int) -> Floats:
            chosen = source.choice(len(p), size=k, p=p)
            return np.asarray((lower[chosen] + upper[chosen]) / 2)

        forms = self._draw(UNIFORM, count, native)
        return np.minimum(np.searchsorted(upper, forms, side="right"), len(p) - 1)

    def _order(self, n: int, dimensions: int) -> Ints:
        """Return the order of n shuffled rows, shape (n,). The number of dimensions decides how numpy shuffles."""

        def native(source: np.random.Generator) -> Ints:
            rows = np.arange(n).reshape(n, *[1] * (dimensions - 1))
            source.shuffle(rows)
            return rows.ravel()

        return self._picks(n, n, native)

    def _picks(self, n: int, count: int, native: Callable[[np.random.Generator], Array]) -> Ints:
        """Pick `count` of n things one after the other: the standard form of each pick is its place among the rest."""
        sizes = n - np.arange(count)

        def forms_of(source: np.random.Generator, _: int) -> Floats:
            left, places = list(range(n)), []
            for picked in native(source).tolist():
                places.append(left.index(picked))
                left.remove(picked)
            return np.asarray((np.array(places) + 0.5) / sizes)

        forms = self._draw(UNIFORM, count, forms_of)
        left = list(range(n))
        return np.array([left.pop(min(int(form * len(left)), len(left) - 1)) for form in forms], dtype=np.int64)


def _unsupported(method: str) -> Callable[..., Any]:
    def refuse(self: DrawnGenerator, *_: Any, **__: Any) -> Any:  # noqa: ARG001 - it stands for a method
        raise _unknown(method)

    return refuse


def _unknown(what: str) -> InputError:
    return InputError(
        f"The environment draws by {what} of numpy.random.Generator, which cannot be recorded: use random, uniform, "
        f"normal, integers, choice, shuffle or permutation instead"
    )


for _method in dir(np.random.Generator):
    if not _method.startswith("_") and _method != "bit_generator" and _method not in vars(DrawnGenerator):
        setattr(DrawnGenerator, _method, _unsupported(_method))


def _count(size: Any) -> int:
    return 1 if size is None else int(np.prod(size, dtype=np.int64))


def _shaped(values: Array, size: Any) -> Any:
    """Return one number if there is no size, or else an array of that shape."""
    return values[0].item() if size is None else values.reshape(size)


def _broadcast(size: Any, *parameters: Any) -> Any:
    """Return the size of an array of draws, given the shapes of its parameters."""
    shape = np.broadcast_shapes(*(np.shape(parameter) for parameter in parameters))
    return size if size is not None or shape == () else shape


class CallPath:
    """The chain of calls from an environment's method down to a draw, which names the draw.

    An example is "_make_vehicles/_spawn_vehicle#3", where "#3" is the fourth call of the function from the same caller.
    A draw is found by this name and its position among the draws of the innermost call. So it keeps its name when
    another vehicle is rejected and draws less than before.

    Args:
        root: the file of the environment's caller. Calls above it have no part in the name.
        skipped: folders or files whose calls have no part in it either.
    """

    def __init__(self, root: str, skipped: tuple[str, ...]) -> None:
        self._root = root
        self._skipped = skipped
        self._frames: list[FrameType] = []
        self._names: list[str] = []
        self._calls: Counter[str] = Counter()

    def name(self) -> str:
        """Return the name of the chain of calls that leads here."""
        frames = self._chain(sys._getframe(1))  # noqa: SLF001 - the documented way to the caller's frame
        shared = 0
        while shared < min(len(frames), len(self._frames)) and frames[shared] is self._frames[shared]:
            shared += 1
        names = self._names[:shared]
        for frame in frames[shared:]:
            names.append(self._called(names[-1] if names else "", frame.f_code.co_name))
        self._frames, self._names = frames, names
        return names[-1] if names else ""

    def forget(self) -> None:
        """Release the calls that have ended."""
        self._frames, self._names = [], []

    def _called(self, caller: str, function: str) -> str:
        """Return the name of a new call."""
        if function in _OUTER:
            return caller
        path = f"{caller}/{function}" if caller else function
        count = self._calls[path]
        self._calls[path] += 1
        return f"{path}#{count}" if count else path

    def _chain(self, frame: FrameType | None) -> list[FrameType]:
        """Return the calls that have a part in the name, the outermost one first."""
        chain = []
        while frame is not None and frame.f_code.co_filename != self._root:
            code = frame.f_code
            if not (code.co_name.startswith("<") or code.co_filename.startswith(self._skipped)):
                chain.append(frame)
            frame = frame.f_back
        return chain[::-1]
