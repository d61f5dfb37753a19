"""A bar on standard error that follows a long job, and tells when kernels are being compiled.

Compiling happens once on a machine and can take a minute; without a word it looks like a program that hangs.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from kernels.kernel import watchers

Progress = Callable[[str, float], None]


class _Compiling:
    """Watcher of compilations (`kernels.kernel.watchers`); stored kernels cause none.

    At the beginning and at the end of each compilation ``say`` gets the kernel's name (empty when none is being
    compiled) and the number of those done.
    """

    def __init__(self, say: Callable[[str, int], None]) -> None:
        self._say, self._depth, self._done = say, 0, 0

    def on_start(self, name: str) -> None:
        self._depth += 1
        self._say(name, self._done)

    def on_end(self) -> None:
        self._depth, self._done = self._depth - 1, self._done + 1
        if self._depth == 0:
            self._say("", self._done)


@functools.cache
def _announce() -> None:
    """Say at the first call that kernels are being compiled."""
    sys.stderr.write("compiling the kernels for this machine, once; this can take a minute\n")


@contextmanager
def progress_bar(quiet: bool = False) -> Iterator[Progress]:
    """A bar that follows ``(what, fraction done)``; where there is no terminal, only compiling is announced."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:<34}"), BarColumn(bar_width=24), TimeElapsedColumn())
    console = Console(stderr=True)
    doing = "starting"
    with Progress(*columns, console=console, transient=True, disable=quiet) as bar:
        task = bar.add_task(doing, total=1.0)

        def say(what: str, part: float) -> None:
            nonlocal doing
            doing = what
            bar.update(task, description=what, completed=part)

        def compiling(kernel: str, done: int) -> None:
            if not quiet and not console.is_terminal:
                _announce()
            bar.update(task, description=f"compiling, once: {kernel} ({done} done)" if kernel else doing)

        listener = _Compiling(compiling)
        watchers.append(listener)
        try:
            yield say
        finally:
            watchers.remove(listener)
