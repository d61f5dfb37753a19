"""Write a recording while a run lasts, and turn its frames into columns when it ends.

Acknowledged frames are never lost. They stay until the column file, which grows with them under another name, has been
written, read back and found right; one rename then puts it in their place. Decision 17.
"""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from daq.files.column_file import CHUNK_SAMPLES, FORMAT, FORMAT_VERSION, PIECE_CHUNKS, ColumnWriter
from daq.files.disk import Closing
from daq.files.frames.frame_file import FrameFile
from daq.files.frames.frame_writer import FrameWriter
from daq.files.seal import Checked
from daq.files.tables import Block, BlockFlag, volts_per_code
from daq.recording.opening import open_checked
from daq.recording.reader import Recording, gaps_of, timestamps_ns
from daq.setup.clock import SYSTEM, Clock, now_utc
from daq.setup.errors import InputError
from daq.setup.provenance import software_commit, software_version
from daq.setup.setup import Setup
from kernels.arrays import Integers

RESERVE_BYTES = 8_000_000
Ending = Literal["complete", "stopped", "failed"]


def root_attributes(
    setup: Setup,
    *,
    profile_text: str,
    backend: str,
    simulated: bool,
    note: str | None = None,
    extra: Mapping[str, Any] | None = None,
    scenario_sha256: str | None = None,
) -> dict[str, Any]:
    """Root attributes that every recording carries, whoever writes it; texts are empty where nothing is known.

    ``extra`` is anything JSON knows, ``scenario_sha256`` the hash of a hidden scenario.
    """
    return {
        "setup_json": setup.model_dump_json(),
        "profile_text": profile_text,
        "backend": backend,
        "simulated": simulated,
        "note": note or "",
        "extra_json": json.dumps(dict(extra or {})),
        "scenario_sha256": scenario_sha256 or "",
        "software_version": software_version(),
        "software_commit": software_commit(),
        "rate_hz": setup.sampling.rate_hz,
        "uniform": True,
        "recovered": False,
    }


class ClosedRun(Closing):
    """A context manager that closes a run which its owner did not close: an exception says why."""

    def close(self, how: Ending = "complete", why: str = "", *, expected_samples: int | None = None) -> None:
        """End the recording, once."""
        raise NotImplementedError

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.close("complete")
        else:
            self.close("stopped" if isinstance(error, KeyboardInterrupt) else "failed", repr(error))


class LiveColumns:
    """Columns written in addition to the frames while a run lasts, so that closing it has little left to do.

    They are a shortcut and no part of what makes a recording safe: the frames are written first and stay until the end.
    Where the columns meet anything unexpected (no room to spare, a disk that refuses, samples that are not those of the
    frames file) they are dropped, and closing writes them from the frames. ``begin`` makes the column file, when the
    first chunk is full: a short run has none. Decision 190.
    """

    def __init__(
        self, begin: Callable[[], ColumnWriter], channels: Sequence[str], rate_hz: float, expected_samples: int
    ) -> None:
        self._begin, self._channels, self._rate_hz, self._expected = begin, channels, rate_hz, expected_samples
        self._columns: ColumnWriter | None = None
        self._waiting: NDArray[np.int16] = np.empty((CHUNK_SAMPLES, len(channels)), np.int16)
        self._n_waiting = 0
        self._n_samples = 0
        self._gaps: list[tuple[int, int]] = []
        self._dropped = False

    def append(self, *blocks: Block) -> None:
        """Take blocks whose frames are safe; never raises for what the disk refuses."""
        for block in blocks:
            if block.lost_before > 0:
                self._gaps.append((block.first_sample, block.lost_before))
            rest = block.codes
            while len(rest) and not self._dropped:
                n = min(len(rest), CHUNK_SAMPLES - self._n_waiting)
                self._waiting[self._n_waiting : self._n_waiting + n] = rest[:n]
                self._n_waiting, rest = self._n_waiting + n, rest[n:]
                if self._n_waiting == CHUNK_SAMPLES:
                    self._write()

    def _write(self) -> None:
        """Hand what waits to the column file; drop that where it cannot be."""
        start, stop = self._n_samples, self._n_samples + self._n_waiting
        stamps = timestamps_ns(start, stop, self._rate_hz, self._gap_rows())
        try:
            if self._columns is None:
                self._columns = self._begin()
            spare = RESERVE_BYTES + 2 * len(self._channels) * max(self._expected - stop, 0)
            if shutil.disk_usage(self._columns.part.parent).free < spare:
                self.drop()  # what is more important needs the room
                return
            waiting = self._waiting[: self._n_waiting]
            self._columns.append(stamps, {name: waiting[:, i] for i, name in enumerate(self._channels)})
        except (OSError, RuntimeError, InputError):
            self.drop()
            return
        self._n_samples, self._n_waiting = stop, 0

    def _gap_rows(self) -> Integers:
        return np.array(self._gaps, np.int64).reshape(-1, 2)

    def drop(self) -> None:
        """Remove the unfinished file, if there is one and it can be; whatever comes is passed over."""
        self._dropped, self._n_waiting = True, 0
        columns, self._columns = self._columns, None
        if columns is not None:
            with contextlib.suppress(OSError, RuntimeError):  # a file that cannot be removed is written over at the end
                columns.abandon()

    def finish(self, recording: Recording, attributes: dict[str, Any]) -> ColumnWriter | None:
        """The column file of a run that has ended, whole and checked; None where the frames must be asked.

        ``recording`` is the closed frames file: its tables are taken, its samples must be those that came.
        """
        frames = recording.frames
        came = self._n_samples + self._n_waiting  # samples that the columns were given
        whole = frames is not None and not frames.faults and not frames.lost and frames.n_samples == came
        if self._columns is None or not whole or not np.array_equal(gaps_of(recording.blocks), self._gap_rows()):
            self.drop()
            return None
        self._write()
        columns = self._columns
        try:
            if columns is not None:
                columns.check(recording.steps, recording.blocks, recording.side, **attributes)
        except (OSError, RuntimeError):
            self.drop()
            return None
        self._columns = None
        return columns


