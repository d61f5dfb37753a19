"""The analyst: a niced process that reduces a run's steps while they last, and never touches the run.

It reads the recorder's ring and the board, and sends what it finds through a pipe to the page or the terminal.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from bench.live.board import Board, Message
from bench.live.prediction import predicted
from bench.live.reduce import ReducedStep, reduce_step
from bench.live.verdict import verdict_of
from bench.live.window import StepWindow
from daq.files.tables import Block
from daq.recorder.shared_ring import RingReader
from rig.profile import Profile

LOOK_S = 0.05
NICE = 5  # behind the run, the recorder and the page
AGAIN_S, AGAIN_PART = 0.4, 0.1  # a growing step is reduced again after that time, and that part more of it
MOST_STEP_BYTES = 256 << 20  # of a step's frames kept; beyond, its flights stay as they were


def analyse(pipe: Connection, board_name: str, profile: Profile, pictures: bool) -> None:
    """The process: until the run has ended and all is said, or nobody listens any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the run's business
    if hasattr(os, "nice"):
        os.nice(NICE)
    try:
        board = Board(board_name)
    except OSError:
        return
    analyst = Analyst(profile, board, pipe, pictures)
    try:
        with np.errstate(all="ignore"):  # of half a step nothing may be known; that is no news for a terminal
            while not analyst.done and _has_parent():
                if not analyst.look():
                    time.sleep(LOOK_S)
    except (BrokenPipeError, ConnectionResetError):
        return  # nobody listens
    finally:
        analyst.close()


def _has_parent() -> bool:
    parent = multiprocessing.parent_process()
    return parent is None or parent.is_alive()


class Analyst:
    """Steps of one run, reduced as they grow.

    Parameters
    ----------
    profile
        The run's.
    board
        Of the run.
    pipe
        Where results go.
    pictures
        Whether a page wants flights and the prediction, besides verdicts.
    """

    def __init__(self, profile: Profile, board: Board, pipe: Connection, pictures: bool) -> None:
        self.done = False
        self._profile, self._setup, self._board, self._pipe = profile, profile.setup(), board, pipe
        self._pictures = pictures
        self._model: Iterator[Message] = predicted(self._setup, profile.ramp.gammas()) if pictures else iter(())
        self._ring: RingReader | None = None
        self._run: Message = {}
        self._blocks: list[Block] = []
        self._steps: list[dict[str, Any]] = []  # rows, with "ended" once they are final
        self._next = 0  # the step that is being reduced
        self._played_first: dict[int, int] = {}
        self._reduced_at, self._reduced_samples = 0.0, 0
        self._over = False
        self._finished: list[tuple[int, ReducedStep]] = []

    def look(self) -> bool:
        """Take in what is new and do one piece of work; False where there was nothing to do."""
        for event in self._board.events.read()[0]:
            self._take_in(event)
        more = self._read_ring()
        if self._reduce():
            return True
        portion = next(self._model, None)
        if portion is not None:
            self._pipe.send(portion)
            return True
        self.done = self._over and not more and (self._next >= len(self._steps) or not more)
        return more

    def close(self) -> None:
        """Let go of the shared memory."""
        if self._ring is not None:
            self._ring.close()
        self._board.close()

    def _take_in(self, event: Message) -> None:
        kind = event["kind"]
        if kind == "run":
            self._run = event
            try:
                self._ring = RingReader(*event["ring"])
            except OSError:
                self._ring = None  # already over
        elif kind == "state":
            self._played_first[event["step"]] = event["step_first"]
        elif kind == "step":
            if self._steps and self._steps[-1]["first_sample"] == event["first_sample"]:
                self._steps[-1] = {**event, "ended": True}
            else:
                self._steps.append({**event, "ended": False})
        elif kind == "ended":
            self._over = True

    def _read_ring(self) -> bool:
        if self._ring is None:
            return False
        blocks = self._ring.read()
        self._blocks += blocks
        first = self._steps[self._next]["first_sample"] if self._next < len(self._steps) else None
        if first is not None:
            self._blocks = [b for b in self._blocks if b.first_sample + len(b.codes) > first]
        return bool(blocks)

    def _reduce(self) -> bool:
        """Reduce the present step where it is due; whether there was something to do."""
        if self._next >= len(self._steps) or not self._blocks:
            return False
        step = self._steps[self._next]
        have = self._blocks[-1].first_sample + len(self._blocks[-1].codes) - step["first_sample"]
        planned = int(step["n_samples"])
        is_final = step["ended"] and (have >= planned or self._over)
        known = len(self._steps) > self._next + 1 or self._over
        if not is_final and not known:
            grown = have - self._reduced_samples > AGAIN_PART * max(self._reduced_samples, 1)
            too_large = have * 2 * len(self._run["channels"]) > MOST_STEP_BYTES
            if too_large or not (grown and time.monotonic() - self._reduced_at > AGAIN_S):
                return False
        elif not is_final and not self._over:
            return False  # its last frames, or its row, are still on the way
        found = self._reduced(step, min(have, planned))
        self._reduced_at, self._reduced_samples = time.monotonic(), have
        if found is not None and (self._pictures or is_final):
            self._send(found, is_final)
        if is_final or self._over:
            self._next += 1
            self._reduced_samples = 0
        return True

    def _reduced(self, step: dict[str, Any], n_samples: int) -> ReducedStep | None:
        row = {key: value for key, value in step.items() if key not in ("kind", "ended") and value is not None}
        row["n_samples"] = n_samples
        window = StepWindow(self._setup, self._run["channels"], self._run["scales"], row, self._blocks)
        return reduce_step(window, step["gamma"], self._played_first.get(self._next, step["first_sample"]))

    def _send(self, found: ReducedStep, is_final: bool) -> None:
        self._pipe.send(
            {
                "kind": "flights",
                "step": self._next,
                "final": is_final,
                "asked": self._steps[self._next]["gamma"],
                "gamma": found.gamma,
                "label": found.label,
                "tones": found.tones,
                "columns": (found.duration_s, found.landing_s, found.residual_s, found.noise_s, found.mark),
            }
        )
        if is_final and found.observations is not None:
            self._finished.append((self._next, found))
            observations = [one.observations for _, one in self._finished if one.observations is not None]
            upcoming = self._profile.ramp.gammas()[self._next + 1 :]
            self._pipe.send(verdict_of(observations, self._next, upcoming))
