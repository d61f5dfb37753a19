"""Data of a run's page: saved closed loops, extremes for its scope, flights for its diagram; cached on disk.

Made by a process of its own, so that the pages answer meanwhile. `look` is the body of the process that reads closed
loops for the catalogue: what it needs is imported before its time is counted. The evidence (rivals, steps, residuals,
the two edges of each flight) stands in the file; nothing is computed anew. Decision 496.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import multiprocessing
import os
import tempfile
import threading
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import numpy as np

from analysis.flights.assemble import flights_of
from analysis.flights.classify import classify
from analysis.flights.table import FlightFlag
from analysis.loop.result import ClosedLoop, load_verdict
from analysis.loop.verdict import VERDICTS, short_verdict
from analysis.statistics import Z95
from bench.outputs import probe
from bench.runs.catalogue import Row
from bench.runs.folder import PLACE, quantity
from bench.runs.scope import events_of, on_scope
from daq.files.disk import write_whole
from daq.files.json_values import json_object, json_values
from daq.pyramid import build_pyramid, has_pyramid, pyramid_key
from daq.recording import open_recording
from daq.recording.header import stored_id
from daq.recording.notebook import BY_HAND, EventChange, in_words, read_remarks, side_file
from daq.recording.opening import Tell
from daq.setup.errors import InputError
from kernels.arrays import Bools, Floats, Integers
from model.effects.registry import unit_of


def look(names: list[str], tell: Tell) -> dict[str, Any]:
    """Verdicts by file name, as the catalogue holds them; None for a file that holds none."""
    found: dict[str, Any] = {}
    for name in names:
        tell(name)
        try:
            loop = load_verdict(Path(name))
            found[name] = json_object(_verdict(loop)) if loop.verdict in VERDICTS else None
        except InputError:
            found[name] = None
    return found


def _verdict(loop: ClosedLoop) -> dict[str, Any]:
    """The recordings, the verdict in words, its errors in us, parameters of added effects and fitted calibrations."""
    names = [effect.name for effect in loop.selection.effects]
    others = len(loop.selection.ties) - 1
    words = short_verdict(loop.verdict) + (f": {', '.join(names)}" if names else "")
    quantities = []
    for effect in loop.selection.effects:
        for parameter, (value, low, high) in effect.parameters.items():
            sigma = (high - low) / (2.0 * Z95)
            quantities.append((effect.name, parameter, value, sigma if math.isfinite(sigma) else None))
    quantities += [(x.effect, x.parameter, x.value, x.sigma) for x in loop.selection.calibrations]
    return {
        "identities": [source.identity for source in loop.sources if source.identity],
        "verdict": loop.verdict,
        "summary": words + (f" (or {others} other sets)" if others > 0 else ""),
        "before_us": loop.errors.before.landing_rms_us,
        "after_us": loop.errors.after.landing_rms_us,
        "floor_us": loop.errors.landing_floor_us,
        "by_hand": [line for line in loop.notes if BY_HAND in line],
        "quantities": [
            quantity(f"{effect}.{parameter}", value, sigma, unit_of(effect, parameter), "verdict")
            for effect, parameter, value, sigma in quantities
            if math.isfinite(value)
        ],
    }


def evidence(loop: ClosedLoop, identity: str, gaps: Integers, rate_hz: float) -> dict[str, Any]:
    """Rivals, steps and flights (columns by take-off) of one recording in a closed loop; `InputError`: it is of others.

    ``identity`` (`daq.recording.header.stored_id`), ``gaps`` and ``rate_hz`` are of the recording; times are also given
    as its scope counts them.
    """
    own = [i for i, source in enumerate(loop.sources) if source.identity == identity]
    if not own or not identity:
        raise InputError(
            f"the closed loop of {', '.join(s.file for s in loop.sources)} holds no flight of this recording"
        )
    steps, flights = loop.steps, loop.flights
    here = np.flatnonzero(steps.recording[flights.step] == own[0])
    step, scored = flights.step[here], flights.scored[here]
    models = {"declared": flights.before, "improved": flights.after}
    columns: dict[str, Any] = {
        "step": steps.number[step],
        "scored": scored,
        "takeoff_s": flights.takeoff_s[here],
        "landing_s": flights.landing_s[here],
        "shown_s": on_scope(flights.takeoff_s[here], gaps, rate_hz),
    }
    for name, model in models.items():  # predicted times (s), residuals of both edges, the landing's uncertainty (us)
        columns |= {
            f"{name}_takeoff_s": model.takeoff_s[here],
            f"{name}_landing_s": model.landing_s[here],
            f"{name}_takeoff_us": 1e6 * model.takeoff_residual_s[here],
            f"{name}_us": 1e6 * model.landing_residual_s[here],
            f"{name}_sigma_us": 1e6 * model.landing_sigma_s[here],
        }
    return {
        "rivals": _rivals(loop),
        "steps": [
            {"step": int(steps.number[k]), "gamma": steps.gamma[k], "held_out": bool(steps.held_out[k]),
             "flights": int((mine := scored & (step == k)).sum()),
             **{f"{name}_us": _rms_us(columns[f"{name}_us"], mine) for name in models}}
            for k in np.flatnonzero(steps.recording == own[0])
        ],
        "flights": {name: np.round(x, 9) if x.dtype.kind == "f" else x for name, x in columns.items()},
    }  # fmt: skip


def _rivals(loop: ClosedLoop) -> list[dict[str, Any]]:
    """Each candidate of the first round with its gain (nats) and what became of it, the best first."""
    chosen, rejected = set(loop.selection.names), loop.selection.rejected
    ties = {names for names in loop.selection.ties if set(names) != chosen}
    rows: dict[tuple[str, ...], dict[str, Any]] = {
        one.names: {"gain": one.gain, "error": one.error, "outcome": "less good"} for one in loop.selection.candidates
    }
    for names in ties:
        rows.setdefault(names, {"gain": None, "error": None})["outcome"] = "the data cannot tell it from the best"
    if rejected is not None:
        rows[rejected.names] = {"gain": rejected.gain, "error": rejected.error, "outcome": rejected.reason}
    for names, row in rows.items():
        if set(names) <= chosen:
            row["outcome"] = "added"
    best = sorted(rows.items(), key=lambda item: -(item[1]["gain"] if item[1]["gain"] is not None else np.inf))
    return [{"names": list(names), **row} for names, row in best]


def _rms_us(residual_us: Floats, chosen: Bools) -> float | None:
    """Root mean square of those that are predicted, us; None where there is none."""
    known = residual_us[chosen & np.isfinite(residual_us)]
    return float(np.sqrt(np.mean(known**2))) if known.size else None


FLIGHTS_VERSION = 4


def make_pyramid(recording: Path, by_identity: Path | None, by_file: Path) -> Path:
    """Make a recording's pyramid where there is none yet: under its identity where it is whole, else the file's."""
    with open_recording(recording) as opened:
        target = by_file if by_identity is None or opened.is_less or opened.damage else by_identity
        if not has_pyramid(target, pyramid_key(opened)):
            build_pyramid(opened, target)
    return target


def make_flights(recording: Path, target: Path, changes: tuple[EventChange, ...]) -> Path:
    """Steps, flights and events as JSON in ``target``; no file where ``changes`` by hand became others meanwhile."""
    with open_recording(recording) as opened:
        flights, steps, rate_hz, gaps = flights_of(opened), opened.steps, opened.rate_hz, opened.gaps
        events = events_of(flights, gaps, opened.n_samples / rate_hz)
        stamps = [float(opened.timestamps_ns(k, k + 1)[0]) * 1e-9 for k in steps["first_sample"].tolist()]
    if flights.edges.by_hand not in (changes, ()):  # none: they are of another recording that had its name
        target.unlink(missing_ok=True)
        return target
    found = []
    classes = {own.step: own for own in classify(flights)}
    for k, step in enumerate(steps):
        plate = flights.plate.steps[k] if k < len(flights.plate.steps) else None
        own = classes.get(k)
        chosen = np.flatnonzero((flights.step == k) & flights.good() & ~flights.has(FlightFlag.DOUBLE_HIT))
        shown = chosen[:: -(-len(chosen) // 400)] if len(chosen) else chosen
        found.append({
            "step": k, "start_s": stamps[k], "length_s": float(step["n_samples"]) / rate_hz,
            "commanded": step["gamma"], "gamma": None if plate is None else plate.gamma,
            "gamma_uncertainty": None if plate is None else plate.gamma_uncertainty,
            "frequency_hz": step["frequency_hz"], "c": int(step["ratio"]),
            "motion": "-" if own is None else own.label, "flights": len(chosen),
            "double_hits": 0 if own is None else own.double_hits,
            "periods": np.round(flights.duration_s[shown] * step["frequency_hz"], 5).tolist(),
            "shown_s": np.round(on_scope(flights.takeoff_s[shown], gaps, rate_hz), 6).tolist(),
        })  # fmt: skip
    by_hand = {"changes": len(flights.edges.by_hand), "said": in_words(flights.edges.by_hand)}
    made = {"version": FLIGHTS_VERSION, "steps": found, "events": events, **by_hand}
    write_whole(target, json.dumps(json_values(made)))
    return target


def make_evidence(recording: Path, loop: Path, target: Path) -> Path:
    """What a saved closed loop says of a recording, flight by flight, as JSON in the file ``target``."""
    with open_recording(recording) as opened:
        found = evidence(load_verdict(loop), stored_id(opened), opened.gaps, opened.rate_hz)
    write_whole(target, json.dumps(json_values(found)))
    return target


class Workshop:
    """Makes pyramids and flights of one folder's runs, each once, there or, until `close`, in a temporary folder."""

    def __init__(self, folder: Path) -> None:
        self._lock = threading.Lock()
        self._jobs: dict[str, Future[Path]] = {}
        self._pool: ProcessPoolExecutor | None = None
        self._latest: dict[str, tuple[Path, dict[str, Any]]] = {}
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self.place = folder / PLACE / "made"
        try:
            self.place.mkdir(parents=True, exist_ok=True)
            probe(self.place)
        except OSError:
            self._temporary = tempfile.TemporaryDirectory(prefix="shakerbench-")
            self.place = Path(self._temporary.name)

    def close(self) -> None:
        """End the worker, and remove the temporary folder."""
        with self._lock:
            pool, self._pool = self._pool, None
        if pool is not None:
            for process in list((pool._processes or {}).values()):
                process.terminate()
            pool.shutdown(wait=True, cancel_futures=True)
        if self._temporary is not None:
            self._temporary.cleanup()

    def pyramid(self, row: Row, file: Path) -> Path | None:
        """The pyramid of a run; None while it is being made (raises InputError)."""
        by_file = self.place / f"{_file_key(file)}.pyramid"
        whole = row["identity"] and row["ended"] != "damaged"
        by_identity = self.place / f"{row['identity']}.pyramid" if whole else None
        return self._made(f"pyramid {by_file.name}", make_pyramid, file, by_identity, by_file)

    def flights(self, row: Row, file: Path) -> dict[str, Any] | None:
        """Steps of a run with their flights, and its events; None while they are being made (raises InputError)."""
        whole = row["identity"] and row["ended"] != "damaged"
        events = read_remarks(side_file(file)).events
        changed = f".{hashlib.sha256(repr(events).encode()).hexdigest()[:12]}" if events else ""
        target = self.place / f"{row['identity'] if whole else _file_key(file)}{changed}.flights.json"
        with contextlib.suppress(OSError, ValueError, KeyError):
            found = self._read("flights", target)
            if found["version"] == FLIGHTS_VERSION:
                return found
        if self._made(f"flights {target.name}", make_flights, file, target, events) is None:
            return None
        self._latest.pop("flights", None)  # of an earlier version
        return self._read("flights", target)

    def evidence(self, row: Row, file: Path, loop: Path) -> dict[str, Any] | None:
        """What a saved closed loop says of a run; None while it is being looked up (raises InputError)."""
        target = self.place / f"{row['identity']}.{_file_key(loop)}.why.json"
        made = target if target.exists() else self._made(f"why {target.name}", make_evidence, file, loop, target)
        return None if made is None else self._read("why", target)

    def _read(self, kind: str, target: Path) -> dict[str, Any]:
        """The JSON of a file; the last one of each kind stays in memory."""
        latest = self._latest.get(kind)
        if latest is None or latest[0] != target:
            latest = self._latest[kind] = target, json.loads(target.read_text(encoding="utf-8"))
        return latest[1]

    def _made(self, name: str, make: Any, *arguments: Any) -> Path | None:
        """The file that a job of that name has made; the job is begun at the first call."""
        with self._lock:
            job = self._jobs.get(name)
            if job is None:
                if self._pool is None:  # one worker, which gives way to a run where the system knows of that
                    lower = (os.nice, (10,)) if hasattr(os, "nice") else (None, ())
                    self._pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), *lower)
                job = self._jobs[name] = self._pool.submit(make, *arguments)
        if not job.done():
            return None
        try:
            path = job.result()
        except (InputError, OSError, MemoryError) as error:
            raise InputError(str(error) or type(error).__name__) from error
        except BrokenProcessPool as error:
            with self._lock:
                self._pool = None
                del self._jobs[name]
            raise InputError("the process that reads the recording has died of it; see bench verify") from error
        if not path.exists():  # removed since
            with self._lock:
                self._jobs.pop(name, None)
            return None
        return path


def _file_key(file: Path) -> str:
    """Hash of a file's place, size and time of change."""
    state = file.stat()
    return hashlib.sha256(f"{file}\0{state.st_size}\0{state.st_mtime_ns}".encode("utf-8", "replace")).hexdigest()[:32]
