"""Many parameter points on many cores: a job, cut into chunks, flown by a pool of processes or a cluster, into HDF5.

A chunk is computed from the job and its bounds, so it can run anywhere and in any order; the
file is written by one process, and a file left unfinished is continued where it stopped.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from kernels.arrays import Bools, Floats
from kernels.errors import InputError
from model.effects.registry import resolve
from model.flight.windows import MOST_WINDOWS, largest_gamma
from model.orbits.attractor import Ball, attractor
from model.orbits.make_ball import EXACT, law_of, make_ball
from model.surveys.diagram import FIELDS, KEEP, KINDS, Rows, empty_rows, exact_rows, rows_of, swept
from model.surveys.workers import outcomes
from model.tones import STANDARD_GRAVITY_MPS2, Forcing

CHUNK = 4000  # points: a fraction of a second of an exact ball
USUAL_WINDOWS = 1000  # of a flight, in parts of `model.flight.windows.MOST_WINDOWS`: full chunks up to there
MOST_POINTS = 100_000_000
"""Points of a job: half a kilobyte each."""

Progress = Callable[[int, int], None]
"""Called with the points done and all points."""


@dataclass(frozen=True)
class Axis:
    """One parameter of the grid besides gamma: ``effect.parameter`` and its values."""

    name: str
    values: tuple[float, ...]


@dataclass(frozen=True)
class Job:
    """A grid of parameter points: every gamma for every combination of the axes; gamma runs fastest."""

    ratio: int  # c
    gammas: tuple[float, ...]  # in the order of a sweep, where there is one
    phase_rad: float = 0.0  # of the second tone
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)  # fixed
    axes: tuple[Axis, ...] = ()  # varied
    frequency_hz: float | None = None  # needed by effects with a scale of their own
    g_mps2: float = STANDARD_GRAVITY_MPS2  # the same
    sweep: bool = False  # whether the state is carried along the gammas; then a chunk is a whole row of gammas
    keep: int = KEEP  # flight times stored of each point

    @property
    def forcing(self) -> Forcing:
        """The plate's motion but for its amplitude."""
        return Forcing.superposition(self.ratio, phase_rad=(0.0, self.phase_rad))

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the grid: the axes, then gamma."""
        return (*(len(a.values) for a in self.axes), len(self.gammas))

    @property
    def size(self) -> int:
        """Points."""
        return math.prod(self.shape)

    def columns(self, start: int, stop: int) -> dict[str, Floats]:
        """The parameters of points ``start .. stop - 1`` by name, gamma included."""
        places = np.unravel_index(np.arange(start, stop), self.shape)
        named = {a.name: np.asarray(a.values)[p] for a, p in zip(self.axes, places[:-1], strict=True)}
        return {**named, "gamma": np.asarray(self.gammas)[places[-1]]}

    def effects_at(self, columns: Mapping[str, Floats], i: int) -> dict[str, dict[str, float]]:
        """All effects of point ``i`` of ``columns``."""
        table = {name: dict(values) for name, values in self.effects.items()}
        for axis in self.axes:
            effect, _, parameter = axis.name.partition(".")
            table.setdefault(effect, {})[parameter] = float(columns[axis.name][i])
        return table

    @property
    def exact(self) -> bool:
        """Whether the compiled kernels fly every point of it."""
        return {a.name.partition(".")[0] for a in self.axes} | set(self.effects) <= EXACT

    def ball(self, effects: Mapping[str, Mapping[str, float]]) -> Ball:
        """The ball with ``effects`` on this job's plate."""
        return make_ball(self.forcing, effects, frequency_hz=self.frequency_hz, g_mps2=self.g_mps2)


def check(job: Job) -> None:
    """Refuse a job that a worker could not compute.

    Raises `InputError` for an unknown effect or parameter, a value out of bounds or a missing frequency, at any point
    of the axes.
    """
    if job.size == 0:
        raise InputError("a job needs at least one gamma and one value of every axis")
    if job.size > MOST_POINTS:
        raise InputError(f"a diagram has at most {MOST_POINTS:,} points (half a kilobyte each), not {job.size:,}")
    # every value of every axis once: the whole grid would be as long as the job
    lengths = [len(a.values) for a in job.axes]
    for which in range(max(lengths, default=1)):
        columns = {a.name: np.array([a.values[min(which, len(a.values) - 1)]]) for a in job.axes}
        job.ball(job.effects_at(columns, 0))


def compute(job: Job, start: int, stop: int) -> Rows:
    """The attractors of points ``start .. stop - 1``."""
    columns = job.columns(start, stop)
    gammas = columns["gamma"]
    if job.sweep:
        return swept(job.ball(job.effects_at(columns, 0)), gammas, keep=job.keep)
    if job.exact:
        laws = None
        if job.axes or job.effects:
            first = np.flatnonzero(np.arange(start, stop) % len(job.gammas) == 0)  # where the axes' values change
            starts = np.unique([0, *first])
            each = [law_of(resolve(job.effects_at(columns, int(i))), job.frequency_hz, job.g_mps2) for i in starts]
            laws = np.repeat(each, np.diff([*starts, gammas.size]), axis=0)
        return exact_rows(job.forcing, gammas, laws, lambda i: job.ball(job.effects_at(columns, i)), job.keep)
    balls = (job.ball(job.effects_at(columns, i)) for i in range(gammas.size))
    return rows_of(gammas, map(attractor, balls, gammas.tolist()), job.keep)


