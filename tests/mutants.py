"""How strong the tests are: small faults are planted in the package, one at a time, and the tests must find them.

    python -m tests.mutants --seed 1 --count 60

A fault stands in a random line of code, as real ones look: another comparison, sign or constant, an argument or a
statement left out, `and` for `or`, `min` for `max`. For each, the tests of its folder run; those that survive also meet
the whole suite with `--whole`. Which survivors change nothing is for a reader to say.
"""

import argparse
import ast
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
FOLDERS = {  # of the package, with the tests that are theirs
    "judge": "tests/judge",
    "behavior": "tests/behavior",
    "campaign": "tests/campaign",
    "execution": "tests/execution",
    "fuzz": "tests/fuzz",
    "envs/engine": "tests/envs",
}
WHOLE_TIME_LIMIT = 3600  # s, for the whole suite: what hangs is found
COMPARISONS = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
}  # fmt: skip
OPERATORS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Div, ast.Mod: ast.Mult,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
}  # fmt: skip
NAMES = {"min": "max", "any": "all", "sin": "cos", "argmin": "argmax", "minimum": "maximum", "floor": "ceil"}
NAMES |= {there: here for here, there in NAMES.items()}


@dataclass(frozen=True)
class Fault:
    path: str  # of the module, from the root
    line: int
    before: str
    after: str
    source: str  # of the whole module

    def __str__(self):
        return f"{self.path}:{self.line}: {' '.join(self.before.split())}  ->  {' '.join(self.after.split()) or 'gone'}"


def replacements(node):
    """Yield what may stand in place of a node."""
    yield from other_operators(node)
    yield from other_constants(node)
    match node:
        case ast.Call(func=func, args=args, keywords=keywords) if keywords:
            for i in range(len(keywords)):
                yield ast.Call(func, args, keywords[:i] + keywords[i + 1 :])
        case ast.Name(id=name) if name in NAMES:
            yield ast.Name(NAMES[name])
        case ast.Attribute(value=value, attr=name) if name in NAMES:
            yield ast.Attribute(value, NAMES[name])
        case ast.Expr(value=ast.Call()):
            yield ast.Pass()
        case ast.IfExp(test=_, body=body, orelse=orelse):
            yield body
            yield orelse


def other_operators(node):
    match node:
        case ast.Compare(left=left, ops=[one], comparators=others) if type(one) in COMPARISONS:
            yield ast.Compare(left, [COMPARISONS[type(one)]()], others)
        case ast.BinOp(left=left, op=op, right=right) if type(op) in OPERATORS and not is_type(node):
            yield ast.BinOp(left, OPERATORS[type(op)](), right)
        case ast.AugAssign(target=target, op=op, value=value) if type(op) in OPERATORS:
            yield ast.AugAssign(target, OPERATORS[type(op)](), value)
        case ast.BoolOp(op=op, values=values):
            yield ast.BoolOp(ast.Or() if isinstance(op, ast.And) else ast.And(), values)
        case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
            yield operand


def other_constants(node):
    match node:
        case ast.Constant(value=bool() as value):
            yield ast.Constant(not value)
        case ast.Constant(value=int() as value):
            yield ast.Constant(value + 1)
        case ast.Constant(value=float() as value):
            yield ast.Constant(value * 1.1 if value else 0.1)


def is_type(node):
    """Return whether the expression is a type such as `X | None`, not a bitwise operation."""
    sides = (node.left, node.right)
    return isinstance(node.op, ast.BitOr) and any(isinstance(one, ast.Constant) and one.value is None for one in sides)


def runs(node):
    """Yield the nodes of code that runs: no text, annotation, import or message of an error."""
    yield node
    for name, field in ast.iter_fields(node):
        parts = field if isinstance(field, list) else [field]
        for part in parts if name not in ("annotation", "returns", "decorator_list") else ():
            skipped = ast.Import | ast.ImportFrom | ast.Raise | ast.JoinedStr
            if isinstance(part, ast.AST) and not isinstance(part, skipped):
                yield from runs(part)


def faults_in(path):
    """Return the faults of a module, by line."""
    source = path.read_text(encoding="utf-8")
    lines, found = source.splitlines(keepends=True), {}
    starts = np.cumsum([0, *(len(line.encode()) for line in lines)])
    for node in runs(ast.parse(source)):
        for other in replacements(node):
            begin = starts[node.lineno - 1] + node.col_offset
            end = starts[node.end_lineno - 1] + node.end_col_offset
            text = source.encode()
            after = ast.unparse(ast.fix_missing_locations(other))
            after = after if isinstance(node, ast.stmt) else f"({after})"
            changed = b"".join([text[:begin], after.encode(), text[end:]]).decode()
            found.setdefault(node.lineno, []).append(
                Fault(str(path.relative_to(ROOT)), node.lineno, text[begin:end].decode(), after, changed)
            )
    return found


