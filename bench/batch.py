"""A batch: recordings examined each in a process of its own or on a cluster, a row each, and one table at the end.

A row says what a recording is, its flights, how the model fares, and the verdict of the closed loop; numbers are as the
single commands `reprocess`, `compare` and `close-loop` give them. A recording that cannot be read gives a row with the
reason; it stops nothing. A row is stored before the next is awaited: a batch that was interrupted goes on where it
stopped, and what has a row, from the same file with the same profile and software, is not done again. What failed is
tried again.
"""

from __future__ import annotations

import csv
import hashlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from bench.profiles.find import load_measuring
from daq.files.disk import Journal, whole
from daq.files.json_values import json_object
from daq.recording import Recording, open_recording
from daq.recording.notebook import state_of
from daq.setup.errors import InputError
from daq.setup.provenance import software_commit, software_version
from daq.setup.setup import Setup
from model.surveys.workers import outcomes

Row = dict[str, Any]

PARTS = ("reprocess", "compare", "close-loop")


def examine(path: Path, parts: tuple[str, ...], profile: Path | None = None, anyway: bool = False) -> Row:
    """The row of one recording: text, numbers or None by column; ``failed`` is why something is missing, else None."""
    began = time.process_time()
    row: Row = {"failed": None}
    try:
        setup = None if profile is None else load_measuring(profile)[0]
        with open_recording(path) as opened:
            if setup is not None:
                opened.measure_with(setup)
            for found in _measured(opened, parts):  # what was found before a failure stays
                row |= found
        if "close-loop" in parts:
            row |= _verdict(path, setup, anyway=anyway)
    except (ValueError, OSError, ArithmeticError) as error:
        row["failed"] = f"{type(error).__name__}: {error}" if not isinstance(error, InputError) else str(error)
    return json_object(row) | {"processor_s": time.process_time() - began}


def _measured(opened: Recording, parts: tuple[str, ...]) -> Iterator[Row]:
    """Columns about the recording, its flights, and the distance of the declared model from them."""
    from analysis.flights.assemble import flights_of
    from analysis.flights.compare import compare
    from analysis.flights.table import FlightFlag

    forcing, attrs = opened.setup.forcing, opened.attrs
    yield {
        "started": attrs.get("started"),
        "profile": opened.setup.name,
        "simulated": bool(attrs.get("simulated")),
        "ended": attrs.get("ended"),
        "frequency_hz": forcing.frequency_hz,
        "tone_ratio": forcing.ratio,
        "rate_hz": opened.rate_hz,
        "seconds": opened.n_samples / opened.rate_hz,
        "lost_samples": int(opened.gaps[:, 1].sum()),
        "steps": len(opened.steps),
        "damage": "; ".join(opened.damage) or None,
    }
    if not {"reprocess", "compare"} & set(parts):
        return
    table = flights_of(opened)
    gammas = np.array([p.gamma for p in table.plate.steps if p is not None])
    gammas = gammas[np.isfinite(gammas)]
    yield {
        "flights": int((~table.has(FlightFlag.FALSE)).sum()),
        "gamma_low": gammas.min(initial=np.inf),  # infinite, and then unknown, where no step could be fitted
        "gamma_high": gammas.max(initial=-np.inf),
        "accelerometer_noise_mps2": table.plate.noise_mps2,
    }
    if "compare" in parts and "continuity" in opened.channels:
        held = compare(table, opened.setup, steps_table=opened.steps)
        yield {
            "flights_short_by": held.short_by,
            "double_hits": held.double_hits,
            "first_bifurcation_over_predicted": held.first.ratio,
        }


def _verdict(path: Path, setup: Setup | None, *, anyway: bool) -> Row:
    """The verdict of the closed loop, saved next to the recording; values of what it names with their intervals."""
    from analysis.loop.close_loop import close_loop
    from bench.jobs.loops import keep_verdict

    loop = close_loop([path], setup=setup, anyway=anyway)
    row: Row = {
        "verdict": loop.verdict,
        "effects": " + ".join(loop.selection.names),
        "tie_set": "; ".join(" + ".join(names) for names in loop.selection.ties),
        "landing_rms_before_us": loop.errors.before.landing_rms_us,
        "landing_rms_after_us": loop.errors.after.landing_rms_us,
        "noise_floor_us": loop.errors.landing_floor_us,
        "term": None if loop.discovered is None else f"{loop.discovered.term} of {loop.discovered.covariate.words}",
    }
    for added in loop.selection.effects:
        for name, (value, low, high) in added.parameters.items():
            column = f"{added.name}.{name}"
            row |= {column: value, f"{column}.low": low, f"{column}.high": high}
    for scale in loop.selection.calibrations:
        row[f"calibration.{scale.effect}.{scale.parameter}"] = scale.value
    return row | {"verdict_not_kept": keep_verdict(loop, [path]) or None}


