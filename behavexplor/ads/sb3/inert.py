"""Read pickles without executing them: a call is kept as a name and its arguments.

A pickle is a program for a machine with a stack. The machine in this module has no instruction that imports or calls
anything. It makes plain values only, and stands for everything else by `Name` and `Inert`.
"""

import io
import pickletools
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, BinaryIO, Final

MAX_STEPS: Final = 300_000  # greatest number of instructions that one reader follows
MAX_PARTS: Final = 100_000  # parts of a value; a part counts as often as it is used
MAX_DEPTH: Final = 40  # nesting depth of a value
MAX_NAME: Final = 1000  # greatest length of a global name
OWN_CODE: Final = "code of its own"  # stands among the names for the call of a class or function in the pickle itself

_PLAIN_KEYS: Final = (str, bytes, float, type(None))
_MAX_INTEGER_KEY: Final = 2**60  # greater integers can have equal hashes
OLD_TORCH: Final = b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19."  # begins a file of torch's format before 1.6
LOAD_TENSOR: Final = "torch.storage._load_from_bytes"  # takes such a file, which contains pickles
_PICKLES: Final = 4  # in such a file, after its beginning
_IMPORT: Final = "cloudpickle.cloudpickle.subimport"
# Callables that call their first argument.
_CALLING: Final = re.compile(r"(copyreg|copy_reg)\.|cloudpickle\.cloudpickle\._make_skeleton_(class|enum)$")


class TooLongError(ValueError):
    """Pickles have more instructions than their reader follows."""


@dataclass(frozen=True)
class Name:
    """A global name in a pickle, which stands for a class or function."""

    name: str  # "module.attribute"


@dataclass(eq=False)
class Inert:
    """The object that a call would have returned."""

    name: str  # global name that would have been called, "module.attribute"
    arguments: tuple[Any, ...] = ()  # arguments of the call
    state: Any = None  # state that the object would have been given; None without a state
    # items that would have been put into the object; pairs of key and value for a mapping
    items: list[Any] = field(default_factory=list)


class PickleReader:
    """Reads pickles, at most `MAX_STEPS` instructions in all of them together."""

    def __init__(self) -> None:
        self._steps = MAX_STEPS

    def read(self, data: bytes) -> tuple[Any, frozenset[str]]:
        """Read a pickle: plain values, with `Name` and `Inert` in place of anything else.

        Returns:
            The value, and all global names ("module.attribute") that the pickle refers to, with those in the files of
            tensors that it contains. The module that cloudpickle would import for a function follows in parentheses.
            `OWN_CODE` is among the names if the pickle calls a class or function that it contains.

        Raises:
            TooLongError: if the pickles have too many instructions.
            ValueError: if the data is not a pickle, is cut short, or has keys of mappings that are not plain.
        """
        value, machine = self._followed(data)
        stored = (self._names_in_file(*arguments) for arguments in machine.loaded)
        return value, frozenset(machine.names).union(*stored)

    def _names_in_file(self, *arguments: Any) -> frozenset[str]:
        """Return the names in a file of tensors that a pickle contains, as torch would read it."""
        unread = frozenset({f"{LOAD_TENSOR} with other things than a tensor"})
        content = arguments[0] if len(arguments) == 1 else None
        if not (isinstance(content, bytes) and content.startswith(OLD_TORCH)):
            return unread
        file = io.BytesIO(content[len(OLD_TORCH) :])
        try:
            machines = [self._followed(file, is_framed=False)[1] for _ in range(_PICKLES)]
        except TooLongError:
            raise
        except ValueError:
            return unread
        inner = any(machine.loaded for machine in machines)
        return unread if inner else frozenset().union(*(machine.names for machine in machines))

    def _followed(self, data: bytes | BinaryIO, *, is_framed: bool = True) -> tuple[Any, "_Machine"]:
        """Return the value of the next pickle in `data`, which may be a file, and the machine that has made it.

        `is_framed` says whether it may have frames, whose ends could hide where the next pickle of a file begins.
        """
        machine = _Machine()
        try:
            for opcode, argument, _ in pickletools.genops(data):
                self._steps -= 1
                if self._steps < 0:
                    raise TooLongError(f"more than {MAX_STEPS} instructions")  # noqa: TRY301
                if opcode.name == "FRAME" and not is_framed:
                    raise ValueError("it has frames")  # noqa: TRY301
                machine.step(opcode.name, argument)
            return machine.stack.pop(), machine
        except TooLongError:
            raise
        except Exception as error:  # a damaged pickle can make the machine raise anything
            raise ValueError(f"not a readable pickle: {type(error).__name__}: {error!s:.200}") from None


