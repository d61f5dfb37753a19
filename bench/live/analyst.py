"""The analyst: a niced process that reduces a run while it lasts, judges it so far, and never touches the run.

It reads the recording that is being written, as `bench reprocess` does afterwards, and sends what it finds through a
pipe to the page or the terminal. However far it is behind, what it says at the end is what the closed file holds. The
verdict so far: is it noise, which candidates could already explain it, what will the steps to come tell?
"""

from __future__ import annotations

import cmath
import contextlib
import math
import multiprocessing
import os
import time
from collections.abc import Iterator, Mapping
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from analysis.flights.assemble import flights_of
from analysis.flights.classify import classify
from analysis.flights.table import FlightFlag, Flights
from analysis.loop.so_far import Promising, judge_so_far
from analysis.report.wording import gamma_scale
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.uncertainty import uncertainty_at
from analysis.residuals.observations import Observations, observed
from bench.live.board import Board, Message
from bench.terminal.run_console import leave_keys_to_the_parent
from daq.files.seal import Checked
from daq.recording import Recording, open_recording
from daq.recording.opening import open_checked
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from model.bifurcations.forbidden_zones import forbidden_zones
from model.effects.registry import Effects, ball_effects, resolve
from model.orbits.attractor import attractor
from model.orbits.exact_ball import IdealBall
from model.orbits.make_ball import make_ball
from model.surveys.diagram import diagram
from model.tones import Forcing
from rig.profile import Profile

PLAIN, DOUBTFUL, POOR = range(3)  # marks of a flight
_POOR = FlightFlag.FALSE | FlightFlag.SETTLING | FlightFlag.CUT | FlightFlag.GAP


def shows(one: Message, other: Message, within_s: float) -> bool:
    """Whether two reductions of a step show the same flights, none moved by more than ``within_s``."""
    if one["label"] != other["label"] or not np.array_equal(one["columns"][-1], other["columns"][-1]):
        return False
    pairs = zip(one["columns"][:3], other["columns"][:3], strict=True)
    return all(np.allclose(x, y, rtol=0.0, atol=within_s, equal_nan=True) for x, y in pairs)


def cut_to(recording: Recording, n_samples: int) -> None:
    """Leave out of an open recording what came after its first ``n_samples``."""
    recording.n_samples = min(recording.n_samples, n_samples)
    recording.steps = recording.steps[recording.steps["first_sample"] < recording.n_samples]
    recording.blocks = recording.blocks[recording.blocks["first_sample"] < recording.n_samples]
    recording.gaps = recording.gaps[recording.gaps[:, 0] < recording.n_samples]


def reduce_run(recording: Recording, played_first: Mapping[int, int]) -> tuple[list[Message], Observations]:
    """All steps of a run so far as messages, and the observations for its verdict (`InputError`: too few samples).

    A message has the step's gammas, asked for and on the plate (NaN: unknown), class, tones, and columns of its
    flights: duration, landing since its first sample, residual of that by the declared model (NaN: not compared), its
    uncertainty (all s), and mark: `PLAIN`, `DOUBTFUL` (double hit, or unsure) or `POOR` (settling, cut, no flight).

    ``recording`` is open: the run's, however long it is yet. ``played_first`` has, by step, the index of its first
    sample among the played ones, from which phases count; where it is not known, that among the recorded ones does.
    """
    flights = flights_of(recording)
    seen = observed(recording, flights, with_mode=False)
    residual, noise = np.full(len(flights), np.nan), np.full(len(flights), np.nan)
    if (judged := seen.scored).any():
        model = ForwardModel(seen, resolve(recording.setup.declared_values()))
        row = np.minimum(np.searchsorted(flights.landing_s, seen.measured.landing_s - 1e-9), len(flights) - 1)[judged]
        residual[row] = model.residuals({}).landing_s[judged]
        noise[row] = uncertainty_at(model, {}).landing_total_s[judged]
    mark = np.where(flights.has(FlightFlag.DOUBLE_HIT | FlightFlag.UNSURE), DOUBTFUL, PLAIN)
    mark = np.where(flights.has(_POOR), POOR, mark).astype(np.uint8)
    labels, steps = {one.step: one.label for one in classify(flights)}, list[Message]()
    for k, row in enumerate(recording.steps):
        own, plate, first = flights.step == k, flights.plate.steps[k], int(row["first_sample"])
        landing_s = flights.landing_s[own] - first / recording.rate_hz
        steps.append({
            "kind": "flights", "step": k, "asked": float(row["gamma"]),
            "gamma": math.nan if plate is None else plate.gamma, "label": labels.get(k, "undecided"),
            "tones": _tones(flights, k, recording.setup, row, played_first.get(k, first)),
            "columns": (flights.duration_s[own], landing_s, residual[own], noise[own], mark[own]),
        })  # fmt: skip
    return steps, seen


