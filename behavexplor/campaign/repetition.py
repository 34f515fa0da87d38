"""Repetition of a stored execution, to see whether it is reproducible."""

from dataclasses import dataclass

from behavexplor.campaign.judgment import ads_failure
from behavexplor.campaign.store import Execution
from behavexplor.data.trace import Trace
from behavexplor.errors import sentence
from behavexplor.execution.ads_error import ADSError
from behavexplor.execution.evaluator import EXECUTE
from behavexplor.execution.executor import Executor


@dataclass(frozen=True)
class Repetition:
    """The outcome of running an execution again.

    Attributes:
        reproduced: whether it was the same again, to the last bit.
        words: the outcome as a sentence.
    """

    reproduced: bool
    words: str


def repeat_execution(executor: Executor, execution: Execution) -> Repetition:
    """Run a stored execution again, with an executor of the same target."""
    try:
        again = executor.submit(EXECUTE, execution.scenario.to_json().encode()).result()
    except ADSError as error:
        if execution.record.error == ads_failure(error):
            words = f"running it again, the ADS failed in the same way{error.place}"
            return Repetition(True, f"The failure was reproduced: {words}.")
        return Repetition(False, sentence(f"The execution was NOT reproduced: running it again, {error}"))
    if Trace.from_bytes(again).to_bytes() != execution.load_trace().to_bytes():
        return Repetition(False, "The execution was NOT reproduced: running it again gave a different trace.")
    return Repetition(True, "The execution was reproduced: running it again gave the same trace.")
