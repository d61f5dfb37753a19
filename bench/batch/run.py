"""A batch: every recording examined in a process of its own or on a cluster, its row kept before the next is awaited.

A batch that was interrupted goes on where it stopped: what has a row, from the same file with the same profile and
software, is not done again. What failed is tried again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.batch.examine import Row, examine
from daq.files.whole_file import Journal
from daq.setup.provenance import software_commit, software_version
from model.surveys.workers import outcomes

Told = Callable[[int, int, Path, Row], None]


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
        """What a row depends on: the file as it is now, what is done, the profile, and the software."""
        try:
            state = path.stat()
            file = [path.resolve().as_posix(), state.st_size, state.st_mtime_ns]
        except OSError:
            file = [path.as_posix()]
        text = "" if self.profile is None else self.profile.read_text(encoding="utf-8")
        made = [software_version(), software_commit()]
        return hashlib.sha256(repr([file, self.parts, text, made, self.anyway]).encode()).hexdigest()[:24]


def run_batch(
    batch: Batch, journal: Journal, *, workers: int = 1, cluster: str | None = None, told: Told | None = None
) -> list[Row]:
    """Rows of all recordings, in their order.

    Parameters
    ----------
    batch
        What to do.
    journal
        Rows of this and earlier batches; every new one is added at once.
    workers, cluster
        As of `model.surveys.workers.outcomes`; on a cluster the recordings need the same paths as here.
    told
        Called with the number done, the number of all, the recording and its row.
    """
    keys = {path: batch.key(path) for path in batch.recordings}
    done = {p: journal.rows[k] for p, k in keys.items() if k in journal.rows and not journal.rows[k]["failed"]}
    if told is not None:
        for i, (path, row) in enumerate(done.items(), start=1):
            told(i, len(keys), path, row)
    for path, row in _examined(batch, [p for p in keys if p not in done], workers, cluster):
        journal.add(keys[path], row)
        done[path] = row
        if told is not None:
            told(len(done), len(keys), path, row)
    return [{"recording": str(path), **done[path]} for path in batch.recordings]


def _examined(batch: Batch, todo: list[Path], workers: int, cluster: str | None) -> Iterator[tuple[Path, Row]]:
    """Rows as they come in; a worker that died is the reason in its recording's row."""
    here = None if batch.profile is None else batch.profile.resolve()
    tasks = ((path, (path.resolve(), batch.parts, here, batch.anyway)) for path in todo)
    for outcome in outcomes(examine, tasks, workers=workers, cluster=cluster):
        row = outcome.result
        yield outcome.key, row if row is not None else {"failed": str(outcome.error), "processor_s": None}
