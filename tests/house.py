"""Measures of the package's structure, and their limits. `python -m tests.house` prints them.

Lines of code are neither blank nor comments nor docstrings. `__init__` and `__main__` do not count as modules.
"""

import ast
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

import behavexplor
from behavexplor.campaign.config import CampaignConfig
from behavexplor.campaign.opening import opened

ROOT = Path(behavexplor.__file__).parent
LIMITS = {  # with room for what is to come
    "modules": 300,
    "lines": 51_000,
    "import lines, % of code": 12.5,
    "modules with one importer, %": 15,
    "modules under 40 lines of code, %": 15,
    "lines of code of the longest function": 45,
    "modules that define Floats": 1,
    "class names that stand twice": 0,
    "files that one candidate runs through": 32,
    "places that ask for the kind of world": 10,
}


class Module:
    """A module's source, with the numbers of its lines of code."""

    def __init__(self, path):
        self.path, self.name = path, ".".join(path.relative_to(ROOT.parent).with_suffix("").parts)
        source = path.read_text(encoding="utf-8")
        self.n_lines, self.tree = len(source.splitlines()), ast.parse(source)
        numbered = enumerate(source.splitlines(), 1)
        self.code = {i for i, line in numbered if line.strip() and not line.strip().startswith("#")}
        for node in ast.walk(self.tree):
            body = getattr(node, "body", None)
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and body and is_text(body[0]):
                self.code -= lines_of(body[0])
        self.counts = path.name not in ("__init__.py", "__main__.py")
        self.functions = [node for node in ast.walk(self.tree) if isinstance(node, ast.FunctionDef)]
        self.imports = [node for node in ast.walk(self.tree) if isinstance(node, ast.Import | ast.ImportFrom)]

    def imported(self):
        """The names of the modules that it may import."""
        names = {alias.name for node in self.imports if isinstance(node, ast.Import) for alias in node.names}
        origins = [node for node in self.imports if isinstance(node, ast.ImportFrom)]
        return names | {
            one for node in origins for one in (node.module, *(f"{node.module}.{a.name}" for a in node.names))
        }


def is_text(node):
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def lines_of(node):
    return set(range(node.lineno, node.end_lineno + 1))


def measures():
    """Each measure with what counts for it: a number, and the places."""
    everything = [Module(path) for path in sorted(ROOT.rglob("*.py"))]
    modules = [one for one in everything if one.counts]
    importers = defaultdict(set)
    for one in everything:
        for name in one.imported() - {one.name}:
            importers[name].add(one.name)
    alone = [one.name for one in modules if len(importers[one.name]) == 1]
    small = [one.name for one in modules if len(one.code) < 40]
    code = sum(len(one.code) for one in everything)
    imports = sum(len(one.code & lines_of(node)) for one in everything for node in one.imports)
    longest = max(
        (len(one.code & lines_of(node)), f"{one.name}.{node.name}") for one in everything for node in one.functions
    )
    floats = [one.name for one in everything if any("Floats" in stored(node) for node in one.tree.body)]
    twice = names_that_stand_twice(everything)
    path = files_of_a_candidate()
    kinds = [f"{one.name}:{line}" for one in everything for line in questions_of_kind(one)]
    return {
        "modules": (len(modules), []),
        "lines": (sum(one.n_lines for one in everything), []),
        "import lines, % of code": (100 * imports / code, []),
        "modules with one importer, %": (100 * len(alone) / len(modules), alone),
        "modules under 40 lines of code, %": (100 * len(small) / len(modules), small),
        "lines of code of the longest function": (longest[0], [longest[1]]),
        "modules that define Floats": (len(floats), floats),
        "class names that stand twice": (len(twice), twice),
        "files that one candidate runs through": (len(path), path),
        "places that ask for the kind of world": (len(kinds), kinds),
    }


def stored(node):
    return {name.id for name in ast.walk(node) if isinstance(name, ast.Name) and isinstance(name.ctx, ast.Store)}


def names_that_stand_twice(everything):
    places = defaultdict(list)
    for one in everything:
        for node in one.tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(one.name)
    return sorted(name for name, modules in places.items() if len(modules) > 1)


def questions_of_kind(module):
    """Lines that ask whether vehicles are scripted or highway-env's. What each kind itself refuses does not count."""
    if module.name.startswith(("behavexplor.data.", "behavexplor.envs.")):
        return []
    return [node.lineno for node in ast.walk(module.tree) if asks_for_kind(node)]


def asks_for_kind(node):
    if isinstance(node, ast.Compare):
        left, right = ast.unparse(node.left), ast.unparse(node.comparators[0])
        return left.rpartition(".")[2] == "roadmap" and right == "None"
    if not isinstance(node, ast.Call):
        return False
    function, kind = ast.unparse(node.func), ast.unparse(node.args[-1]) if node.args else ""
    classes = ("Scripted", "DrawnScenario", "DrawnLogical", "DrawnEnv", "DrawnVector")
    return function == "is_highway" or (function == "isinstance" and kind.startswith(classes))


def files_of_a_candidate():
    """The files that run while one candidate is asked for, driven, judged and stored, kernels left out."""
    seen = set()

    def note(frame, *_):
        if "__name__" in frame.f_globals:  # the frame of a kernel has no module
            seen.add(frame.f_code.co_filename)

    config = CampaignConfig(env="intersection-straight", ads="constant", method="uniform", budget="1")
    with tempfile.TemporaryDirectory() as folder:
        for name in ("compiled", "profiled"):
            with opened(config, Path(folder) / name, 0, resume=False) as ready:
                if name == "profiled":
                    sys.setprofile(note)
                ready.campaign.run(lambda _: None)
                sys.setprofile(None)
    return sorted(str(Path(name).relative_to(ROOT)) for name in seen if name.startswith(f"{ROOT}/"))


def table(found):
    lines = [f"{'':<42}{'now':>8}{'limit':>8}"]
    lines += [f"{name:<42}{round(value, 1):>8}{LIMITS[name]:>8}" for name, (value, _) in found.items()]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.stdout.write(table(measures()) + "\n")