def read_pickle(data: bytes) -> tuple[Any, frozenset[str]]:
    """Read a single pickle: its value and the global names in it, as `PickleReader.read` does."""
    return PickleReader().read(data)


def check_extent(value: Any) -> None:
    """Check that the lists, tuples and dictionaries of a value can be walked through.

    Raises:
        ValueError: if they are nested too deeply, or have too many parts. A part that is used many times counts many
            times, because a few nested tuples with shared parts can have billions of them.
    """
    try:
        parts, _ = _extent(value, {})
    except RecursionError:
        raise ValueError("its values are nested too deeply") from None
    if parts > MAX_PARTS:
        raise ValueError(f"its values have more than {MAX_PARTS} parts")


def _extent(value: Any, known: dict[int, tuple[int, int]]) -> tuple[int, int]:
    """Return the number of parts of a value, and their depth."""
    if not isinstance(value, (list, tuple, dict)):
        return 1, 0
    if id(value) not in known:
        known[id(value)] = (0, MAX_DEPTH)  # found if the value contains itself, and too deep then
        extents = [_extent(part, known) for part in (value.values() if isinstance(value, dict) else value)]
        depth = 1 + max((deep for _, deep in extents), default=0)
        if depth > MAX_DEPTH:
            raise ValueError("its values are nested too deeply")
        known[id(value)] = (1 + sum(count for count, _ in extents), depth)
    return known[id(value)]


class _Machine:
    """The machine that follows a pickle's instructions.

    Attributes:
        stack: values since the last mark.
        names: global names, and `OWN_CODE`.
        loaded: arguments of the calls of `LOAD_TENSOR`.
    """

    def __init__(self) -> None:
        self.stack: list[Any] = []
        self.names: set[str] = set()
        self.loaded: list[tuple[Any, ...]] = []
        self._below: list[list[Any]] = []  # values before each mark
        self._memo: dict[int, Any] = {}

    def step(self, opcode: str, argument: Any) -> None:
        """Follow one instruction; `argument` is what `pickletools` reads after its opcode."""
        if opcode in _LITERALS:
            self.stack.append(argument)
        elif opcode in _CONSTANTS:
            self.stack.append(_CONSTANTS[opcode])
        elif opcode in _RECALLS:
            self.stack.append(self._memo[argument])
        elif opcode in _STORES:
            self._memo[len(self._memo) if argument is None else argument] = self.stack[-1]
        elif opcode not in _IGNORED:
            _INSTRUCTIONS[opcode](self, argument)

    def mark(self, _: Any) -> None:
        self._below.append(self.stack)
        self.stack = []

    def since_mark(self) -> list[Any]:
        values, self.stack = self.stack, self._below.pop()
        return values

    def pop(self, _: Any) -> None:
        if self.stack:
            self.stack.pop()
        else:
            self.since_mark()

    def collect(self, make: Callable[[list[Any]], Any]) -> None:
        values = self.since_mark()  # before `self.stack` is looked up, which this replaces
        self.stack.append(make(values))

    def tuple_of(self, count: int) -> None:
        parts = tuple(self.stack[-count:])
        if len(parts) < count:
            raise ValueError("the stack is empty")
        self.stack[-count:] = [parts]

    def put(self, values: list[Any]) -> None:
        """Append values to the list or object on the stack."""
        target = self.stack[-1]
        (target.items if isinstance(target, Inert) else target).extend(values)

    def set_items(self, values: list[Any]) -> None:
        """Set pairs of key and value, given one after the other, in the mapping or object on the stack."""
        target = self.stack[-1]
        pairs = list(zip(values[::2], values[1::2], strict=True))
        if isinstance(target, Inert):
            target.items.extend(pairs)
        else:
            target.update(_dictionary(pairs))

    def name(self, argument: str | None) -> None:
        """Push a global name: a module and an attribute, separated by a space, or as texts on the stack."""
        if argument is None:
            attribute, module = self.stack.pop(), self.stack.pop()
        else:
            module, _, attribute = argument.partition(" ")
        if not (isinstance(module, str) and isinstance(attribute, str) and len(module) + len(attribute) < MAX_NAME):
            raise ValueError("a name must be a short text")
        name = f"{module}.{attribute}"
        self.names.add(name)
        self.stack.append(Name(name))

    def call(self, callee: Any, given: Any) -> None:
        """Push what a call would return."""
        if not isinstance(given, tuple):
            raise TypeError("the arguments of a call must be a tuple")
        if isinstance(callee, Inert) and callee.name.endswith("._builtin_type"):  # cloudpickle's way to name a type
            callee = Name(f"types.{callee.arguments[0]}")
        if callee.name == LOAD_TENSOR:
            self.loaded.append(given)
        if callee.name == _IMPORT:
            self.names.add(f"{_IMPORT}({given[0]:.80})")
        made = given[0] if given and _CALLING.match(callee.name) else callee
        if isinstance(made, Inert):
            self.names.add(OWN_CODE)
        self.stack.append(Inert(callee.name, given))

    def reduce(self, _: Any) -> None:
        arguments, callee = self.stack.pop(), self.stack.pop()
        self.call(callee, arguments)

    def reduce_with_keywords(self, _: Any) -> None:
        _keywords, arguments, callee = self.stack.pop(), self.stack.pop(), self.stack.pop()
        self.call(callee, arguments)

    def instantiate(self, argument: str | None) -> None:
        """Call a class with the values since the mark; without an argument, the first of them is the class."""
        values = self.since_mark()
        if argument is not None:
            self.name(argument)
            values.insert(0, self.stack.pop())
        self.call(values[0], tuple(values[1:]))

    def build(self, _: Any) -> None:
        state = self.stack.pop()
        if not isinstance(self.stack[-1], Inert):
            raise TypeError("it gives a state to something that has none")
        self.stack[-1].state = state


