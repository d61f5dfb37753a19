"""What accompanies runs that were started in a terminal: their page, and the verdict after each step."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from rig.profile import Profile

if TYPE_CHECKING:
    from bench.jobs.run_ramp import Onlooker
    from bench.live.board import Board
    from bench.live.processes import PageProcess
    from rig.execution.operator import Status


class Onlookers:
    """One page for several runs, one after another, and the printed verdicts; a context in which they are driven.

    ``folder`` is of the recordings; ``page`` the address and port, None for no page; with ``watch`` the verdict after
    each step is printed on standard error.
    """

    def __init__(self, folder: Path, page: tuple[str, int | None] | None, *, watch: bool = False) -> None:
        self._folder, self._page, self._watch = folder, page, watch
        self._served: PageProcess | None = None
        self._boards: list[Board] = []
        self._profiles = TemporaryDirectory()

    def __enter__(self) -> Onlookers:
        return self

    def __exit__(self, *exception: object) -> None:
        if self._served is not None:
            self._served.close()
        for board in self._boards:
            board.close()
        self._profiles.cleanup()

    @contextmanager
    def of_run(self, profile: Profile, text: str, why: str = "") -> Iterator[Onlooker | None]:
        """An onlooker for `bench.jobs.run_ramp.record` during the next run; None where no one looks on.

        Raises `InputError` when the page cannot be served.

        ``why`` is the reason of the run, said on a page that is there already.
        """
        if self._page is None and not self._watch:
            yield None
            return
        from bench.live.board import Board
        from bench.live.processes import PageProcess
        from bench.live.run_side import RunSide

        board = Board()
        self._boards.append(board)
        if self._page is not None and self._served is None:
            self._served = PageProcess(profile, board, self._folder, *self._page)
            _print(f"watch it at {self._served.url}")
        elif self._page is not None:
            path = Path(self._profiles.name) / f"{len(self._boards)}.toml"
            path.write_text(text, encoding="utf-8")
            # the page of the run before goes on to this one; its lane takes a reason of a few lines
            following = {"kind": "next", "board": board.name, "profile": str(path), "why": why[:480]}
            self._boards[-2].events.put(following)
        watcher = _Watcher(profile, board.name) if self._watch else None
        try:
            yield RunSide(board, None if watcher is None else watcher.look)
            if watcher is not None:
                watcher.print_what_came(within_s=20.0)  # the verdict after the last step is still on its way
        finally:
            if watcher is not None:
                watcher.close()


class _Watcher:
    """The analyst of a run, whose verdicts are printed."""

    def __init__(self, profile: Profile, board_name: str) -> None:
        from bench.live.analyst import start_analyst

        self._pipe, self._process = start_analyst(profile, board_name, pictures=False)
        self._blocks = 0
        self._printed: dict[int, str] = {}  # by step

    def look(self, status: Status) -> None:
        """Print what has come, after every 16th block; never waits."""
        self._blocks += 1
        if self._blocks % 16 == 0:
            self.print_what_came(0.0)

    def close(self) -> None:
        """End the analyst."""
        self._process.terminate()
        self._process.join(2.0)

    def print_what_came(self, within_s: float) -> None:
        """Print what comes within a time."""
        try:
            while self._pipe.poll(within_s):
                message: dict[str, Any] = self._pipe.recv()
                if message["kind"] == "verdict":
                    candidates = (f"    - {one}" for one in message["candidates"])
                    _print(f"  {message['headline']}", *candidates, *(f"    {line}" for line in message["lines"]))
                elif message["kind"] == "flights":
                    line = f"step {message['step']}: gamma {message['gamma']:.4f}, {message['label']}"
                    if self._printed.get(message["step"]) != line:  # the end may correct it
                        _print(line)
                    self._printed[message["step"]] = line
        except (EOFError, OSError):
            return  # it is done, or gone: the run goes on without


def _print(*lines: str) -> None:
    """Lines on standard error."""
    try:
        for line in lines:
            sys.stderr.write(f"{line}\n")
        sys.stderr.flush()
    except OSError:
        return  # the terminal is gone; the run goes on
