"""The analyst: a niced process that reduces a run while it lasts, and never touches the run.

It reads the recording that is being written, as `bench reprocess` does afterwards, and sends what it finds through a
pipe to the page or the terminal. However far it is behind, what it says at the end is what the closed file holds.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np

from bench.live.board import Board, Message
from bench.live.reduce import ReducedStep, cut_to, reduce_run
from bench.live.verdict import predicted, verdict_of
from bench.terminal.signals import leave_keys_to_the_parent, spawned
from daq.files.seal import Checked
from daq.recording import open_recording
from daq.recording.opening import open_checked
from daq.setup.errors import InputError
from rig.profile import Profile

AGAIN_S = 0.4  # least time between two reductions of a growing step


def start_analyst(profile: Profile, board_name: str, *, pictures: bool) -> tuple[Connection, BaseProcess]:
    """Start the process; ``pictures``: whether a page wants flights and the prediction, besides verdicts.

    Returns the pipe of its results, and the process.
    """
    return spawned(analyse, board_name, profile, pictures, name="analyst", daemon=True)


def analyse(pipe: Connection, board_name: str, profile: Profile, pictures: bool) -> None:
    """The process: until the run has ended and all is said, or no one listens any more."""
    leave_keys_to_the_parent()
    if hasattr(os, "nice"):
        # behind the run, the recorder and the page
        os.nice(5)
    try:
        board = Board(board_name)
    except OSError:
        return
    analyst = Analyst(profile, board, pipe, pictures)
    try:
        pipe.send({"kind": "ready"})
        with np.errstate(all="ignore"):  # a step that has just begun may have no flights to average
            parent = multiprocessing.parent_process()
            while not analyst.done and (parent is None or parent.is_alive()):
                if not analyst.look():
                    time.sleep(0.05)
    except (BrokenPipeError, ConnectionResetError):
        return  # no one listens
    finally:
        analyst.close()


class Analyst:
    """Steps of one run, reduced as they grow.

    Results go into ``pipe``; ``pictures`` as of `start_analyst`.
    """

    def __init__(self, profile: Profile, board: Board, pipe: Connection, pictures: bool) -> None:
        self.done = False
        self._profile, self._board, self._pipe, self._pictures = profile, board, pipe, pictures
        self._model: Iterator[Message] = predicted(profile.setup(), profile.ramp.gammas()) if pictures else iter(())
        self._path: Path | None = None
        self._begun: set[int] = set()  # first samples of the steps that were begun, and of those that are over
        self._ended: set[int] = set()
        self._played_first: dict[int, int] = {}
        self._is_over = False
        self._sent: dict[int, tuple[ReducedStep, bool]] = {}
        self._n_final = self._looks = 0
        self._judged_first = -1  # first sample of the last step that was judged
        self._due_s = 0.0

    def look(self) -> bool:
        """Take in what is new and do one piece of work; False where there was nothing to do."""
        for event in self._board.events.read()[0]:
            kind = event["kind"]
            if kind == "run":
                self._path = Path(event["out"])
            elif kind == "state":
                self._played_first[event["step"]] = event["step_first"]
            elif kind == "step":  # once as it begins, and once when it is over
                first = int(event["first_sample"])
                (self._ended if first in self._begun else self._begun).add(first)
            elif kind == "ended":
                self._is_over = True
        if self._reduce():
            return True
        portion = next(self._model, None)
        if portion is not None:
            self._pipe.send(portion)
            return True
        self.done = self._is_over
        return False

    def close(self) -> None:
        """Let go of the shared memory."""
        self._board.close()

    def _reduce(self) -> bool:
        """Reduce the run where it is due; whether there was something to do."""
        if self._path is None or (not self._begun and not self._is_over):
            return False
        has_ended = max(self._ended, default=-1) > self._judged_first
        if not (self._is_over or has_ended or (self._pictures and time.monotonic() > self._due_s)):
            return False
        path, began, is_last = self._path, time.monotonic(), self._is_over
        if is_last:
            self._path = None  # whatever comes of it
        try:
            # closed and checked at the end; unchecked before, as it was written this minute
            with open_recording(path) if is_last else open_checked(path, Checked()) as recording:
                rows = recording.steps
                first, ends = rows["first_sample"], rows["first_sample"] + rows["n_samples"]
                over = np.isin(first, list(self._ended))
                over[:-1] = True  # another step has begun since
                n_final = len(rows) if is_last else int(np.count_nonzero(over & (ends <= recording.n_samples)))
                looks = is_last or n_final > self._n_final
                if not looks and not self._pictures:
                    return False
                if looks and not is_last:  # exactly what is over, and nothing of the step that has begun
                    cut_to(recording, int(ends[n_final - 1]))
                judged = int(first[n_final - 1]) if n_final else -1
                steps, seen = reduce_run(recording, self._played_first)
        except (InputError, OSError, RuntimeError):
            self._due_s = time.monotonic() + AGAIN_S
            return False  # too short yet, or just being closed
        for k, step in enumerate(steps):
            self._send(k, step, k < n_final, exact=is_last)
        if looks and n_final:
            self._n_final, self._looks = n_final, self._looks + 1
            self._judged_first = judged
            upcoming = self._profile.ramp.gammas()[n_final:]
            self._pipe.send(verdict_of(seen, n_final - 1, self._looks, upcoming) | {"last": is_last})
        now = time.monotonic()
        # a reduction takes a fifth of the time at most, so that the run has a core
        self._due_s = now + max(AGAIN_S, 4.0 * (now - began))
        return True

    def _send(self, k: int, step: ReducedStep, is_final: bool, *, exact: bool) -> None:
        """Send a step that differs from what was sent of it: visibly, or at all at the end (``exact``)."""
        if not self._pictures and not is_final:
            return
        known = self._sent.get(k)
        # a flight that moves by less, as more is known of the instruments, is no news while the run lasts
        if known is not None and known[1] == is_final and known[0].shows(step, 0.0 if exact else 2e-5):
            return
        self._sent[k] = step, is_final
        self._pipe.send({
            "kind": "flights", "step": k, "final": is_final, "asked": step.asked, "gamma": step.gamma,
            "label": step.label, "tones": step.tones,
            "columns": (step.duration_s, step.landing_s, step.residual_s, step.noise_s, step.mark),
        })  # fmt: skip
