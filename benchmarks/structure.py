"""Size and shape of the source tree, by its syntax trees: lines, imports, small functions, comments, constants, words.

    python -m benchmarks.structure
    python -m benchmarks.structure --against f4d47e4

Counted are the packages of the wheel; tests and benchmarks are not.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import subprocess
import tarfile
import tempfile
import tokenize
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

PACKAGES = ("shakerbench", "kernels", "rig", "daq", "model", "analysis", "bench")
ENTRY = "bench.commands.close_loop"
SMALL_LINES, MOST_FIELDS, MOST_PARAMETERS, MOST_FILES = 12, 15, 7, 10
ROOMS_OF_ONE_KIND = ("model/effects", "bench/commands")  # a file for each effect and for each command
DIALECT = ("told", "alone", "beside", "apart", "kept", "nobody")

Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class Module:
    """A source file and its syntax tree; ``name`` is dotted."""

    path: str
    name: str
    text: str
    tree: ast.Module = field(repr=False)

    @property
    def lines(self) -> int:
        """All lines, blank ones and docstrings included."""
        return self.text.count("\n")

    @cached_property
    def functions(self) -> list[Function]:
        """Every function and method, nested ones included."""
        return [x for x in ast.walk(self.tree) if isinstance(x, ast.FunctionDef | ast.AsyncFunctionDef)]

    @cached_property
    def comment_lines(self) -> set[int]:
        """Lines that hold a comment and no code."""
        tokens = tokenize.generate_tokens(io.StringIO(self.text).readline)
        return {t.start[0] for t in tokens if t.type == tokenize.COMMENT and t.line.lstrip().startswith("#")}

    def imported(self, known: frozenset[str]) -> set[str]:
        """Modules of ``known`` that this one imports, within functions and for types as well."""
        package = self.name if self.path.endswith("__init__.py") else self.name.rpartition(".")[0]
        out: set[str] = set()
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Import):
                out |= {a.name for a in node.names}
            if not isinstance(node, ast.ImportFrom):
                continue
            base = node.module or ""
            if node.level:
                base = ".".join([*package.split(".")[: len(package.split(".")) + 1 - node.level], base]).rstrip(".")
            out |= {base, *(f"{base}.{a.name}" for a in node.names)}
        return (out & known) - {self.name}


@dataclass(frozen=True)
class Tree:
    """The modules of the packages under one root."""

    modules: tuple[Module, ...]

    @classmethod
    def read(cls, root: Path) -> Tree:
        """Read the tree under ``root``."""
        found = []
        for path in sorted(p for package in PACKAGES for p in (root / package).rglob("*.py")):
            relative = path.relative_to(root)
            parts = relative.with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            text = path.read_text(encoding="utf-8")
            found.append(Module(relative.as_posix(), name, text, ast.parse(text)))
        return cls(tuple(found))

    @cached_property
    def by_name(self) -> dict[str, Module]:
        """Modules by dotted name."""
        return {m.name: m for m in self.modules}

    def lines_of(self, package: str) -> int:
        """Lines of a package."""
        return sum(m.lines for m in self.modules if m.path.startswith(package + "/"))

    def closure(self, entry: str) -> list[Module]:
        """Modules that ``entry`` imports, directly or not."""
        known, seen, left = frozenset(self.by_name), set[str](), [entry]
        while left:
            name = left.pop()
            if name in seen or name not in self.by_name:
                continue
            seen.add(name)
            left += self.by_name[name].imported(known)
        return [self.by_name[name] for name in sorted(seen)]

    def called_once(self) -> list[tuple[Module, Function]]:
        """Private functions whose name stands once in the tree beyond its definition (undecorated ones)."""
        uses: Counter[str] = Counter()
        for m in self.modules:
            for node in ast.walk(m.tree):
                if isinstance(node, ast.Name):
                    uses[node.id] += 1
                elif isinstance(node, ast.Attribute):
                    uses[node.attr] += 1
        functions = [(m, f) for m in self.modules for f in m.functions]
        defined = Counter(f.name for _, f in functions)
        return [
            (m, f)
            for m, f in functions
            if f.name.startswith("_") and not f.name.startswith("__") and defined[f.name] == 1 and uses[f.name] == 1
        ]

    def circles(self) -> list[list[str]]:
        """Groups of files that import each other in a circle."""
        known = frozenset(self.by_name)
        arrows = {m.name: m.imported(known) for m in self.modules}
        arrows = {n: {x for x in to if not n.startswith(x + ".")} for n, to in arrows.items()}
        reach = {n: _reached(n, arrows) for n in arrows}
        groups = {tuple(sorted(x for x in reach[n] if n in reach[x])) for n in arrows if n in reach[n]}
        return [list(g) for g in sorted(groups)]

    def rooms_above(self, most: int) -> list[tuple[str, int]]:
        """Folders of more than ``most`` files, ``__init__`` not counted."""
        count = Counter(m.path.rpartition("/")[0] for m in self.modules if not m.path.endswith("__init__.py"))
        return [(room, n) for room, n in count.most_common() if n > most and room not in ROOMS_OF_ONE_KIND]


def _reached(start: str, arrows: dict[str, set[str]]) -> set[str]:
    seen, left = set[str](), list(arrows[start])
    while left:
        name = left.pop()
        if name not in seen:
            seen.add(name)
            left += arrows.get(name, ())
    return seen


def _length(f: Function) -> int:
    return (f.end_lineno or f.lineno) - f.lineno + 1


def comments_per_1000(tree: Tree) -> float:
    """Comment lines within functions, for 1000 lines of source."""
    inside = 0
    for m in tree.modules:
        covered = {line for f in m.functions for line in range(f.body[0].lineno, (f.end_lineno or f.lineno) + 1)}
        inside += len(covered & m.comment_lines)
    return 1000.0 * inside / sum(m.lines for m in tree.modules)


def crowded_classes(tree: Tree) -> list[str]:
    """Classes of more than `MOST_FIELDS` annotated fields."""
    out = []
    for m in tree.modules:
        for c in (x for x in ast.walk(m.tree) if isinstance(x, ast.ClassDef)):
            n = sum(isinstance(x, ast.AnnAssign) for x in c.body)
            if n > MOST_FIELDS:
                out.append(f"{m.path}:{c.lineno} {c.name} {n}")
    return out


def crowded_functions(tree: Tree) -> list[str]:
    """Functions of more than `MOST_PARAMETERS` parameters, those of commands excluded."""
    out = []
    for m in tree.modules:
        for f in [] if m.path.startswith("bench/commands/") else m.functions:
            every = [a.arg for a in (*f.args.posonlyargs, *f.args.args, *f.args.kwonlyargs)]
            n = len([a for a in every if a not in ("self", "cls")])
            if n > MOST_PARAMETERS:
                out.append(f"{m.path}:{f.lineno} {f.name} {n}")
    return out


def numeric_constants(tree: Tree) -> int:
    """Names in capitals that a module binds to a number; one for a tuple of numbers."""
    total = 0
    for m in tree.modules:
        for node in m.tree.body:
            targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
            value = getattr(node, "value", None)
            if value is None or not isinstance(node, ast.Assign | ast.AnnAssign):
                continue
            named = [x for t in targets for x in (t.elts if isinstance(t, ast.Tuple) else [t])]
            if all(isinstance(x, ast.Name) and x.id.upper() == x.id for x in named) and _is_number(value):
                total += len(named) if any(isinstance(t, ast.Tuple) for t in targets) else 1
    return total


def _is_number(node: ast.expr) -> bool:
    """Whether an expression is made of numbers and of operations on them, or of a tuple of such."""
    if isinstance(node, ast.Tuple):
        return all(_is_number(x) for x in node.elts)
    if isinstance(node, ast.BinOp):
        return _is_number(node.left) and _is_number(node.right)
    if isinstance(node, ast.UnaryOp):
        return _is_number(node.operand)
    return isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool)


def dialect(tree: Tree) -> Counter[str]:
    """How often each word of `DIALECT` stands in the source, as a word or as a part of a name."""
    pattern = re.compile(rf"(?<![a-z])({'|'.join(DIALECT)})(?![a-z])", re.IGNORECASE)
    return Counter(word.lower() for m in tree.modules for word in pattern.findall(m.text))


def table(tree: Tree) -> dict[str, str]:
    """The figures, as words by their name."""
    closure, once = tree.closure(ENTRY), tree.called_once()
    small = [f for _, f in once if _length(f) < SMALL_LINES]
    words = dialect(tree)
    out = {"source lines": f"{sum(m.lines for m in tree.modules):,} in {len(tree.modules)} files"}
    out |= {f"  {package}": f"{tree.lines_of(package):,}" for package in PACKAGES}
    return out | {
        "bench close-loop imports": f"{len(closure)} files, {sum(m.lines for m in closure):,} lines",
        f"private functions called once, below {SMALL_LINES} lines (all)": f"{len(small)} ({len(once)})",
        "comment lines in bodies, per 1000": f"{comments_per_1000(tree):.1f}",
        f"classes above {MOST_FIELDS} fields": str(len(crowded_classes(tree))),
        f"functions above {MOST_PARAMETERS} parameters": str(len(crowded_functions(tree))),
        "functions above 60 lines": str(sum(_length(f) > 60 for m in tree.modules for f in m.functions)),
        "files above 400 lines": str(sum(m.lines > 400 for m in tree.modules)),
        "numeric constants of modules": str(numeric_constants(tree)),
        "circles of files": str(len(tree.circles())),
        f"rooms above {MOST_FILES} files": str(len(tree.rooms_above(MOST_FILES))),
        "dialect": f"{sum(words.values())} ({', '.join(f'{w} {n}' for w, n in words.most_common())})",
    }


def details(tree: Tree) -> Iterator[str]:
    """Where the figures come from, a line each."""
    yield from (f"circle: {' - '.join(c)}" for c in tree.circles())
    yield from (f"room: {room} {n} files" for room, n in tree.rooms_above(MOST_FILES))
    yield from (f"fields: {x}" for x in crowded_classes(tree))
    yield from (f"parameters: {x}" for x in crowded_functions(tree))
    for m, f in tree.called_once():
        if _length(f) < SMALL_LINES:
            yield f"called once: {m.path}:{f.lineno} {f.name} {_length(f)} lines"


def tree_at(revision: str, root: Path) -> Tree:
    """The tree of a git revision of the repository at ``root``."""
    archive = subprocess.run(["git", "-C", str(root), "archive", revision, *PACKAGES], check=True, capture_output=True)
    with tempfile.TemporaryDirectory() as folder, tarfile.open(fileobj=io.BytesIO(archive.stdout)) as files:
        files.extractall(folder, filter="data")
        return Tree.read(Path(folder))


def main() -> None:
    """Print the table, against a revision or by itself."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", help="git revision for a second column")
    parser.add_argument("--details", action="store_true", help="list where the figures come from")
    options = parser.parse_args()
    root = Path(__file__).resolve().parent.parent
    tree = Tree.read(root)
    now = table(tree)
    before = table(tree_at(options.against, root)) if options.against else {}
    for name, value in now.items():
        print(f"| {name} | {before[name]} | {value} |" if before else f"| {name} | {value} |")
    if options.details:
        print(*details(tree), sep="\n")


if __name__ == "__main__":
    main()
