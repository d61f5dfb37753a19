"""The recorder as a process of its own, fed through a ring in shared memory.

Nothing that an operator's process does (pictures, garbage collection, a busy script, reading other files) can cost a
sample. The recorder does nothing but take blocks and write them; the ring holds what comes while the disk is slow.
`RecorderProcess` is used like `RecordingWriter`.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import accumulate
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.files.tables import Block
from daq.recorder.shared_ring import Ring
from daq.recording.writer import ClosedRun, Ending, RecordingWriter
from daq.setup.clock import SYSTEM, Clock
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from kernels import BLAS_THREADS

IDLE_S = 0.001
NOT_FOR_US = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")  # words to the run, which then closes the recording


Order = tuple[tuple[int, int, int, str], str, str, dict[str, Any]]
"""Of a recorder: its ring, path, setup as JSON, and options of `RecordingWriter`."""


def spawn(order: Order) -> tuple[Connection, BaseProcess]:
    """A process that records, and the pipe to it."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_record, args=(theirs, *order), name="recorder")
    with _start_conditions():
        process.start()
    theirs.close()
    return ours, process


class RecorderProcess(ClosedRun):
    """Record one run in a process of its own; raises `InputError` as for `RecordingWriter`.

    Parameters
    ----------
    path, setup, options
        As for `RecordingWriter`.
    block_samples
        Largest block that will come.
    ring_s
        Seconds that the ring holds; None takes what a stalled disk or a stopped recorder needs.
    patience_s
        How long `append` waits for room in a full ring before the block counts as lost; 0 for a device, which cannot
        wait.
    private
        Whether no other process attaches to the ring by its name; it then loses its name once the recorder runs.
    start, clock
        How the process is started, and its user's clock; a simulation has its own.
    """

    def __init__(
        self,
        path: Path | str,
        setup: Setup,
        *,
        block_samples: int = 1024,
        ring_s: float | None = None,
        patience_s: float = 10.0,
        private: bool = True,
        start: Callable[[Order], tuple[Connection, BaseProcess]] = spawn,
        clock: Clock = SYSTEM,
        **options: Any,
    ) -> None:
        self.path = Path(path)
        self._clock = clock
        rate_hz, channels = setup.sampling.rate_hz, len(options["channels"])
        if ring_s is None:  # the recorder may be unable to write for half a minute, unless that takes too much memory
            ring_s = max(4.0, min(30.0, 2**25 / (2 * channels * rate_hz)))
        self.ring = Ring(max(4, int(np.ceil(ring_s * rate_hz / block_samples)) + 1), block_samples, channels)
        self._patience_s, self._ring_s = patience_s, ring_s
        shape = (self.ring.slots, block_samples, channels, self.ring.name)
        self._pipe, self._process = start((shape, str(path), setup.model_dump_json(), options))
        self.n_samples = 0
        self.is_open = True
        self._fault = ""  # the recorder's message when it gave up
        try:
            self._answer("start", 60.0)
        except (InputError, OSError):
            self.ring.close()
            raise
        if private:
            self.ring.unname()

    @property
    def safe_samples(self) -> int:
        """Frames that a kill can no longer lose."""
        return self.ring.counter("safe_samples")

    def append(self, *blocks: Block) -> None:
        """Hand blocks over, if any, and look whether the recorder lives; they are safe once `safe_samples` passed them.

        Raises `OSError` when the recorder had to give up (disk full, file gone), or has not written for as long as the
        ring holds; what it has stays, and what the ring holds is written as soon as it can.
        """
        if self._pipe.poll():
            self._answer("error", 0.0)
        for block in (piece for whole in blocks for piece in whole.pieces(self.ring.block_samples)):
            until = self._clock.monotonic_s() + self._patience_s
            while (
                self.ring.backlog >= self.ring.slots and self._clock.monotonic_s() < until and self._process.is_alive()
            ):
                self._clock.sleep(IDLE_S)
            if not self.ring.put(block):
                raise OSError(
                    f"{self.path}: the recorder has not written for {self._ring_s:.0f} s (stopped, or a stalled disk); "
                    "nothing after that is stored"
                )
            self.n_samples += len(block.codes)

    def mark_step(self, step: np.void | Mapping[str, Any]) -> None:
        """As `RecordingWriter.mark_step`."""
        names = step.dtype.names if isinstance(step, np.void) else tuple(step)
        self._pipe.send(("mark_step", {name: step[name] for name in names or ()}))

    def mark_rows(self, table: str, rows: NDArray[np.void]) -> None:
        """As `RecordingWriter.mark_rows`."""
        self._pipe.send((table, rows))

    def close(self, how: Ending = "complete", why: str = "", *, expected_samples: int | None = None) -> None:
        """End the recording once everything handed over is written; as `RecordingWriter.close`."""
        if not self.is_open:
            return
        self.is_open = False
        try:
            self._pipe.send(("close", (how, why, expected_samples)))
            self._answer("close", 600.0)
        except (BrokenPipeError, ConnectionResetError) as error:
            raise self._gone() from error
        finally:
            self._process.join(5.0)
            self.ring.close()

    def _gone(self) -> OSError:
        """What a recorder that is no more said last, or that it is gone."""
        return OSError(self._fault or f"{self.path}: the recorder is gone; run: bench recover {self.path}")

    def _answer(self, to: str, within_s: float) -> None:
        """Wait for the recorder's answer; an error it reports is raised here."""
        until = self._clock.monotonic_s() + within_s
        while not self._pipe.poll(min(0.2, within_s)):
            if not self._process.is_alive() or self._clock.monotonic_s() > until:
                raise OSError(f"{self.path}: the recorder does not answer ({to}); run: bench recover {self.path}")
        try:
            kind, message = self._pipe.recv()
        except (EOFError, ConnectionResetError) as error:  # it was killed: its end of the pipe is closed
            raise self._gone() from error
        if kind == "input":
            raise InputError(message)
        if kind == "error":
            self._fault = message
            raise OSError(message)


