"""Orders typed while the rig is driven: hold, go on, other steps, stop.

One thread reads the terminal for the whole call; a run takes what came after each of its blocks, and never waits. The
same words are answers where the call does ask.
"""

from __future__ import annotations

import os
import queue
import re
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import typer

from daq.setup.errors import InputError
from rig.execution.operator import StopRequest
from rig.programme.ramp import NextSteps
from rig.programme.sequencer import Stop

if TYPE_CHECKING:
    from rig.execution.operator import Status

WORDS = (
    "h hold, g go on, n end this block, 0.8, 1.2 these gammas next (c=2 0.8 1.2 too), s stop; a reason after a colon"
)
PERSON = "a person"


def steps_from(text: str) -> NextSteps:
    """Next steps from words as ``0.8, 1.2: why`` or ``c=2 0.8 1.2``; no gammas leave the choice to the rig.

    Raises `InputError` for what is no number.
    """
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
    """Do what a line typed during a run asks; what was understood, in words.

    Raises `InputError` for what cannot be done, or is not understood.
    """
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
    """Lines typed at a terminal.

    ``descriptor`` is read to its end, without a buffer, by a thread that ends with the program: it may end while the
    thread waits.
    """

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
