"""Things have the names in the source that the glossary gives them."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = ("analysis", "bench", "daq", "kernels", "model", "rig", "shakerbench")
OTHERS = {"ForwardModel": 4, "Observations": 11, "Flights": 7, "PlateMotion": 1, "Fitter": 1, "Thresholds": 1}
"""Variables of each type that have another name: a role of their own, or not renamed yet. It may only fall."""


def glossary() -> dict[str, str]:
    """Name of a variable by its type."""
    page = (ROOT / "docs/reference/glossary.md").read_text(encoding="utf-8").partition("## Names in the code")[2]
    return dict(re.findall(r"\| `(\w+)` \| `(\w+)` \|", page))


def variables(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """Types and names of arguments and variables whose type the text shows."""
    for node in ast.walk(tree):
        if isinstance(node, ast.arg) and node.annotation is not None:
            kind, name = ast.unparse(node.annotation), node.arg
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            kind, name = ast.unparse(node.annotation), node.target.id
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            name = node.targets[0].id
            if isinstance(node.value, ast.Call):
                kind = ast.unparse(node.value.func)
            elif isinstance(node.value, ast.Attribute):
                kind = {"observations": "Observations", "model": "ForwardModel"}.get(node.value.attr, "")
            else:
                continue
        else:
            continue
        yield kind.removesuffix(" | None"), name


def test_one_name_for_each_thing() -> None:
    """No more variables than were counted have another name than the glossary's for their type."""
    wanted, others = glossary(), Counter[str]()
    assert wanted.keys() == OTHERS.keys()
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            for kind, name in variables(ast.parse(path.read_text(encoding="utf-8"))):
                others[kind] += kind in wanted and name != wanted[kind]
    more = {kind: others[kind] for kind, most in OTHERS.items() if others[kind] > most}
    assert not more, f"{more} variables have other names than docs/reference/glossary.md gives; at most {OTHERS}"