def _tones(flights: Flights, step: int, setup: Setup, row: np.void, first_played: int) -> list[dict[str, Any]]:
    """Amplitude and phase of each forcing tone of a step, on the plate and asked for."""
    plate, rows, gamma = flights.plate.steps[step], [], float(row["gamma"])
    # the plate's phases count from the first recorded sample, those asked for from the first played one
    recorded_s = float(flights.plate.true_time_s(row["first_sample"] / setup.sampling.rate_hz))
    turn = 2.0 * math.pi * setup.forcing.frequency_hz * (recorded_s - first_played / setup.sampling.rate_hz)
    for multiple, displacement in setup.forcing.displacement_tones():
        # a_p = -g gamma sum m^2 Re[d exp(i m w t)]
        target = -setup.g_mps2.value * gamma * multiple * multiple * displacement
        target_deg = math.degrees(cmath.phase(target)) if target else 0.0
        found: dict[str, Any] = {"multiple": multiple, "target_mps2": abs(target), "target_deg": target_deg}
        found |= {"mps2": None, "deg": None}
        if plate is not None and multiple in plate.multiples:
            z = plate.acceleration.amplitudes[plate.multiples.index(multiple)] * cmath.exp(1j * multiple * turn)
            found["mps2"], found["deg"] = float(abs(z)), math.degrees(cmath.phase(z))
        rows.append(found)
    return rows


def nominal_forcing(setup: Setup) -> Forcing:
    """The forcing as the profile asks for it, its first tone at phase zero."""
    multiples, displacements = zip(*setup.forcing.displacement_tones(), strict=True)
    return Forcing.of_displacements(multiples, np.array(displacements), from_first=True)


