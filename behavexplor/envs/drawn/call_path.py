"""Names for random draws by the place in the program where they are made.

A draw is named by its chain of calls, such as "_make_vehicles/_spawn_vehicle#3", and by its position among the draws
of the innermost call. "#3" is the fourth call of the function from the same caller. So a draw keeps its name when
another vehicle is rejected and draws less than before.
"""

import sys
from collections import Counter
from types import FrameType
from typing import Final

_OUTER: Final = frozenset({"reset", "_reset"})  # functions through which every draw of a reset goes


class CallPath:
    """The chain of calls from an environment's method down to a draw.

    Args:
        root: source file of the caller of the environment. Calls above it, and calls from the places in `skipped`,
            have no part in a name.
        skipped: folders or source files whose calls have no part in a name.
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
