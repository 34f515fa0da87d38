"""Services: functions from bytes to bytes that worker processes offer, and the recipes by which they are made."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Protocol


class Batch(Protocol):
    """Processes many requests at a time."""

    capacity: int  # greatest number of requests at a time

    def begin(self, key: int, request: bytes) -> None:
        """Take one more request."""

    def advance(self) -> list[tuple[int, bytes | Exception | None]]:
        """Advance all requests by one step, and return the key of each that is done, with its result or exception.

        A result of None means that the request must be called again alone.
        """


class Service:
    """The functions that a process offers, by name. One of them may be called in batches.

    The constructor takes JSON values as keyword arguments and is cheap. `begin` loads what the functions need.
    """

    functions: Mapping[str, Callable[[bytes], bytes]]  # functions from bytes to bytes, by name
    # whether the process gives up rights, see `confine`, and has no terminal, because third-party code will run in it
    is_confined: bool = False
    batch: Batch | None = None  # processes many calls of `Recipe.batched` at a time; None if each is made alone

    def prepare(self) -> None:
        """Prepare this machine, in the supervisor's process, before the first worker starts."""

    def confine(self) -> None:
        """Give up rights of this process. This is called first, while the process has a single thread."""

    def begin(self) -> None:
        """Load what the functions need.

        Raises:
            InputError: if something cannot be loaded.
        """

    def stop(self) -> None:
        """End a long call early, as soon as its partial result is saved. This is called from a signal handler."""


@dataclass(frozen=True)
class Recipe:
    """Recipe for making a service: plain data that can be sent to other processes and machines."""

    service: str  # class of the service as "package.module:name"
    settings: Mapping[str, Any] = field(default_factory=dict)  # keyword arguments of the class, as JSON values
    batched: str = ""  # name of the function that is called in batches; empty for none
    preload: tuple[str, ...] = ()  # modules that are imported once for all processes, where the system can share them
    # whether a call lasts as long as a campaign. Each process then takes a single call, may start processes of its own,
    # and calls `stop` on SIGTERM.
    long_calls: bool = False
    together: int = 1  # number of answers of a batch in one message, as far as they come without a pause

    def make(self) -> Service:
        """Make the service in this process."""
        module, _, name = self.service.partition(":")
        service: Service = getattr(import_module(module), name)(**self.settings)
        return service