class RecordingWriter(ClosedRun):
    """Record one run; raises `InputError` when ``path`` exists, its folder does not, or the disk is too full.

    Parameters
    ----------
    path
        File to create; refused when it exists.
    setup
        Its ``sampling.rate_hz`` is the recording's.
    profile_text
        The whole profile as its file says it.
    channels
        Names in the order of a block's columns.
    backend, simulated
        Name of the back end, and whether it is a simulation.
    note, extra
        The operator's note and free keys (anything JSON knows).
    scenario_sha256
        Hash of a hidden scenario.
    scales
        Channel name to ``(volts_per_code, offset_v)``; the default is the channel's range over 16 bits.
    expected_samples
        How long the run will be; refused where the disk has no room for it.
    clock
        The machine's, or that of a simulation.
    """

    def __init__(
        self,
        path: Path | str,
        setup: Setup,
        *,
        profile_text: str,
        channels: Sequence[str],
        backend: str,
        simulated: bool,
        note: str | None = None,
        extra: Mapping[str, Any] | None = None,
        scenario_sha256: str | None = None,
        scales: Mapping[str, tuple[float, float]] | None = None,
        expected_samples: int = 0,
        clock: Clock = SYSTEM,
    ) -> None:
        self.path = Path(path)
        self._clock = clock
        require_space(self.path, expected_samples, len(channels))
        attributes = root_attributes(
            setup, profile_text=profile_text, backend=backend, simulated=simulated, note=note, extra=extra,
            scenario_sha256=scenario_sha256,
        )  # fmt: skip
        described = {name: setup.channels.get(name) for name in channels}
        known = {name: (volts_per_code(c.range_v if c is not None else 10.0), 0.0) for name, c in described.items()}
        known |= {name: scale for name, scale in (scales or {}).items() if name in known}
        attributes |= {
            "channels": list(channels),
            "scales_json": json.dumps(known),
            "started": now_utc(clock),
            "format": FORMAT,
            "format_version": FORMAT_VERSION,
        }
        self._frames = FrameWriter(self.path, channels, attributes)

        dtypes = dict.fromkeys(channels, np.dtype("<i2"))
        begin = partial(ColumnWriter, self.path, setup, dtypes, known, attributes, overwrite=True)
        self._live = LiveColumns(begin, channels, setup.sampling.rate_hz, expected_samples)

    @property
    def is_open(self) -> bool:
        """Whether `close` was not called yet."""
        return self._frames.is_open

    @property
    def n_samples(self) -> int:
        """Frames recorded so far; the next block must start here."""
        return self._frames.n_samples

    def append(self, *blocks: Block) -> None:
        """Write blocks that follow each other; once this returns a killed process does not lose them.

        Raises `ValueError` when a block does not follow the one before, `OSError` when the disk refuses.
        """
        self._frames.append(*blocks)
        self._live.append(*blocks)

    def mark_step(self, step: np.void | Mapping[str, Any]) -> None:
        """Write a step's row (`STEP_DTYPE` or a mapping of its fields) and sync the file to the disk.

        A row with the same ``first_sample`` as the last one replaces it: mark a step when it begins, and again with
        what was achieved when it ends.
        """
        self._frames.mark_step(step)

    def mark_rows(self, table: str, rows: NDArray[np.void]) -> None:
        """Add rows to one of `daq.files.tables.SIDE_TABLES`, as the changes of the drive that were played."""
        self._frames.mark_rows(table, rows)

    def close(self, how: Ending = "complete", why: str = "", *, expected_samples: int | None = None) -> None:
        """End the recording: finish the column file, check it, rename it into place.

        Raises `OSError` when the column file cannot be written; the frames stay, and `bench recover` can finish the
        job.

        Parameters
        ----------
        how, why
            The reason is for a run that was not completed.
        expected_samples
            Samples that the device must have given (played, or clocked). The recording is marked as suspect where
            recorded and declared as lost do not add up to that, within the uncertainty of the gaps.
        """
        if not self.is_open:
            return
        where = self.path
        try:
            if not self._frames.is_broken:
                ending: dict[str, Any] = {"ended": how, "why": why, "ended_at": now_utc(self._clock)}
                if expected_samples is not None:
                    missing = expected_samples - self._frames.n_samples - self._frames.n_lost
                    suspect = abs(missing) > self._frames.n_doubtful
                    ending |= {"expected_samples": expected_samples, "suspect": suspect}
                try:
                    self._frames.end(ending)
                except OSError:
                    if not self._frames.has_vanished():
                        raise  # closing keeps what this process still holds of a file that was removed
            where = self._frames.close()
            if where != self.path:
                self._live.drop()
            columns_from_frames(where, self._live)
        except (OSError, RuntimeError) as error:
            self._live.drop()
            if not where.exists():
                raise OSError(
                    f"{where}: was removed while it was being written, and no copy of it could be made ({error})"
                ) from error
            raise OSError(
                f"{where}: the recorded frames are safe in this file, but the run could not be finished as columns "
                f"({error}); make room and run: bench recover {where}"
            ) from error
        if where != self.path:
            raise OSError(f"{self.path}: was removed while it was being written; all of the run is in {where}")