def drawn(folder, count, rng):
    """Draw faults in random lines of a folder's modules, at most one of a line."""
    modules = sorted((ROOT / "behavexplor" / folder).rglob("*.py"))
    every = [found for path in modules for found in faults_in(path).values()]
    chosen = rng.choice(len(every), size=min(count, len(every)), replace=False)
    return [every[i][rng.integers(len(every[i]))] for i in chosen]


class Copy:
    """A copy of the project, in which faults are planted."""

    def __init__(self, folder):
        self._root = Path(folder)
        ignored = shutil.ignore_patterns(".git", ".venv", "__pycache__", ".*_cache", "runs", "site")
        shutil.copytree(ROOT, self._root, ignore=ignored)

    def failure(self, tests, time_limit):
        """Run tests on the copy, and return the end of what they print if one fails; nothing if all pass."""
        command = [sys.executable, "-m", "pytest", "-x", "-q", tests]
        own = {**os.environ, "PYTHONPATH": str(self._root)}
        try:
            done = subprocess.run(
                command, cwd=self._root, env=own, capture_output=True, timeout=time_limit, check=False, text=True
            )
        except subprocess.TimeoutExpired:
            return f"{tests} took longer than {time_limit:.0f} s"
        return done.stdout[-2000:] or "pytest failed" if done.returncode else ""

    def time_limit(self, tests):
        """Return after how many seconds tests hang, from the time that they take without a fault.

        A fault in a kernel lets them compile again, which takes minutes.
        """
        begun = time.monotonic()
        if failure := self.failure(tests, WHOLE_TIME_LIMIT):
            sys.exit(f"{failure}\n{tests} fails without a fault, so it finds none")
        return 300 + 2 * (time.monotonic() - begun)

    def finds(self, fault, time_limit, *, whole):
        """Return which tests find a fault, "own", "others" or "none", and the first that failed."""
        changed = self._root / fault.path
        kept = changed.read_text(encoding="utf-8")
        changed.write_text(fault.source, encoding="utf-8")
        own = FOLDERS[folder_of(fault)]
        nearest = f"{own}/test_{changed.name}"
        try:
            for tests in [nearest] * (self._root / nearest).is_file() + [own]:
                if failure := self.failure(tests, time_limit):
                    return "own", failed(failure)
            if whole and (failure := self.failure("tests", WHOLE_TIME_LIMIT)):
                return "others", failed(failure)
            return "none", ""
        finally:
            changed.write_text(kept, encoding="utf-8")


def failed(printed):
    """Return what pytest says of the first test that failed."""
    lines = printed.strip().splitlines()
    return next((line for line in lines if line.startswith(("FAILED", "ERROR"))), lines[-1])[:200]


def folder_of(fault):
    return next(folder for folder in FOLDERS if fault.path.startswith(f"behavexplor/{folder}/"))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=60, help="faults, shared equally by the folders")
    parser.add_argument("--folders", nargs="*", choices=FOLDERS, default=list(FOLDERS))
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="faults that are tried at the same time")
    parser.add_argument("--whole", action="store_true", help="let survivors meet the whole suite")
    parser.add_argument("--list", action="store_true", help="name the faults, and run no tests")
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    share = -(-given.count // len(given.folders))
    faults = [fault for folder in given.folders for fault in drawn(folder, share, rng)]
    if given.list:
        sys.stdout.write("".join(f"{fault}\n" for fault in faults))
        return
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(given.jobs) as jobs:
        free = queue.SimpleQueue()
        for i in range(given.jobs):
            free.put(Copy(Path(folder) / str(i)))

        def with_copy(call, *args, **options):
            copy = free.get()
            try:
                return call(copy, *args, **options)
            finally:
                free.put(copy)

        limits = jobs.map(lambda name: with_copy(Copy.time_limit, FOLDERS[name]), given.folders)
        limits = dict(zip(given.folders, limits, strict=True))
        found = jobs.map(
            lambda fault: with_copy(Copy.finds, fault, limits[folder_of(fault)], whole=given.whole), faults
        )
        counts = Counter()
        for fault, (tests, by) in zip(faults, found, strict=True):
            counts[tests] += 1
            sys.stdout.write(f"{tests:<7} {fault}\n" + f"        {by}\n" * bool(by))
            sys.stdout.flush()
    sys.stdout.write(", ".join(f"{name} {count}" for name, count in counts.items()) + "\n")


if __name__ == "__main__":
    main()
