"""Check that the installed highway-env is the one that the engine was ported from.

`source_digests.json` has a digest of the source of every function and constant that was ported, by module and name. A
release of highway-env that changes one of them may drive differently from the engine.
"""

import ast
import hashlib
import json
from collections.abc import Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TypeAlias

Digests: TypeAlias = dict[str, dict[str, str]]  # digest by module and name

_PORTED = Path(__file__).with_name("source_digests.json")


@cache
def changed_sources() -> tuple[str, ...]:
    """Return the names of the ported functions and constants whose source in highway-env is another one today."""
    ported = ported_digests()
    present = present_digests(ported)
    return tuple(
        f"{module.rpartition('.')[2]}.{name}"
        for module, digests in ported.items()
        for name, digest in digests.items()
        if present[module].get(name) != digest
    )


def ported_digests() -> Digests:
    """Return the digests of the sources that were ported."""
    return dict(json.loads(_PORTED.read_text()))


def present_digests(names: Digests) -> Digests:
    """Return the digests of the same functions and constants in the installed highway-env, as far as it has them."""
    return {module: _present_digests(module, list(digests)) for module, digests in names.items()}


def _present_digests(module: str, names: list[str]) -> dict[str, str]:
    spec = find_spec(module)
    if spec is None or spec.origin is None:
        return {}
    source = Path(spec.origin).read_text(encoding="utf-8")
    lines = source.splitlines()
    found = {
        name: hashlib.sha256("\n".join(lines[node.lineno - 1 : node.end_lineno]).encode()).hexdigest()[:16]
        for name, node in _definitions(ast.parse(source))
    }
    return {name: found[name] for name in names if name in found}


def _definitions(tree: ast.Module | ast.ClassDef, prefix: str = "") -> Iterator[tuple[str, ast.stmt]]:
    """Yield the functions and constants of a module and of its classes, with their names."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            yield from _definitions(node, f"{prefix}{node.name}.")
        elif isinstance(node, ast.FunctionDef):
            yield f"{prefix}{node.name}", node
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
                yield f"{prefix}{ast.unparse(target)}", node