def find_recordings(places: Sequence[Path]) -> tuple[list[Path], int]:
    """Recordings named, or in folders named and below (`InputError`: none); how many other HDF5 files were there."""
    found: dict[Path, Path] = {}
    others = 0
    for place in places:
        if not place.exists():
            raise InputError(f"{place}: wanted a recording or a folder of them, there is no such file")
        if not place.is_dir():
            found.setdefault(place.resolve(), place)
            continue
        for path in sorted(p for p in place.rglob("*") if p.suffix.lower() in (".h5", ".hdf5") and p.is_file()):
            try:
                with h5py.File(path, "r") as file:
                    may_be_recording = "setup_json" in file.attrs
            except OSError:
                may_be_recording = True  # too damaged to tell: its row gives the reason
            if may_be_recording:
                found.setdefault(path.resolve(), path)
            else:
                others += 1
    if not found:
        raise InputError(f"{', '.join(map(str, places))}: wanted recordings (HDF5), found none")
    return list(found.values()), others


@dataclass(frozen=True)
class Batch:
    """What is to be done with which recordings."""

    recordings: Sequence[Path]  # their paths, all different
    parts: tuple[str, ...]  # of `bench.batch.PARTS`.
    profile: Path | None = None  # replaces the recordings' own
    anyway: bool = False  # whether recordings that contradict their profile get a verdict, too

    def key(self, path: Path) -> str:
        """Hash of what a row depends on: file and events as they are now, what is done, profile and software."""
        try:
            file = state_of(path)
        except (OSError, InputError):
            file = [path.as_posix()]
        text = "" if self.profile is None else self.profile.read_text(encoding="utf-8")
        made = [software_version(), software_commit()]
        return hashlib.sha256(repr([file, self.parts, text, made, self.anyway]).encode()).hexdigest()[:24]


def run_batch(
    batch: Batch, journal: Journal, *, workers: int = 1, cluster: str | None = None,
    say: Callable[[int, int, Path, Row], None] | None = None,
) -> list[Row]:  # fmt: skip
    """Rows of all recordings, in their order.

    Every new row is added to ``journal`` at once, where those of earlier batches are. ``workers`` and ``cluster`` are
    as of `model.surveys.workers.outcomes`; on a cluster the recordings need the same paths as here. ``say`` is called
    with the number done, the number of all, the recording and its row.
    """
    keys = {path: batch.key(path) for path in batch.recordings}
    done: dict[Path, Row] = {}

    def finish(path: Path, row: Row) -> None:
        done[path] = row
        if say is not None:
            say(len(done), len(keys), path, row)

    for path, key in keys.items():
        if key in journal.rows and not journal.rows[key]["failed"]:
            finish(path, journal.rows[key])
    profile = None if batch.profile is None else batch.profile.resolve()
    tasks = [(path, (path.resolve(), batch.parts, profile, batch.anyway)) for path in keys if path not in done]
    for outcome in outcomes(examine, iter(tasks), workers=workers, cluster=cluster):
        path = outcome.key
        # a worker that died is the reason in its recording's row
        row = outcome.result or {"failed": str(outcome.error), "processor_s": None}
        journal.add(keys[path], row)
        finish(path, row)
    return [{"recording": str(path), **done[path]} for path in batch.recordings]


def write_table(rows: Sequence[Row], path: Path) -> None:
    """Write ``rows`` as Parquet or CSV, by the ending of ``path``; the common columns before those of effects."""
    found = dict.fromkeys(name for row in rows for name in row)
    names = [n for n in found if "." not in n] + sorted(n for n in found if "." in n)
    with whole(path) as part:
        if path.suffix.lower() != ".parquet":
            with part.open("w", newline="", encoding="utf-8") as stream:
                writer = csv.DictWriter(stream, names, restval="")
                writer.writeheader()
                writer.writerows(rows)
            return
        from pyarrow import Table, parquet

        parquet.write_table(Table.from_pydict({n: [row.get(n) for row in rows] for n in names}), part)