def predicted(setup: Setup, gammas: tuple[float, ...]) -> Iterator[dict[str, Any]]:
    """Portions of the prediction: lists of gammas as shown, flight times (ms), and zones (gamma, low, high; ms)."""
    shown = gamma_scale(setup.forcing, setup.forcing.ratio).factor
    low, high = 0.97 * min(gammas), 1.03 * max(gammas)
    omega = 2.0 * np.pi * setup.forcing.frequency_hz
    forcing, declared = nominal_forcing(setup), setup.declared_values()
    own = ball_effects(declared)
    ball = make_ball(forcing, own, frequency_hz=setup.forcing.frequency_hz, g_mps2=setup.g_mps2.value)
    grid = np.linspace(low, high, 480 if isinstance(ball, IdealBall) else 160)
    zone_grid = np.linspace(low, high, 120)
    # a little wider than the grid, so that neighbouring bars of a zone overlap
    half = 0.52 * (zone_grid[1] - zone_grid[0]) * shown
    # twenty gammas at a time: between two portions the caller looks at the run
    portions = -(-len(grid) // 20)
    for k in range(portions):
        rows = diagram(ball, grid[k::portions])  # every so many-th: the whole range is there at once, coarsely
        finite = np.isfinite(rows.tau)
        x = np.repeat(rows.gamma[:, None], rows.tau.shape[1], axis=1)[finite] * shown
        zones = [
            [float(gamma * shown), half, float(1e3 * a / omega), float(1e3 * b / omega)]
            for gamma in zone_grid[k::portions]
            for a, b in forbidden_zones(forcing, float(gamma))
            if a > 0.0
        ]
        yield {
            "kind": "model",
            "gamma": [round(float(v), 5) for v in x],
            "tau_ms": [round(float(v), 4) for v in 1e3 * rows.tau[finite] / omega],
            "zones": [[round(v, 5) for v in zone] for zone in zones],
            "part": (k + 1) / portions,
        }


def verdict_of(seen: Observations, step: int, look: int, upcoming: tuple[float, ...]) -> dict[str, Any]:
    """The verdict after a step: ``within`` noise or not, ``headline``, ``candidates``, ``lines``, ``floor_us``.

    ``seen`` are the observations of the steps that are over, of which the last is ``step``, from 0; ``look`` is the
    number of this verdict among those of the run, from 1; ``upcoming`` are the gammas of the steps to come.
    """
    found = judge_so_far(seen, look)
    out: dict[str, Any] = {"kind": "verdict", "step": step, "within": True, "candidates": []}
    if found is None:
        return out | {"headline": "no flights to judge yet", "lines": [], "floor_us": None}
    sizes = f"landings missed by {found.landing_rms_us:.2g} \u00b5s rms, noise floor {found.floor_us:.2g} \u00b5s"
    lines = [f"{len(seen.steps)} steps, {found.flights} flights; {sizes}"]
    out |= {"lines": lines, "floor_us": found.floor_us}
    if found.within:
        return out | {"headline": "within noise of the declared model"}
    lines.append(f"probability of so much by noise: {found.p:.1g}; at this step {found.level:.1g} is asked")
    if not found.promising:
        lines.append("no single candidate explains it yet")
    lines += _next_steps(seen.setup, found.promising, upcoming, step)
    candidates = [f"{' + '.join(one.names)} (gain {one.gain:.3g} nats)" for one in found.promising]
    headline = "more than noise: the declared model misses something"
    return out | {"within": False, "headline": headline, "candidates": candidates}


def _next_steps(setup: Setup, promising: tuple[Promising, ...], upcoming: tuple[float, ...], step: int) -> list[str]:
    """What three of the steps to come will tell of the two best candidates that act on the ball."""
    balls = []
    for one in promising:
        effects = {name: dict(table) for name, table in setup.declared_values().items()}
        for (name, parameter), value in one.values.items():
            effects.setdefault(name, {})[parameter] = value  # a candidate at its linearised values
        if own := ball_effects(effects):
            balls.append((" + ".join(one.names), own))
    if len(balls) < 2 or not upcoming:
        return []
    (first, own), (second, other) = balls[:2]
    shown = gamma_scale(setup.forcing, setup.forcing.ratio).factor
    lines = []
    for k in sorted({round(k) for k in np.linspace(0, len(upcoming) - 1, 3)}):
        difference_ms = abs(_mean_ms(setup, own, upcoming[k]) - _mean_ms(setup, other, upcoming[k]))
        if difference_ms > 0.01:
            where = f"step {step + 1 + k} (\u0393 {shown * upcoming[k]:.3g})"
            lines.append(f"{where}: {first} and {second} differ by {difference_ms:.2g} ms of flight")
    return lines or [f"the steps to come will hardly tell {first} from {second}"]


def _mean_ms(setup: Setup, effects: Effects, gamma: float) -> float:
    """Mean flight time of the motion that a model predicts; NaN where it has none."""
    with contextlib.suppress(ValueError, ArithmeticError):
        forcing, hz = nominal_forcing(setup), setup.forcing.frequency_hz
        tau = attractor(make_ball(forcing, effects, frequency_hz=hz, g_mps2=setup.g_mps2.value), gamma).tau
        return 1e3 * float(np.mean(tau)) / (2.0 * math.pi * hz) if tau.size else 0.0
    return math.nan


AGAIN_S = 0.4  # least time between two reductions of a growing step


def analyse(pipe: Connection, board_name: str, profile: Profile, pictures: bool) -> None:
    """The process (`spawned`): until the run has ended and all is said, or no one listens any more.

    Results go into ``pipe``; ``pictures``: whether a page wants flights and the prediction, besides verdicts.
    """
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
        board.close()


class Analyst:
    """Steps of one run, reduced as they grow; arguments as of `analyse`."""

    def __init__(self, profile: Profile, board: Board, pipe: Connection, pictures: bool) -> None:
        self.done = False
        self._profile, self._board, self._pipe, self._pictures = profile, board, pipe, pictures
        self._model: Iterator[Message] = predicted(profile.setup(), profile.ramp.gammas()) if pictures else iter(())
        self._path: Path | None = None
        self._begun: set[int] = set()  # first samples of the steps that were begun, and of those that are over
        self._ended: set[int] = set()
        self._played_first: dict[int, int] = {}
        self._is_over = False
        self._sent: dict[int, tuple[Message, bool]] = {}
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
            self._send(step, k < n_final, exact=is_last)
        if looks and n_final:
            self._n_final, self._looks = n_final, self._looks + 1
            self._judged_first = judged
            upcoming = self._profile.ramp.gammas()[n_final:]
            self._pipe.send(verdict_of(seen, n_final - 1, self._looks, upcoming) | {"last": is_last})
        now = time.monotonic()
        # a reduction takes a fifth of the time at most, so that the run has a core
        self._due_s = now + max(AGAIN_S, 4.0 * (now - began))
        return True

    def _send(self, step: Message, is_final: bool, *, exact: bool) -> None:
        """Send a step that differs from what was sent of it: visibly, or at all at the end (``exact``)."""
        if not self._pictures and not is_final:
            return
        known = self._sent.get(step["step"])
        # a flight that moves by less, as more is known of the instruments, is no news while the run lasts
        if known is not None and known[1] == is_final and shows(known[0], step, 0.0 if exact else 2e-5):
            return
        self._sent[step["step"]] = step, is_final
        self._pipe.send(step | {"final": is_final})