def _not_for_us() -> list[signal.Signals]:
    """Signals that the recorder outlives, of those that this system has."""
    return [signal.Signals[name] for name in NOT_FOR_US if hasattr(signal, name)]


@contextmanager
def _start_conditions() -> Iterator[None]:
    """Conditions under which the recorder starts: one thread for linear algebra, and no signal that is for the run.

    Signals are held back (POSIX), so that none meets the recorder before it knows to ignore them.
    """
    environment = {name: os.environ.get(name) for name in BLAS_THREADS}
    os.environ.update(dict.fromkeys(BLAS_THREADS, "1"))
    can_hold = hasattr(signal, "pthread_sigmask")
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, _not_for_us()) if can_hold else set()
    try:
        yield
    finally:
        if can_hold:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for name, value in environment.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value


def _record(
    pipe: Connection, shape: tuple[int, int, int, str], path: str, setup_json: str, options: dict[str, Any]
) -> None:
    """The recorder's process: it ignores the operator's signals, does not collect garbage, and records."""
    for number in _not_for_us():
        signal.signal(number, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _not_for_us())
    turns = recording(pipe, (shape, path, setup_json, options))
    next(turns, None)
    gc.collect()  # a collection later would pause the recorder
    gc.freeze()
    sys.setswitchinterval(0.0005)
    for _ in turns:
        pass


def recording(pipe: Connection, order: Order, clock: Clock = SYSTEM) -> Iterator[None]:
    """Record what comes through the ring, until asked to close; the first turn opens the file, each other takes blocks.

    Through ``pipe`` words come from the run, and "ready" and how it ended go back. A simulation, whose iterator takes
    turns with all else, has a clock of its own.
    """
    shape, path, setup_json, options = order
    try:
        writer = RecordingWriter(path, Setup.model_validate_json(setup_json), clock=clock, **options)
    except InputError as error:
        pipe.send(("input", str(error)))
        return
    ring = Ring(*shape)
    yield
    with suppress(BrokenPipeError, ConnectionResetError):  # a run that is gone already is noticed below
        pipe.send(("ready", ""))
    closing: tuple[Ending, str, int | None] | None = None
    try:
        while closing is None or ring.backlog:  # what the ring holds is written before the end
            blocks = ring.take()
            if blocks:
                # they follow what is recorded, whatever the ring could not take
                firsts = accumulate((len(block.codes) for block in blocks), initial=writer.n_samples)
                writer.append(*(replace(b, first_sample=at) for b, at in zip(blocks, firsts, strict=False)))
                ring.set_counter("safe_samples", writer.n_samples)
            if closing is None:
                closing = _obey(pipe, writer, 0.0 if blocks else IDLE_S)
            yield
        how, why, expected_samples = closing
        writer.close(how, why, expected_samples=expected_samples)
        pipe.send(("closed", ""))
    except OSError as error:
        message = str(error)
        try:  # what there is stays
            writer.close("failed", message)
        except OSError as also:
            message = f"{message}; {also}"
        with suppress(BrokenPipeError, ConnectionResetError):  # the other side may be gone
            pipe.send(("error", message))
    finally:
        ring.close()
        ring.unname()


def _obey(pipe: Connection, writer: RecordingWriter, wait_s: float) -> tuple[Ending, str, int | None] | None:
    """Do what is asked; returns how to close when that is asked, or when the asking process is gone."""
    while pipe.poll(wait_s):
        wait_s = 0.0
        try:
            word, what = pipe.recv()
        except (EOFError, ConnectionResetError):
            return ("failed", "the process that drove the run is gone", None)
        if word == "close":
            how, why, expected_samples = what
            return (how, why, expected_samples)
        if word == "mark_step":
            writer.mark_step(what)
        else:
            writer.mark_rows(word, what)
    return None
