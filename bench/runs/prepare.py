"""Data of a run's page that take time to make: extremes for its scope, flights for its diagram; cached on disk.

Made by a process of its own, so that the pages answer meanwhile.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import multiprocessing
import os
import tempfile
import threading
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import numpy as np

from bench.runs.events import events_of
from bench.runs.folder import PLACE
from bench.runs.query import Row
from daq.files.json_values import json_values
from daq.files.whole_file import write_whole
from daq.pyramid.build import build_pyramid, has_pyramid, pyramid_key
from daq.recording import open_recording
from daq.recording.notebook import read_remarks, side_file
from daq.setup.errors import InputError

FLIGHTS_VERSION = 2


def make_pyramid(recording: Path, by_identity: Path | None, by_file: Path) -> Path:
    """Make the pyramid of a recording, where there is none yet, and give its place.

    Parameters
    ----------
    recording
        Its file.
    by_identity
        Place under the recording's identity; None where it has none.
    by_file
        Place under the file's size and time of change, for a recording that is not whole.
    """
    with open_recording(recording) as opened:
        target = by_file if by_identity is None or opened.is_less or opened.damage else by_identity
        if not has_pyramid(target, pyramid_key(opened)):
            build_pyramid(opened, target)
    return target


def make_flights(recording: Path, target: Path) -> Path:
    """Steps, flights and events of a recording as JSON in the file ``target``."""
    from analysis.flights.assemble import flights_of
    from analysis.flights.classify import classify
    from analysis.flights.table import FlightFlag

    with open_recording(recording) as opened:
        flights, steps, rate_hz = flights_of(opened), opened.steps, opened.rate_hz
        events = events_of(flights, opened.gaps, opened.n_samples / rate_hz)
        stamps = [float(opened.timestamps_ns(k, k + 1)[0]) * 1e-9 for k in steps["first_sample"].tolist()]
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
        })  # fmt: skip
    write_whole(target, json.dumps(json_values({"version": FLIGHTS_VERSION, "steps": found, "events": events})))
    return target


class Workshop:
    """Makes pyramids and flights of the runs of one folder, each once.

    Parameters
    ----------
    folder
        The runs' folder; where nothing can be written in it, a temporary one is used until `close`.
    """

    def __init__(self, folder: Path) -> None:
        self._lock = threading.Lock()
        self._jobs: dict[str, Future[Path]] = {}
        self._pool: ProcessPoolExecutor | None = None
        self._latest: tuple[Path, dict[str, Any]] | None = None
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self.place = folder / PLACE / "made"
        try:
            self.place.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.place):
                pass
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
        """The pyramid of a run; None while it is being made.

        Raises
        ------
        InputError
            Where it cannot be made.
        """
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
        latest = self._latest
        if latest is not None and latest[0] == target:
            return latest[1]
        with contextlib.suppress(OSError, ValueError, KeyError):
            found: dict[str, Any] = json.loads(target.read_text(encoding="utf-8"))
            if found["version"] == FLIGHTS_VERSION:
                self._latest = target, found
                return found
        if self._made(f"flights {target.name}", make_flights, file, target) is None:
            return None
        return self.flights(row, file) if target.exists() else {"steps": [], "events": {}}

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
        except (InputError, ValueError, OSError, MemoryError) as error:
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
