"""A batch: every recording examined in a process of its own or on a cluster, its row stored before the next is awaited.

A batch that was interrupted goes on where it stopped: what has a row, from the same file with the same profile and
software, is not done again. What failed is tried again. At the end the rows become one table.
"""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import h5py

from bench.batch.examine import Row, examine
from daq.files.whole_file import Journal, whole
from daq.setup.errors import InputError
from daq.setup.provenance import software_commit, software_version
from model.surveys.workers import outcomes


def find_recordings(places: Sequence[Path]) -> tuple[list[Path], int]:
    """Recordings named, and those in the folders named and below; and how many other HDF5 files were there.

    Raises
    ------
    InputError
        For a place that does not exist, or where there is no recording at all.
    """
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
    """What is to be done with which recordings.

    Attributes
    ----------
    recordings
        Their paths, all different.
    parts
        Of `bench.batch.examine.PARTS`.
    profile
        Replaces the recordings' own.
    anyway
        Whether recordings that contradict their profile get a verdict, too.
    """

    recordings: Sequence[Path]
    parts: tuple[str, ...]
    profile: Path | None = None
    anyway: bool = False

    def key(self, path: Path) -> str:
        """Hash of what a row depends on: the file as it is now, what is done, the profile, and the software."""
        try:
            state = path.stat()
            file = [path.resolve().as_posix(), state.st_size, state.st_mtime_ns]
        except OSError:
            file = [path.as_posix()]
        text = "" if self.profile is None else self.profile.read_text(encoding="utf-8")
        made = [software_version(), software_commit()]
        return hashlib.sha256(repr([file, self.parts, text, made, self.anyway]).encode()).hexdigest()[:24]


def run_batch(
    batch: Batch, journal: Journal, *, workers: int = 1, cluster: str | None = None,
    say: Callable[[int, int, Path, Row], None] | None = None,
) -> list[Row]:  # fmt: skip
    """Rows of all recordings, in their order.

    Parameters
    ----------
    batch
        What to do.
    journal
        Rows of this and earlier batches; every new one is added at once.
    workers, cluster
        As of `model.surveys.workers.outcomes`; on a cluster the recordings need the same paths as here.
    say
        Called with the number done, the number of all, the recording and its row.
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
    """Write ``rows`` as Parquet or CSV, by the ending of ``path``; the common columns first, values of effects by name.

    Raises
    ------
    OSError
        When the disk refuses.
    """
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
