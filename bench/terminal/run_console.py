r"""A run at the terminal: its display, the signals that stop it, and orders typed while it is driven.

The display is drawn a few times a second: three lines on standard error, a narrow terminal has one line a figure. It is
fed once a block and only draws; nothing waits for it, and no stop goes through it. A terminal that is gone (closed, or
a dropped connection) costs the run nothing, as standard error is a stream that may go away
(`bench.terminal.streams.SafeStream`).

Ctrl-C, Ctrl-\, SIGTERM and a closed terminal (SIGHUP) ask for a soft stop: the first ramps down, the second sets the
drive to zero at once; the former handlers are restored. A closing terminal may send SIGHUP several times: which never
makes a soft stop a hard one.

Orders are hold, go on, other steps, stop. One thread reads the terminal for the whole call; a run takes what came after
each of its blocks, and never waits. The same words are answers where the call does ask.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import queue
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from types import FrameType
from typing import Any

import typer

from daq.setup.errors import InputError
from rig.execution.operator import Status, StopRequest
from rig.programme.ramp import NextSteps
from rig.programme.sequencer import State, Stop

LIMITS = {
    "drive_v": "drive", "plate_mps2": "acceleration", "velocity_mps": "velocity", "displacement_m": "displacement",
}  # fmt: skip


@contextmanager
def run_display(quiet: bool) -> Iterator[Callable[[Status], None]]:
    """A bar, the step with its gammas and the state of contact and samples, and the part used of each limit."""
    from rich.console import Console, Group
    from rich.live import Live
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
    from rich.text import Text

    if quiet:
        yield lambda status: None
        return
    bar = Progress(TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    task = bar.add_task("", total=None)
    lines = Text(overflow="fold")
    screen = Console(stderr=True)
    narrow = screen.width < 80
    with Live(lines if narrow else Group(bar, lines), console=screen, refresh_per_second=4) as live:

        def show(status: Status) -> None:
            done = status.n_samples - status.left_samples
            bar.update(task, total=status.n_samples, completed=done, description=step_line(status))
            lines.plain = f"{health_line(status)}\n{limits_line(status)}"
            if narrow:  # one figure a line, what must not be missed first
                step = f"{step_line(status)}, {1.0 - status.left_samples / max(status.n_samples, 1):.0%}"
                gammas, contact, lost = health_line(status).split("; ")
                lines.plain = "\n".join([step, lost, contact, *gammas.split(", "), *limits_line(status).split(", ")])
            if (status.state is State.PAUSED) is live.is_started:
                live.stop() if live.is_started else live.start()  # while it holds, nothing is drawn over what is typed

        yield show
    if not screen.is_terminal:
        screen.line()  # a terminal's cursor is left on a new line; in a log, what follows would go on in the same


def step_line(status: Status) -> str:
    """The step, counted from 0 as in every table, and its state."""
    return f"step {status.step.index} (last {status.n_steps - 1}), {status.state.value}"


def health_line(status: Status) -> str:
    """Commanded and achieved gamma, whether the contact lives, samples lost."""
    achieved = "-"
    if math.isfinite(status.achieved_gamma):  # one digit of the uncertainty: the line has 80 characters
        achieved = f"{status.achieved_gamma:.4g} +- {status.achieved_gamma_uncertainty:.1g} (last hold)"
    age = status.contact_age_cycles
    contact = "alive" if age <= 3.0 else f"silent for {age:.0f} cycles"
    return f"gamma {status.step.gamma:.4g}, achieved {achieved}; contact {contact}; {status.lost_samples} samples lost"


def limits_line(status: Status) -> str:
    """The part of each limit in use."""
    parts = (f"{word} {status.limits_in_use[key]:.0%}" for key, word in LIMITS.items() if key in status.limits_in_use)
    return f"of the limits: {', '.join(parts)}"


def leave_keys_to_the_parent() -> None:
    """Ignore what the keys of a terminal send to all its processes: Ctrl-C, and Ctrl-\\ where there is SIGQUIT."""
    for name in ("SIGINT", "SIGQUIT"):
        if hasattr(signal, name):
            signal.signal(signal.Signals[name], signal.SIG_IGN)


def spawned(
    body: Callable[..., None], *arguments: Any, name: str, daemon: bool = False
) -> tuple[Connection, BaseProcess]:
    """A started process (a daemon ends with ours) that runs ``body`` on its end of a pipe; our end, and the process."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=body, args=(theirs, *arguments), name=name, daemon=daemon)
    process.start()
    theirs.close()
    return ours, process


@contextmanager
def stop_on_signals(request: StopRequest | None = None) -> Iterator[StopRequest]:
    """A `StopRequest` that these signals set while the block runs; in the main thread only."""
    request = request or StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield request  # Python delivers signals only to the main thread
        return
    asked: list[str] = []

    def handle(number: int, frame: FrameType | None) -> None:
        name = signal.Signals(number).name
        if name == "SIGHUP" or not asked:
            request.ask(Stop.RAMP_DOWN, f"{name}: ramped down")
        else:
            request.ask(Stop.NOW, f"{name} again: stopped now")
        if name != "SIGHUP":
            asked.append(name)

    # Windows has no SIGHUP and no SIGQUIT
    known = [signal.Signals[n] for n in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, n)]
    before = {number: signal.signal(number, handle) for number in known}
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