def _dictionary(pairs: list[tuple[Any, Any]]) -> dict[Any, Any]:
    """Return a dictionary with plain keys, whose hashes are fast to compute and differ."""
    for key, _ in pairs:
        is_integer = isinstance(key, int) and abs(key) <= _MAX_INTEGER_KEY
        if not (is_integer or isinstance(key, (*_PLAIN_KEYS, Name))):
            raise ValueError(f"a mapping has a {type(key).__name__} as a key")
    return dict(pairs)


_OF_LITERALS: Final = r"(BIN)?INT[12]?|LONG[14]?|(BIN)?FLOAT|((SHORT_)?BIN)?(STRING|UNICODE|BYTES)8?|BYTEARRAY8|PERSID"
_LITERALS: Final = frozenset(code.name for code in pickletools.opcodes if re.fullmatch(_OF_LITERALS, code.name))
_CONSTANTS: Final[Mapping[str, Any]] = MappingProxyType(
    {"NONE": None, "NEWTRUE": True, "NEWFALSE": False, "EMPTY_TUPLE": ()}
)
_RECALLS: Final = frozenset({"GET", "BINGET", "LONG_BINGET"})
_STORES: Final = frozenset({"PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE"})
_IGNORED: Final = frozenset({"PROTO", "FRAME", "STOP", "BINPERSID"})  # a persistent id stands for its object
_INSTRUCTIONS: Final[Mapping[str, Callable[[_Machine, Any], None]]] = MappingProxyType(
    {
        "MARK": _Machine.mark,
        "POP": _Machine.pop,
        "POP_MARK": lambda machine, _: machine.since_mark().clear(),
        "DUP": lambda machine, _: machine.stack.append(machine.stack[-1]),
        "EMPTY_LIST": lambda machine, _: machine.stack.append([]),
        "EMPTY_DICT": lambda machine, _: machine.stack.append({}),
        "EMPTY_SET": lambda machine, _: machine.stack.append(Inert("builtins.set")),
        "FROZENSET": lambda machine, _: machine.collect(lambda values: Inert("builtins.frozenset", items=values)),
        "LIST": lambda machine, _: machine.collect(list),
        "TUPLE": lambda machine, _: machine.collect(tuple),
        "TUPLE1": lambda machine, _: machine.tuple_of(1),
        "TUPLE2": lambda machine, _: machine.tuple_of(2),
        "TUPLE3": lambda machine, _: machine.tuple_of(3),
        "DICT": lambda machine, _: machine.collect(
            lambda values: _dictionary(list(zip(values[::2], values[1::2], strict=True)))
        ),
        "APPEND": lambda machine, _: machine.put([machine.stack.pop()]),
        "APPENDS": lambda machine, _: machine.put(machine.since_mark()),
        "ADDITEMS": lambda machine, _: machine.put(machine.since_mark()),
        "SETITEM": lambda machine, _: machine.set_items([machine.stack.pop(), machine.stack.pop()][::-1]),
        "SETITEMS": lambda machine, _: machine.set_items(machine.since_mark()),
        "GLOBAL": _Machine.name,
        "STACK_GLOBAL": _Machine.name,
        "REDUCE": _Machine.reduce,
        "NEWOBJ": _Machine.reduce,
        "NEWOBJ_EX": _Machine.reduce_with_keywords,
        "OBJ": _Machine.instantiate,
        "INST": _Machine.instantiate,
        "BUILD": _Machine.build,
    }
)
