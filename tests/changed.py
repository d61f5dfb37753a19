"""Run the tests that a change can reach, nearest first, for a minute: ``python -m tests.changed [REVISION]``.

Changed is what differs from ``REVISION`` (default: HEAD) or is new. A test file is as far away as its nearest import is
from a changed module, counted in imports; tests of a changed module's own folder are nearest. When the minute is over,
what was not run is counted. What a test reaches through another process is not known here: `make test` runs everything.
"""

from __future__ import annotations

import ast
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("analysis", "bench", "daq", "kernels", "model", "rig", "shakerbench")
SECONDS = 60.0
FOUND_BY = {"model/effects/": "model.effects.registry", "rig/backends/": "rig.backends.registry"}
"""Folders whose files nothing imports by name, and the module that finds them."""


class Minute:
    """A plugin of pytest that ends the session after `SECONDS`."""

    def __init__(self) -> None:
        self._until = time.monotonic() + SECONDS
        self.left, self.over, self.failed = 0, False, False

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        """Count what is to be run."""
        self.left = len(session.items)

    def pytest_runtest_logfinish(self) -> None:
        """Count what has been run."""
        self.left -= 1

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Remember a failure: pytest's status does not tell of it where the session was ended."""
        self.failed |= report.failed

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> None:
        """End when the minute is over."""
        if time.monotonic() > self._until:
            self.over, item.session.shouldstop = True, "a minute is over"


def changed_files(revision: str) -> list[str]:
    """Paths, relative to the checkout, that differ from a revision or that git does not know."""
    commands = ("git", "diff", "--name-only", revision), ("git", "ls-files", "--others", "--exclude-standard")
    outputs = [subprocess.run(c, cwd=ROOT, capture_output=True, text=True, check=True).stdout for c in commands]
    return [line for output in outputs for line in output.splitlines()]


def distances(changed: Iterable[str]) -> dict[str, int]:
    """How many imports each module is away from the nearest changed one; only modules that a change reaches."""
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    paths = list(changed)
    names = [path.removesuffix(".py").removesuffix("/__init__").replace("/", ".") for path in paths]
    names += [module for path in paths for folder, module in FOUND_BY.items() if path.startswith(folder)]
    found = {name: 0 for name in names if name in graph.modules}
    new = list(found)
    for name in new:  # grows while it is walked
        for importer in graph.find_modules_that_directly_import(name):
            if importer not in found:
                found[importer] = found[name] + 1
                new.append(importer)
    return found


def tests_reached(changed: Iterable[str]) -> list[str]:
    """Test files that changed paths can reach, the nearest first."""
    paths = set(changed)
    away = distances(paths)
    out = []
    for test in sorted((ROOT / "tests").rglob("test_*.py")):
        path = test.relative_to(ROOT).as_posix()
        near = [away[name] for name in _imports(test) if name in away]
        folder = path.removeprefix("tests/").rpartition("/")[0]
        if path in paths or any(p.rpartition("/")[0] == folder and p.endswith(".py") for p in paths):
            near.append(-1)
        if folder == "docs" and any(p.endswith((".md", ".ipynb")) for p in paths):
            near.append(-1)
        if near:
            out.append((min(near), path))
    return [path for _, path in sorted(out)]


def _imports(test: Path) -> set[str]:
    """Names that a file imports anywhere, modules and what may be one."""
    names = set()
    for node in ast.walk(ast.parse(test.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


def main() -> int:
    """Run them; the exit status is pytest's, and 0 where the minute was over before a test failed."""
    reached = tests_reached(changed_files(*sys.argv[1:2] or ("HEAD",)))
    if not reached:
        print("no test is reached by what changed")
        return 0
    minute = Minute()
    status = int(pytest.main(["-m", "not slow", *reached], plugins=[minute]))
    print(f"test files reached: {len(reached)}; tests in them that were not run: {minute.left}")
    return int(minute.failed) if minute.over else status


if __name__ == "__main__":
    sys.exit(main())
