"""The draws of an environment, as they are read from a few of its episodes."""

import re
from collections.abc import Iterator
from typing import Final

from behavexplor.data.drawn_logical import UNIFORM, Draw
from behavexplor.envs.drawn.generator import DrawnGenerator

_COUNT: Final = re.compile(r"#\d+")


class Layout:
    """The draws of an environment by name, with their kinds and the blocks to which they belong.

    Draws belong together if they are made in one of several calls of the same method of the environment, such as one
    that lets a vehicle appear. All other draws belong to the vehicle that is placed next.

    Args:
        env: class of the environment.
    """

    def __init__(self, env: type) -> None:
        self._env = env
        self._kinds: dict[str, list[str]] = {}
        self._next_vehicle: dict[tuple[str, int], int] = {}

    def add(self, generator: DrawnGenerator) -> None:
        """Add the draws of an episode."""
        for name, kinds in generator.kinds.items():
            if len(kinds) > len(self._kinds.get(name, ())):
                self._kinds[name] = list(kinds)
            for position, vehicle in enumerate(generator.labels[name]):
                self._next_vehicle.setdefault((name, position), vehicle)

    def draws(self) -> tuple[Draw, ...]:
        """Return the draws. A call that drew less than another call of the same function gets the other's draws."""
        kinds = self._completed()
        labels = {(name, i): self._label(name, i) for name in sorted(kinds) for i in range(len(kinds[name]))}
        blocks = {label: block for block, label in enumerate(sorted(set(labels.values())))}
        return tuple(
            Draw(name, position, kinds[name][position], blocks[label]) for (name, position), label in labels.items()
        )

    def _completed(self) -> dict[str, list[str]]:
        longest: dict[str, list[str]] = {}
        for name, kinds in self._kinds.items():
            function = _COUNT.sub("", name)
            if len(kinds) > len(longest.get(function, ())):
                longest[function] = kinds
        names = {*self._kinds}
        for name in self._kinds:
            caller, _, function = name.rpartition("/")
            names |= {f"{other}/{function}" for other in self._callers(caller)} if "#" not in function else set()
        return {name: longest.get(_COUNT.sub("", name), [UNIFORM]) for name in names}

    def _callers(self, caller: str) -> Iterator[str]:
        """Yield all calls of the function of a caller."""
        function = _COUNT.sub("", caller)
        for name in self._kinds:
            if _COUNT.sub("", name) == function:
                yield name

    def _label(self, name: str, position: int) -> tuple[str, int]:
        parts = name.split("/")
        for end in range(1, len(parts) + 1):
            call = "/".join(parts[:end])
            function = _COUNT.sub("", parts[end - 1])
            if hasattr(self._env, function) and self._is_repeated(call):
                return call, 0
        return "", self._next_vehicle.get((name, position), 0)

    def _is_repeated(self, call: str) -> bool:
        """Return whether a call is one of several of the same function from the same caller."""
        first = re.sub(r"#\d+$", "", call)
        second = f"{first}#1"
        return any(name == second or name.startswith(f"{second}/") for name in self._kinds)
