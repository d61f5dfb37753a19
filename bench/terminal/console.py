"""Exit codes, error lines, progress, tables for a person and JSON for a machine, shared by all commands.

Exit 0: the job was done; 1: the run failed; 2: the call was wrong. A defect, which no person's input should cause, puts
its traceback into a file, and one line says where that lies.
"""

from __future__ import annotations

import functools
import os
import platform
import shlex
import sys
import tempfile
import traceback
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import typer

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table


EXIT_FAILED = 1
EXIT_USAGE = 2


def fail(message: str, code: int = EXIT_FAILED) -> NoReturn:
    """Print an error that a person can act on, to standard error, and leave with ``code``."""
    sys.stderr.write(f"error: {message}\n")
    raise SystemExit(code)


def warn(message: str) -> None:
    """Print something to mind, to standard error, and go on."""
    sys.stderr.write(f"warning: {message}\n")


def write_json(payload: Any, target: str | Path | None) -> bool:
    """Write JSON to a file, or to standard output where ``target`` is ``-``; whether that is left to a person."""
    if target is None:
        return True
    from daq.files.json_values import json_text

    text = json_text(payload)
    if target == "-":
        sys.stdout.write(text)
        return False
    from daq.files.disk import write_whole

    try:
        write_whole(Path(target), text)
    except OSError as error:
        fail(f"{target}: the JSON could not be written ({error.strerror}); free some space, or name another place")
    return True


def readable(text: str | None) -> str | None:
    """Text from a command line as it can be stored; bytes that the console's code page does not know become marks."""
    return None if text is None else text.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def speaker(quiet: bool) -> Callable[[str], None]:
    """A function that prints a line for a person, or nothing where standard output belongs to the JSON."""
    return (lambda line: None) if quiet else typer.echo


def print_lines(*lines: str) -> None:
    """Print lines as they are, for a person; a narrow terminal wraps them."""
    for line in lines:
        sys.stdout.write(f"{line}\n")


GAMMA = "gamma = A w^2/g of the first tone; peak: largest downward acceleration of the plate over g, 2 gamma at c = 1"
"""Below every table of gammas."""

ACHIEVED = (
    "gamma = A w^2/g of the first tone: as asked for, and as the accelerometer measures it at the plate, impacts left "
    "out, with the sensitivity's uncertainty"
)
"""Below every table of a recording's steps."""

CYCLES = (
    "n-cycle: a motion of n flights that repeats after n periods of the forcing, or after the period that is named; "
    "locked: every landing is a take-off; with reset: the ball rests on the plate in between; with chatter: ever "
    "smaller bounces before that rest"
)
"""Below every table of predicted motions."""


def next_command(recording: Path, stake: str | Path | None = None) -> str:
    """The line after a command that made a recording: what to do with it; ``stake`` is the profile of a staked run."""
    judge = "bench close-loop" if stake is None else f"bench stake {shlex.quote(str(stake))}"
    return f"next: {judge} {shlex.quote(str(recording))}   (bench compare: step by step; bench report: one page)"


def new_table(*headings: str, words: Collection[str] = (), title: str | None = None) -> Table:
    """A table of numbers for `print_table`; columns of ``words`` are at the left, and folded where it is narrow."""
    from rich import box
    from rich.table import Table

    table = Table(title=title, box=box.SIMPLE_HEAD, padding=(0, 1), pad_edge=False)
    for heading in headings:
        is_text = heading in words
        table.add_column(heading, justify="left" if is_text else "right", no_wrap=not is_text, overflow="fold")
    return table


def print_table(table: Table) -> None:
    """Print a table, in a pipe as wide as it needs; a narrow terminal gets each row as ``heading value`` pairs."""
    from rich.console import Console
    from rich.measure import Measurement

    console = Console()
    needed = Measurement.get(console, console.options.update(max_width=10_000), table).maximum
    if not (console.is_terminal or os.environ.get("COLUMNS", "").isdigit()):
        Console(width=max(needed, console.width)).print(table)
    elif needed <= console.width or (console.width >= 60 and not any(c.no_wrap for c in table.columns)):
        console.print(table)
    else:
        print_lines(*_rows_in_lines(table, console))


def _rows_in_lines(table: Table, console: Console) -> list[str]:
    """A table's rows one below the other, wrapped to the terminal."""
    from rich.text import Text

    def plain(cell: Any) -> str:
        return Text.from_markup(cell).plain if isinstance(cell, str) else str(cell)

    headings = [" ".join(plain(column.header).split()) for column in table.columns]
    lines = [] if table.title is None else [plain(table.title)]
    for row in zip(*([plain(cell) for cell in column.cells] for column in table.columns), strict=True):
        shown = [f"{heading} {cell}".strip() for heading, cell in zip(headings, row, strict=True) if cell.strip()]
        line = ""
        for pair in shown:
            if line and len(line) + 2 + len(pair) >= max(console.width, 20):
                lines.append(f"{line},")
                line = f"  {pair}"
            else:
                line = f"{line}, {pair}" if line else pair
        lines.append(line)
    return lines


DEFECTS = (ValueError, ArithmeticError, LookupError, TypeError, AttributeError)
"""What a library raises, and our own packages where they contradict themselves: never the caller's fault."""


def end_with_defect(error: Exception) -> NoReturn:
    """Write the traceback into a file of the system's folder for temporary ones, name it, and leave with status 1."""
    from daq.setup.provenance import software_version

    call = " ".join(["bench", *sys.argv[1:]])
    about = f"shakerbench {software_version()}, Python {platform.python_version()}, {platform.platform()}\n{call}\n\n"
    text = about + "".join(traceback.format_exception(error))
    try:
        with tempfile.NamedTemporaryFile(
            "w", encoding="utf-8", prefix="shakerbench-", suffix=".txt", delete=False
        ) as file:
            file.write(text)
        lies = f"its traceback is in {Path(file.name)}"
    except OSError:  # a full disk must not hide what failed
        sys.stderr.write(text)
        lies = "its traceback is above"
    made = "".join(f"\n{note}" for note in getattr(error, "__notes__", ()))
    fail(
        f"this is a defect of shakerbench, not of the call; {lies}: please report it with that file{made}", EXIT_FAILED
    )


class _Compiling:
    """Watcher of compilations (`kernels.kernel.watchers`): ``say`` gets the kernel's name (or none), and how many."""

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
def progress_bar(quiet: bool = False) -> Iterator[Callable[[str, float], None]]:
    """A bar that follows ``(what, fraction done)``; where there is no terminal, only compiling is announced.

    Compiling happens once on a machine and can take a minute; without a word it looks like a program that hangs.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from kernels.kernel import watchers

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