def require_space(path: Path, n_samples: int, n_channels: int) -> None:
    """Refuse to begin what the disk cannot hold: frames, the column file, and a reserve.

    Raises `InputError`, naming what is needed and what is free.
    """
    # two bytes a code in the frames and again in the columns, and eight of each time
    needed = n_samples * (4 * n_channels + 8) + RESERVE_BYTES
    if path.parent.is_dir() and shutil.disk_usage(path.parent).free < needed:
        free = shutil.disk_usage(path.parent).free
        raise InputError(
            f"{path}: the run needs up to {needed / 1e6:.0f} MB while it is recorded and closed, and {path.parent} has "
            f"{free / 1e6:.0f} MB free; make room or record elsewhere."
        )


def columns_of(recording: Recording, out: Path, attributes: Mapping[str, Any], **options: Any) -> ColumnWriter:
    """What an open recording holds as a column file, written and checked, but not yet under its name.

    ``attributes`` are root attributes; options as of `ColumnWriter`. Raises `InputError` when ``out`` exists and may
    not be replaced, `OSError` when the disk refuses.
    """
    names, piece = recording.channels, PIECE_CHUNKS * CHUNK_SAMPLES
    dtypes = {name: recording.codes(name, 0, 1).dtype for name in names}
    scales = {name: recording.scale(name) for name in names}
    writer = ColumnWriter(out, recording.setup, dtypes, scales, attributes, **options)
    try:
        for a in range(0, recording.n_samples, piece):
            b = min(a + piece, recording.n_samples)
            writer.append(recording.timestamps_ns(a, b), {name: recording.codes(name, a, b) for name in names})
        writer.check(recording.steps, recording.blocks, recording.side)
    # an interrupt as well: half a file must not stay
    except BaseException:
        writer.abandon()
        raise
    return writer


def columns_from_frames(source: Path, live: LiveColumns) -> None:
    """Write the column file of a frames file in its place; blocks whose checksum does not fit are flagged, and stay.

    ``live`` are the columns that were written while the run lasted.
    """
    with open_checked(source, Checked()) as recording:
        writer = live.finish(recording, dict(recording.stored))
        if writer is None:
            if isinstance(frames := recording.frames, FrameFile):
                recording.flag_blocks(frames.damaged(PIECE_CHUNKS * CHUNK_SAMPLES), BlockFlag.DAMAGED)
            writer = columns_of(recording, source, recording.stored, overwrite=True)
    writer.rename()  # once the frames are closed: Windows replaces no open file
