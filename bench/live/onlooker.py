"""What accompanies a run that was started in a terminal: its page, and the verdict after each step."""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from rig.profile import Profile

if TYPE_CHECKING:
    from bench.jobs.run_ramp import Onlooker
    from bench.live.board import Board
    from bench.live.processes import PageProcess
    from rig.execution.operator import Status

POLL_EVERY = 16  # blocks between two looks for a verdict
LAST_WORD_S = 20.0  # for the verdict after the last step
LONGEST = 480  # characters of a reason on the page


@contextmanager
def onlooking(
    profile: Profile, folder: Path, *, page: tuple[str, int | None] | None, watch: bool
) -> Iterator[Onlooker | None]:
    """An onlooker for `bench.jobs.run_ramp.record` while the run lasts; None where nobody looks on.

    Parameters
    ----------
    profile
        Of the run.
    folder
        Of the recording.
    page
        Address and port of a page; None without one.
    watch
        Whether the verdict after each step is printed on standard error.

    Raises
    ------
    InputError
        When the page cannot be served.
    """
    if page is None and not watch:
        yield None
        return
    from bench.live.board import Board
    from bench.live.run_side import RunSide

    board = Board()
    served = watcher = None
    try:
        if page is not None:
            from bench.live.processes import PageProcess

            served = PageProcess(profile, board, folder, *page)
            _print(f"watch it at {served.url}")
        watcher = _Watcher(profile, board.name) if watch else None
        yield RunSide(board, None if watcher is None else watcher.look)
        if watcher is not None:
            watcher.finish()
    finally:
        if watcher is not None:
            watcher.close()
        if served is not None:
            served.close()
        board.close()


class OnePage:
    """One page for several runs, one after another.

    Parameters
    ----------
    folder
        Of the recordings.
    page
        Address and port; None for no page.
    """

    def __init__(self, folder: Path, page: tuple[str, int | None] | None) -> None:
        self._folder, self._page = folder, page
        self._served: PageProcess | None = None
        self._boards: list[Board] = []
        self._profiles: TemporaryDirectory[str] | None = None

    def __enter__(self) -> OnePage:
        if self._page is not None:
            self._profiles = TemporaryDirectory()
        return self

    def __exit__(self, *exception: object) -> None:
        if self._served is not None:
            self._served.close()
        for board in self._boards:
            board.close()
        if self._profiles is not None:
            self._profiles.cleanup()

    @contextmanager
    def onlooker(self, profile: Profile, text: str, why: str) -> Iterator[Onlooker | None]:
        """An onlooker for the next run, of ``profile`` with its ``text``; ``why`` it is driven is said on the page.

        Raises
        ------
        InputError
            When the page cannot be served.
        """
        if self._page is None or self._profiles is None:
            yield None
            return
        from bench.live.board import Board
        from bench.live.run_side import RunSide

        board = Board()
        self._boards.append(board)
        if self._served is None:
            from bench.live.processes import PageProcess

            self._served = PageProcess(profile, board, self._folder, *self._page)
            _print(f"watch it at {self._served.url}")
        else:
            path = Path(self._profiles.name) / f"{len(self._boards)}.toml"
            path.write_text(text, encoding="utf-8")
            self._boards[-2].events.put(
                {"kind": "next", "board": board.name, "profile": str(path), "why": why[:LONGEST]}
            )
        yield RunSide(board)


class _Watcher:
    """The analyst of a run, whose verdicts are printed."""

    def __init__(self, profile: Profile, board_name: str) -> None:
        from bench.live.analyst import analyse

        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe(duplex=False)
        self._pipe: Connection = ours
        self._process = context.Process(
            target=analyse, args=(theirs, board_name, profile, False), name="analyst", daemon=True
        )
        self._process.start()
        theirs.close()
        self._blocks = 0
        self._printed: dict[int, str] = {}  # by step

    def look(self, status: Status) -> None:
        """Print what has come; never waits."""
        self._blocks += 1
        if self._blocks % POLL_EVERY == 0:
            self._print_what_came(0.0)

    def finish(self) -> None:
        """Print what is still on its way."""
        self._print_what_came(LAST_WORD_S)

    def close(self) -> None:
        """End the analyst."""
        self._process.terminate()
        self._process.join(2.0)

    def _print_what_came(self, within_s: float) -> None:
        try:
            while self._pipe.poll(within_s):
                message = self._pipe.recv()
                if message["kind"] == "verdict":
                    _print(*verdict_lines(message))
                elif message["kind"] == "flights":
                    line = f"step {message['step'] + 1}: gamma {message['gamma']:.4f}, {message['label']}"
                    if self._printed.get(message["step"]) != line:  # the end may correct it
                        _print(line)
                    self._printed[message["step"]] = line
        except (EOFError, OSError):
            return  # it is done, or gone: the run goes on without


def verdict_lines(message: dict[str, Any]) -> list[str]:
    """A verdict as lines of text."""
    return [f"  {message['headline']}", *(f"    - {c}" for c in message["candidates"]),
            *(f"    {line}" for line in message["lines"])]  # fmt: skip


def _print(*lines: str) -> None:
    try:
        for line in lines:
            sys.stderr.write(f"{line}\n")
        sys.stderr.flush()
    except OSError:
        return  # the terminal is gone; the run goes on
