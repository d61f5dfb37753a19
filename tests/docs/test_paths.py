"""Documents name only files, folders and modules that are there."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
OTHERS = {"rig.toml", "rig.bounce_s", "shakerbench.backends", "shakerbench.effects"}
"""A reader's file, a key of a scenario, names of entry points."""
MADE = re.compile(r"as `([\w./]+)`:$", re.MULTILINE)  # a file that the reader of a how-to makes
FOLDERS = "analysis|bench|benchmarks|daq|docs|firmware|kernels|model|rig|rig_profiles|scenarios|shakerbench|tests"
PATH = re.compile(rf"(?:{FOLDERS})/[\w./*-]*")
MODULE = re.compile(r"(?:analysis|bench|benchmarks|daq|kernels|model|rig|shakerbench)(?:\.\w+)+")


def _named(page: Path) -> Iterator[str]:
    """Words of the code in a page: in backticks, fenced or indented by four."""
    for code in re.findall(r"`+([^`]+)`+|^ {4}(.+)$", page.read_text(encoding="utf-8"), re.MULTILINE):
        yield from (word.strip(",;:()[]\"'").split("::")[0] for word in "".join(code).split())


def _is_there(name: str) -> bool:
    """Whether a path or pattern matches a file, or a dotted name a module and what is defined in it."""
    if PATH.fullmatch(name):
        return any(ROOT.glob(name.rstrip("/")))
    parts = name.split(".")
    for i in range(len(parts), 0, -1):
        for file in (ROOT.joinpath(*parts[:i]).with_suffix(".py"), ROOT.joinpath(*parts[:i], "__init__.py")):
            if file.is_file():
                return all(re.search(rf"\b{part}\b", file.read_text(encoding="utf-8")) for part in parts[i:])
    return False


def test_paths_and_modules_in_documents_exist() -> None:
    """Every path and dotted module that a document shows as code is in the repository."""
    pages = [ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "DECISIONS.md", *(ROOT / "docs").rglob("*.md")]
    words = {(page.relative_to(ROOT).as_posix(), word) for page in pages for word in _named(page)}
    made = {name for page in pages for name in MADE.findall(page.read_text(encoding="utf-8"))}
    made |= {name.removesuffix(".py").replace("/", ".") for name in made}
    named = [(page, w) for page, w in words if w not in OTHERS | made and (PATH.fullmatch(w) or MODULE.fullmatch(w))]
    assert len(named) > 100
    assert not sorted((page, word) for page, word in named if not _is_there(word))


def test_rooms_name_the_files_that_they_have() -> None:
    """Where a room says what others take of it, each name is a file or a folder in it."""
    gone = []
    for room in (p for folder in FOLDERS.split("|") for p in (ROOT / folder).rglob("__init__.py")):
        text = room.read_text(encoding="utf-8")
        taken = re.search(r"Other (?:rooms|packages) take (.*?)\.(?:\n|\")", text, re.DOTALL)
        for name in re.findall(r"`(\w+)`", taken[1]) if taken else ():
            if not ((room.parent / f"{name}.py").exists() or (room.parent / name).is_dir()):
                gone.append(f"{room}: {name}")
    assert not gone
