"""An open recording: volts, codes, times and tables, of a closed file, a growing one or one cut off.

Samples are read when they are asked for, so memory does not depend on the length of the file. What is damaged is a gap.
`daq.recording.opening` opens files.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from daq.files.column_file import TABLES, read_table
from daq.files.disk import Closing, in_words, refuse_columns
from daq.files.frames.frame_file import FRAMES, FrameFile
from daq.files.frames.marked_frames import MarkedFrames
from daq.files.seal import text_crc
from daq.files.tables import BLOCK_DTYPE, BlockFlag, Holes
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from kernels.arrays import Floats, Integers

Spans = Sequence[tuple[int, int]]
ALL = (0, 1 << 62)
"""The samples of a channel that is lost as a whole."""


def timestamps_ns(start: int, stop: int, rate_hz: float, gaps: Integers) -> Integers:
    """Nanoseconds of samples ``start`` to ``stop``: nominal rate, jumping over ``gaps`` ``(n, 2)``."""
    index = np.arange(start, stop, dtype=np.int64)
    if len(gaps):
        lost = np.concatenate([[0], np.cumsum(gaps[:, 1])])
        index += lost[np.searchsorted(gaps[:, 0], index, side="right")]
    period_ns = 1e9 / rate_hz
    # whole nanoseconds need no rounding, as long as a float would hold them exactly
    if period_ns.is_integer() and stop * period_ns < 2.0**52:
        index *= int(period_ns)
        return index
    stamps: Integers = np.rint(index * period_ns).astype(np.int64)
    return stamps


def gaps_of(blocks: NDArray[np.void]) -> Integers:
    """Gaps declared in a block table, int64 ``(n, 2)``: first sample after the gap, samples lost."""
    lost = blocks[blocks["lost_before"] > 0]
    return np.stack([lost["first_sample"], lost["lost_before"]], axis=1).astype(np.int64)


class Recording(Closing):
    """An open recording; see `daq.recording.opening.open_recording`.

    Attributes
    ----------
    path, setup, rate_hz, n_samples
        File, setup of the measurement, samples a second, samples a channel.
    channels
        Names of the channels.
    steps, blocks
        `STEP_DTYPE` and `BLOCK_DTYPE` arrays.
    drive_changes
        `DRIVE_DTYPE` array: every change of the drive's amplitudes, from which the commanded samples follow bit for
        bit (`rig.programme`); empty in an imported recording.
    clock_readings, clock_map
        `CLOCK_DTYPE` and `MAP_DTYPE` arrays: where another clock played the drive, its readings and the map fitted to
        them (`daq.clocks.clock_sync`); else empty.
    notes
        `NOTE_DTYPE` array: the operator's notes during the run. ``side`` holds this table and the three before by name.
    gaps
        int64 ``(n, 2)``: first sample after the gap, samples lost.
    attrs
        Root attributes: note, simulated, backend, scenario_sha256, started, ended, why, extra (a dict), ...
    damage
        One line for each damage that was found; what it took is a gap, a channel less, or an empty table.
    """

    def __repr__(self) -> str:
        """File, channels, length and steps in a line."""
        seconds = self.n_samples / self.rate_hz
        return f"<Recording {self.path}: {', '.join(self.channels)}; {seconds:.3f} s, {len(self.steps)} steps>"

    def __init__(
        self, path: Path, file: Any, lost: Mapping[str, Spans] | None = None, damage: Sequence[str] = ()
    ) -> None:
        self.path = path
        self.damage = tuple(damage)
        self._file, self._lost = file, dict(lost or {})
        self._columns: dict[str, Any] = {}  # open datasets: each holds the chunks that it read last
        self._holes: Holes | None = None
        self.frames: FrameFile | MarkedFrames | None
        if isinstance(file, MarkedFrames):
            self.frames = file
        else:
            self.frames = FrameFile(file, path, without=tuple(self._lost)) if FRAMES in file else None
        self.stored: dict[str, Any] = {k: _plain(v) for k, v in file.attrs.items()}
        if self.frames is not None and "attributes_crc32" in self.stored and not attributes_intact(self.stored):
            self.frames.faults.append("the root attributes differ from what was written")
        self.stored |= self.frames.ending if self.frames is not None else {}
        self.attrs = dict(self.stored)
        self.attrs["extra"] = json.loads(self.attrs.pop("extra_json", "{}"))
        self.setup = Setup.model_validate_json(self.stored["setup_json"])
        self.rate_hz = float(self.stored["rate_hz"])
        if not 0.0 < self.rate_hz < np.inf:
            raise InputError(f"{path}: damaged: rate_hz is {self.rate_hz:g}; wanted samples a second")
        self.channels: tuple[str, ...] = tuple(map(str, self.stored["channels"]))
        if not all(name.isidentifier() for name in self.channels):
            raise InputError(f"{path}: damaged: channels called {self.channels}; wanted only letters, digits and _")
        self._scales: dict[str, list[float]]
        if self.frames is not None:
            self.n_samples = self.frames.n_samples
            if self.frames.lost:
                self._lost[FRAMES] = [*self._lost.get(FRAMES, ()), *self.frames.lost]
            self.steps, self.blocks, self.side = self.frames.steps, self.frames.blocks, self.frames.side
            self._scales = json.loads(self.stored["scales_json"])
        else:
            self._read_columns()
        self._leave_out()
        self.drive_changes = self.side["drive_changes"]
        self.clock_readings, self.clock_map = self.side["clock_readings"], self.side["clock_map"]
        self.notes = self.side["notes"]
        self.gaps = gaps_of(self.blocks)

    def _read_columns(self) -> None:
        """Tables and scales of a closed file."""
        file, path = self._file, self.path
        there = tuple(n for n in self.channels if not set(self._lost.get(n, ())) & {ALL})
        refuse_columns(file, (*there, "timestamp"), path)
        self.n_samples = int(file["timestamp"].shape[0])
        read = {
            name: read_table(file, name, dtype, path) if name not in self._lost else np.zeros(0, dtype)
            for name, dtype in TABLES.items()
        }
        self.steps, self.blocks = read.pop("steps"), read.pop("blocks")
        self.side = read
        if "blocks" in self._lost:
            # one block stands for all: the gaps are not known then, the samples are
            self.blocks = np.zeros(1, BLOCK_DTYPE)
            self.blocks["n_samples"] = self.n_samples
        self._scales = {n: [float(file[n].attrs["scale_factor"]), float(file[n].attrs["add_offset"])] for n in there}

    def _leave_out(self) -> None:
        """Make gaps of the samples that are lost; a channel of which none is left is not there."""
        # even times follow from rate and gaps: that they are damaged costs no sample
        none_left = {ALL, (0, self.n_samples)}
        self.channels = tuple(n for n in self.channels if not none_left & set(self._lost.get(n, ())))
        holding = {*self.channels, FRAMES} | (set() if self._even else {"timestamp"})
        spans = [(int(a), int(b)) for name in holding for a, b in self._lost.get(name, ())]
        if not spans:
            return
        self._holes = Holes.of(spans, self.n_samples)
        self.n_samples = self._holes.n_samples
        self.steps, self.blocks = self._holes.steps(self.steps), self._holes.blocks(self.blocks)

    def flag_blocks(self, which: Sequence[int], flag: BlockFlag) -> None:
        """Flag blocks of a frames file, by their numbers there."""
        if self.frames is not None:
            self.frames.blocks["flags"][which] |= int(flag)
            self.blocks = self.frames.blocks if self._holes is None else self._holes.blocks(self.frames.blocks)

    def stored_content(self) -> list[tuple[str, int, int]]:
        """Name, number of samples and CRC-32 of each channel, as a closed file stores them; empty of any other."""
        if self.frames is not None:
            return []
        n = self.n_samples if self._holes is None else int(self._file["timestamp"].shape[0])
        names = [str(name) for name in self.stored["channels"] if str(name) in self._file]
        return [(name, n, int(self._file[name].attrs.get("crc32", -1))) for name in names]

    @property
    def is_less(self) -> bool:
        """Whether something that had been recorded is left out, because it is damaged."""
        return bool(self._lost) or (self.frames is not None and bool(self.frames.faults))

    @property
    def _even(self) -> bool:
        """Whether the times follow from the rate and the gaps."""
        return bool(self.stored.get("uniform", True))

    def measure_with(self, setup: Setup) -> None:
        """Read volts by another profile's measuring part; rate and channels stay what the file has.

        Raises `InputError` when ``setup`` says nothing of a contact circuit that was recorded, or its c is not that of
        the steps.
        """
        if setup.channels.continuity is None and self.setup.channels.continuity is not None:
            raise InputError(
                f"{self.path}: has a contact circuit; wanted [channels.continuity] in profile {setup.name!r}"
            )
        ratios = set(self.steps["ratio"].tolist())
        if ratios and setup.forcing.ratio not in ratios:
            known = ", ".join(map(str, sorted(ratios)))
            raise InputError(
                f"{self.path}: its steps have c = {known}; profile {setup.name!r} says forcing.ratio = "
                f"{setup.forcing.ratio}; correct it, or import the file again"
            )
        channels = setup.channels
        # a profile cannot add a circuit that was not recorded
        if self.setup.channels.continuity is None:
            channels = channels.model_copy(update={"continuity": None})
        self.setup = setup.model_copy(update={"sampling": self.setup.sampling, "channels": channels})

    def scale(self, channel: str) -> tuple[float, float]:
        """``(volts_per_code, offset_v)`` of a channel."""
        factor, offset = self._scales[self._known(channel)]
        return factor, offset

    def codes(
        self, channel: str, start: int = 0, stop: int | None = None, out: NDArray[Any] | None = None
    ) -> NDArray[Any]:
        """Raw codes ``(stop - start,)`` of a channel, as stored (volts where the recording was imported).

        Parameters
        ----------
        channel, start, stop
            ``stop`` None is the end.
        out
            Array of the stored type to read into, at least as long; saves the allocation.
        """
        stop = self.n_samples if stop is None else min(stop, self.n_samples)
        if self._holes is None:
            return self._stored(channel, start, stop, out)
        pieces = [self._stored(channel, a, b) for a, b in self._holes.ranges(start, stop)]
        codes = np.concatenate(pieces) if pieces else self._stored(channel, 0, 0)
        if out is None:
            return codes
        out[: len(codes)] = codes
        return out[: len(codes)]

    def _stored(self, channel: str, start: int, stop: int, out: NDArray[Any] | None = None) -> NDArray[Any]:
        """Codes of samples ``start`` to ``stop`` of the file."""
        try:
            return self._read(self._known(channel), start, stop, out)
        except (OSError, RuntimeError) as error:
            raise InputError(
                f"{self.path}: damaged: {channel}, samples {start} to {stop - 1} do not read back ({in_words(error)}); "
                f"keep what is sound: bench recover {self.path}"
            ) from error

    def _read(self, channel: str, start: int, stop: int, out: NDArray[Any] | None) -> NDArray[Any]:
        if self.frames is not None:
            column = self.frames.rows(start, stop)[:, list(self.stored["channels"]).index(channel)]
            if out is None:
                return np.ascontiguousarray(column)
            out[: stop - start] = column
            return out[: stop - start]
        if channel not in self._columns:
            self._columns[channel] = self._file[channel]
        dataset = self._columns[channel]
        if out is None:
            out = np.empty(max(stop - start, 0), dataset.dtype)
        if stop > start:  # h5py's own selections cost as much as unpacking a chunk
            there = dataset.id.get_space()
            there.select_hyperslab((start,), (stop - start,))
            dataset.id.read(h5py.h5s.create_simple((stop - start,)), there, out[: stop - start])
        return out[: max(stop - start, 0)]

    def read_v(self, channel: str, start: int = 0, stop: int | None = None) -> Floats:
        """Volts ``(stop - start,)`` of a channel."""
        factor, offset = self.scale(channel)
        codes = self.codes(channel, start, stop)
        # an imported recording holds volts
        if factor == 1.0 and offset == 0.0:
            return codes.astype(np.float64, copy=False)
        volts: Floats = np.multiply(codes, factor, dtype=np.float64)
        if offset:
            volts += offset
        return volts

    def timestamps_ns(self, start: int = 0, stop: int | None = None) -> Integers:
        """Time of each sample since the first, int64 nanoseconds, gaps included."""
        stop = self.n_samples if stop is None else min(stop, self.n_samples)
        if self.frames is not None or (self._even and (self._holes is not None or "timestamp" in self._lost)):
            return timestamps_ns(start, stop, self.rate_hz, self.gaps)
        ranges = [(start, stop)] if self._holes is None else self._holes.ranges(start, stop)
        pieces = [np.asarray(self._file["timestamp"][a:b], np.int64) for a, b in ranges]
        return pieces[0] if len(pieces) == 1 else np.concatenate([np.zeros(0, np.int64), *pieces])

    def _known(self, channel: str) -> str:
        if channel not in self.channels:
            raise InputError(f"{self.path}: has no channel {channel!r}; it has {', '.join(self.channels)}.")
        return channel

    def close(self) -> None:
        """Close the file."""
        self._columns.clear()
        self._file.close()


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    return value.tolist() if isinstance(value, np.ndarray) else value


def attributes_intact(stored: Mapping[str, Any]) -> bool:
    """Whether the attributes of a column file are those that were written."""
    return "attributes_crc32" in stored and int(stored["attributes_crc32"]) == text_crc(stored)
