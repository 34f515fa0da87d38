"""Messages across process boundaries: requests and tagged answers, several at a time. Nothing is ever unpickled."""

import json
from collections.abc import Iterable
from concurrent.futures import Future
from typing import Any, Final, NamedTuple, Self

from behavexplor.errors import InputError, described
from behavexplor.execution.executor import ADS_FAILURES, ADSError

STARTED: Final = b""  # the supervisor's first message: it has written all that a process is started with

# Tags: the first byte of an answer.
READY: Final = b"C"  # the service has begun; followed by the capacity of its batch
RESULT: Final = b"R"  # followed by the result of a call
ADS_FAILED: Final = b"A"  # followed by an `ADSError` as JSON
REFUSED: Final = b"I"  # followed by the message of an `InputError`
FAILED: Final = b"E"  # followed by the message of any other exception
SUSPECT: Final = b"S"  # the call failed in a batch and must be made again alone
MOST_ERROR: Final = 100_000  # bytes of an error that are read
KEY_BYTES: Final = 8  # of the key of a call
SIZE_BYTES: Final = 8  # of the length of a part of a message


class Request(NamedTuple):
    """A call of a function of a service."""

    key: int  # number that identifies the answer
    function: str  # its name
    alone: bool  # True if the worker may process no other call at the same time
    data: bytes  # argument of the function

    def to_bytes(self) -> bytes:
        """Return the request as bytes."""
        return self.key.to_bytes(KEY_BYTES) + bytes([self.alone]) + self.function.encode() + b"\0" + self.data

    @classmethod
    def from_bytes(cls, message: bytes) -> Self:
        """Return the request that `to_bytes` wrote."""
        function, _, data = message[KEY_BYTES + 1 :].partition(b"\0")
        return cls(int.from_bytes(message[:KEY_BYTES]), function.decode(), bool(message[KEY_BYTES]), data)


def packed(parts: Iterable[bytes]) -> bytes:
    """Return parts as one message, each preceded by its length, for `unpacked`."""
    return b"".join(len(part).to_bytes(SIZE_BYTES) + part for part in parts)


def unpacked(message: bytes) -> list[bytes]:
    """Return the parts of a message of `packed`.

    Raises:
        ValueError: if `packed` has not made it.
    """
    parts, begin = [], 0
    while begin < len(message):
        end = begin + SIZE_BYTES + int.from_bytes(message[begin : begin + SIZE_BYTES])
        if end > len(message):
            raise ValueError("the message is too short")
        parts.append(message[begin + SIZE_BYTES : end])
        begin = end
    return parts


def with_key(key: int, answer: bytes) -> bytes:
    """Return an answer with its key, as it is sent."""
    return key.to_bytes(KEY_BYTES) + answer


def answers_in(message: bytes) -> list[tuple[int, bytes]]:
    """Return the answers in a message of a worker, each with its key.

    Raises:
        ValueError: if the message is damaged, or has no answer.
    """
    answers = [(int.from_bytes(part[:KEY_BYTES]), part[KEY_BYTES:]) for part in unpacked(message)]
    if not answers:
        raise ValueError("the message is empty")
    return answers


def error_answer(error: BaseException, place: str = "") -> bytes:
    """Return the answer for a call that raised.

    `place` is a location that is appended to the message, such as " (on the node n7)". ADS failures and rejected input
    do not get it.
    """
    if isinstance(error, ADSError):
        return ADS_FAILED + json.dumps({"kind": error.kind, "message": error.message, "place": error.place}).encode()
    if isinstance(error, InputError):
        return REFUSED + str(error).encode(errors="replace")
    return FAILED + error_words(error, place).encode(errors="replace")


def error_words(error: BaseException, place: str = "") -> str:
    """Return the message of an error, with `place` appended as in `error_answer`."""
    if isinstance(error, ADSError | InputError):
        return str(error)
    words = str(error) if type(error) is RuntimeError else described(error)
    return f"{words}{place}"


def answered_error(answer: bytes) -> Exception | None:
    """Return the exception that an answer stands for; None for a result.

    Raises:
        ValueError: if it is no answer, because the ADS has written it.
    """
    tag, content = answer[:1], answer[1:]
    if tag == RESULT:
        return None
    if tag not in (ADS_FAILED, REFUSED, FAILED):
        raise ValueError("an unknown tag")
    text = content[:MOST_ERROR].decode(errors="replace")  # it may end within a character
    if tag == ADS_FAILED:
        return _ads_error(text)
    return InputError(text) if tag == REFUSED else RuntimeError(text)


def _ads_error(text: str) -> ADSError:
    values = json.loads(text)
    if not (isinstance(values, dict) and {"kind", "message"} <= values.keys() and values["kind"] in ADS_FAILURES):
        raise ValueError("not a failure of an ADS")
    return ADSError(values["kind"], str(values["message"]), str(values.get("place", "")))


def settle(future: "Future[Any]", answer: bytes) -> None:
    """Set the result or the exception of an answer on a future; see `answered_error`."""
    error = answered_error(answer)
    if error is None:
        future.set_result(answer[1:])
    else:
        future.set_exception(error)
