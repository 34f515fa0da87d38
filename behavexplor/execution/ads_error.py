"""The exception for a driving system that fails."""

from behavexplor.judge.specs import DIFFERS


class ADSError(Exception):
    """An ADS failed instead of returning an action.

    Attributes:
        kind: kind of the failure: "raised" (it raised an exception), "invalid" (its answer is not a valid action),
            "exit" (it called `sys.exit`), "memory" (it ran out of memory), "hang" (it did not answer in time),
            "crash" (its process died), or "differs" (highway-env did not confirm what the compiled engine found; see
            `behavexplor.execution.confirmation`).
        message: details of the failure.
        place: where the ADS raised an exception, see `behavexplor.errors.place_of`. It is no part of a record.
    """

    def __init__(self, kind: str, message: str, place: str = "") -> None:
        what = "highway-env did not confirm it" if kind == DIFFERS else f"the ADS failed ({kind})"
        super().__init__(f"{what}: {message}{place}")
        self.kind = kind
        self.message = message
        self.place = place