WORDS = (
    "h hold, g go on, n end this block, 0.8, 1.2 these gammas next (c=2 0.8 1.2 too), s stop; a reason after a colon"
)
PERSON = "a person"


def steps_from(text: str) -> NextSteps:
    """Next steps from ``0.8, 1.2: why`` or ``c=2 0.8 1.2`` (raises `InputError`); none leave the choice to the rig."""
    what, _, why = text.partition(":")
    ratio, gammas = None, list[float]()
    for word in re.split(r"[,\s]+", what.strip()):
        name, equals, value = word.partition("=")
        try:
            if equals and name == "c" and int(value) > 0:
                ratio = int(value)
            elif word:
                gammas.append(float(word))
        except ValueError as error:
            raise InputError(f"{text.strip()}: wanted {WORDS}") from error
    if (ratio is not None and not gammas) or not all(0.0 < gamma < float("inf") for gamma in gammas):
        raise InputError(f"{text.strip()}: wanted positive gammas, as 0.8, 1.2 or c=2 0.8 1.2")
    return NextSteps(tuple(gammas), ratio, why.strip())


def free_keys(settings: list[str]) -> dict[str, Any]:
    """``KEY=VALUE`` texts as a mapping; a value that reads as a number is one. Raises `InputError`."""
    keys: dict[str, Any] = {}
    for setting in settings:
        key, equals, value = (part.strip() for part in setting.partition("="))
        if not key or not equals:
            raise InputError(f"--set {setting}: wanted KEY=VALUE, as amplifier_knob=3")
        if key in keys:
            raise InputError(f"--set {setting}: {key} was set before; give each key once")
        try:
            keys[key] = float(value)
        except ValueError:
            keys[key] = value
    return keys


def obey(request: StopRequest, line: str) -> str:
    """Do what a line typed during a run asks; what was understood, in words (`InputError`: not understood)."""
    word, _, why = (part.strip() for part in line.partition(":"))
    match word.lower():
        case "" | "h" | "hold":
            request.hold(PERSON, why)
            return f"holding after this step; {WORDS}"
        case "g" | "go" | "go on":
            request.go_on(PERSON, why)
            return "going on"
        case "n" | "next":
            request.take_over(PERSON, NextSteps(why=why))
            return "finishing this step; the rig chooses the next block"
        case "s" | "stop":
            request.ask(Stop.FINISH_STEP, f"{PERSON}: step finished{f', {why}' if why else ''}")
            return "finishing this step; Ctrl-C ramps down at once"
    request.take_over(PERSON, steps_from(line))
    return "finishing this step; your steps are next"


class TypedLines:
    """Lines typed at a terminal: a thread, which ends with the program, reads ``descriptor`` without a buffer."""

    def __init__(self, descriptor: int) -> None:
        self._lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        threading.Thread(target=self._read, args=(descriptor,), name="terminal", daemon=True).start()

    def _read(self, descriptor: int) -> None:
        rest = b""
        with suppress(OSError):  # the terminal is gone, or belongs to another program now
            while piece := os.read(descriptor, 4096):
                *lines, rest = (rest + piece).split(b"\n")
                for line in lines:
                    self._lines.put(line.decode(errors="replace").strip())
        self._lines.put(None)

    def take(self) -> list[str]:
        """Lines since the last call; never waits."""
        found = list[str]()
        while not self._lines.empty():
            line = self._lines.get()
            if line is None:
                self._lines.put(None)  # for whoever asks
                break
            found.append(line)
        return found

    def answer(self, prompt: str) -> str | None:
        """The next line that is typed after ``prompt``; None where no one can type any more."""
        self.take()
        typer.echo(f"{prompt}: ", nl=False)
        while True:
            with suppress(queue.Empty):
                # in short waits, so that an interrupt comes through on Windows too
                line = self._lines.get(timeout=0.2)
                if line is None:
                    self._lines.put(None)
                return line

    def obeyed(self, request: StopRequest, progress: Callable[[Status], None]) -> Callable[[Status], None]:
        """``progress``, with the lines that came obeyed before it."""

        def after_block(status: Status) -> None:
            for line in self.take():
                try:
                    reply = obey(request, line)
                except InputError as error:
                    reply = str(error)
                with suppress(OSError):  # the terminal may be gone
                    typer.echo(reply, err=True)
            progress(status)

        return after_block


def typed_lines() -> TypedLines | None:
    """Lines typed at this program's terminal; None where it has none."""
    try:
        if not sys.stdin.isatty():
            return None
        descriptor = sys.stdin.fileno()
    except (AttributeError, ValueError, OSError):
        return None  # no standard input, or one that is closed
    if hasattr(signal, "SIGTTIN") and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTTIN, signal.SIG_IGN)  # POSIX: in the background reading fails instead of stopping us
    return TypedLines(descriptor)