def run(
    job: Job,
    path: Path,
    *,
    workers: int = 1,
    cluster: str | None = None,
    chunk: int = CHUNK,
    progress: Progress | None = None,
) -> None:
    """Fly all points of ``job`` into the HDF5 file ``path``; a file begun by the same job is continued.

    ``workers`` and ``cluster`` are as of `model.surveys.workers.outcomes`. Raises `InputError` for a job that cannot be
    computed, or a file that belongs to another job.
    """
    check(job)
    # fewer points where flights are long: between chunks progress is shown and a stop is possible
    windows = max(job.gammas, default=0.0) / largest_gamma(job.forcing) * MOST_WINDOWS
    chunk = min(chunk, max(1, min(CHUNK, int(CHUNK * USUAL_WINDOWS / max(windows, USUAL_WINDOWS)))))
    chunk = len(job.gammas) if job.sweep else chunk  # the state is carried along a row of gammas
    with _open(job, path, chunk) as file:
        done: Bools = file["chunk_done"][:]
        todo = [(i * chunk, min((i + 1) * chunk, job.size)) for i in np.flatnonzero(~done).tolist()]
        finished = job.size - sum(stop - start for start, stop in todo)
        # a worker is sent a job as small as can be
        pieces = (
            ((a, b), (job, a, b) if job.axes else (replace(job, gammas=job.gammas[a:b]), 0, b - a)) for a, b in todo
        )
        for outcome in outcomes(compute, pieces, workers=workers, cluster=cluster):
            (start, stop), rows = outcome.key, outcome.value()
            for name in FIELDS[1:]:
                file[name][start:stop] = getattr(rows, name)
            for name, values in job.columns(start, stop).items():
                file[name][start:stop] = values
            file["chunk_done"][start // chunk] = True
            file.flush()
            finished += stop - start
            if progress is not None:
                progress(finished, job.size)


@contextmanager
def _open(job: Job, path: Path, chunk: int) -> Iterator[h5py.File]:
    description = json.dumps({**asdict(job), "chunk": chunk}, sort_keys=True)
    fresh = not path.exists()
    try:
        opened = h5py.File(path, "a")
    except OSError as error:
        wanted = "a diagram written by bench predict --out (HDF5), to be continued" if path.is_file() else "a new file"
        # the operating system's reason, or HDF5's first words, without its inner ones
        own = os.strerror(error.errno) if error.errno else str(error).partition("(")[2].partition(")")[0]
        raise InputError(f"{path}: wanted {wanted}; {own or error}; give another --out") from error
    with opened as file:
        if fresh:
            file.attrs["job"] = description
            file.attrs["kinds"] = list(KINDS)
            file.attrs["shape"] = job.shape
            sample = empty_rows(np.zeros(1), job.keep)
            columns = dict.fromkeys(["gamma", *(a.name for a in job.axes)], np.dtype(np.float64))
            for name, dtype in {**columns, **{n: getattr(sample, n).dtype for n in FIELDS[1:]}}.items():
                wide = (job.keep,) if name == "tau" else ()
                file.create_dataset(
                    name, (job.size, *wide), dtype, chunks=(min(chunk, job.size), *wide), compression="lzf"
                )
            file.create_dataset("chunk_done", data=np.zeros(-(-job.size // chunk), dtype=bool))
        elif file.attrs.get("job") != description:
            raise InputError(f"{path} holds the results of another job: give another --out, or remove it")
        yield file


def save(job: Job, rows: Rows, path: Path) -> None:
    """Write rows that were computed elsewhere (an adaptive diagram) as `run` writes its own.

    Raises `InputError` if ``path`` exists.
    """
    if path.exists():
        raise InputError(f"{path} exists: give another --out, or remove it")
    whole = replace(job, gammas=tuple(rows.gamma.tolist()))
    with _open(whole, path, whole.size) as file:
        for name in FIELDS:
            file[name][:] = getattr(rows, name)
        file["chunk_done"][:] = True


def load(path: Path) -> tuple[Rows, dict[str, Any]]:
    """All finished rows of a file written by `run`, and its attributes.

    Raises `InputError` if the file is not one written by `run`.
    """
    with h5py.File(path, "r") as file:
        if "chunk_done" not in file:
            raise InputError(f"{path} is not a diagram written by bench predict --out")
        attributes = dict(file.attrs)
        rows = Rows(*(file[name][:] for name in FIELDS))
        done = np.repeat(file["chunk_done"][:], file["gamma"].chunks[0])[: rows.gamma.size]
    return Rows(*(getattr(rows, name)[done] for name in FIELDS)), attributes
