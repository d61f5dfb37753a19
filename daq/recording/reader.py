"""Read a recording: volts, codes, times and tables, from a closed file, a growing one or one that was cut off.

The rule kept here: nothing is read that was not asked for, so memory does not depend on the length of the file.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import h5py
import hdf5plugin  # noqa: F401 (registers bitshuffle-LZ4 with HDF5)
import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from daq.recording.column_file import FORMAT, FORMAT_VERSION, read_table, text_crc
from daq.recording.frame_file import FRAMES, FrameFile, is_being_written
from daq.recording.tables import BLOCK_DTYPE, SIDE_TABLES, STEP_DTYPE
from daq.setup.errors import InputError
from daq.setup.setup import Setup


def timestamps_ns(start: int, stop: int, rate_hz: float, gaps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Nanoseconds of samples ``start`` to ``stop``: nominal rate, jumping over ``gaps`` ``(n, 2)``."""
    index = np.arange(start, stop, dtype=np.int64)
    if len(gaps):
        lost = np.concatenate([[0], np.cumsum(gaps[:, 1])])
        index += lost[np.searchsorted(gaps[:, 0], index, side="right")]
    stamps: NDArray[np.int64] = np.rint(index * (1e9 / rate_hz)).astype(np.int64)
    return stamps


def gaps_of(blocks: NDArray[np.void]) -> NDArray[np.int64]:
    """Gaps declared in a block table, int64 ``(n, 2)``: first sample after the gap, samples lost."""
    lost = blocks[blocks["lost_before"] > 0]
    return np.stack([lost["first_sample"], lost["lost_before"]], axis=1).astype(np.int64)


class Recording:
    """An open recording; see `open_recording`.

    Attributes
    ----------
    path, setup, rate_hz, n_samples
        Where it is, what was measured with what, samples a second, samples a channel.
    channels
        Names of the channels.
    steps, blocks
        `STEP_DTYPE` and `BLOCK_DTYPE` arrays.
    drive_changes
        `DRIVE_DTYPE` array: every change of the drive's amplitudes, from which the commanded samples follow bit for
        bit (`rig.programme.sequencer.commanded`); empty in an imported recording.
    clock_readings, clock_map
        `CLOCK_DTYPE` and `MAP_DTYPE` arrays: where another clock played the drive, what was read of it and the map
        fitted to that (`daq.clocks.clock_sync`); else empty. ``side`` holds these tables and the one before by name.
    gaps
        int64 ``(n, 2)``: first sample after the gap, samples lost.
    attrs
        Root attributes: note, simulated, backend, scenario_sha256, started, ended, why, extra (a dict), ...
    """

    def __init__(self, path: Path, file: Any) -> None:
        self.path = path
        self._file = file
        self.frames = FrameFile(file) if FRAMES in file else None
        self.stored: dict[str, Any] = {k: _plain(v) for k, v in file.attrs.items()}
        self.stored |= self.frames.ending if self.frames is not None else {}
        self.attrs = dict(self.stored)
        self.attrs["extra"] = json.loads(self.attrs.pop("extra_json", "{}"))
        self.setup = Setup.model_validate_json(self.stored["setup_json"])
        self.rate_hz = float(self.stored["rate_hz"])
        self.channels: tuple[str, ...] = tuple(self.stored["channels"])
        self._scales: dict[str, list[float]]
        if self.frames is not None:
            self.n_samples = self.frames.n_samples
            self.steps, self.blocks, self.side = self.frames.steps, self.frames.blocks, self.frames.side
            self._scales = json.loads(self.stored["scales_json"])
        else:
            self.n_samples = int(file["timestamp"].shape[0])
            self.steps, self.blocks = read_table(file["steps"], STEP_DTYPE), read_table(file["blocks"], BLOCK_DTYPE)
            self.side = {name: read_table(file.get(name, {}), dtype) for name, dtype in SIDE_TABLES.items()}
            self._scales = {
                n: [float(file[n].attrs["scale_factor"]), float(file[n].attrs["add_offset"])] for n in self.channels
            }
        self.drive_changes = self.side["drive_changes"]
        self.clock_readings, self.clock_map = self.side["clock_readings"], self.side["clock_map"]
        self.gaps = gaps_of(self.blocks)

    def measure_with(self, setup: Setup) -> None:
        """Read volts by another profile's measuring part; rate and channels stay what the file has.

        Raises
        ------
        InputError
            When ``setup`` says nothing of a contact circuit that was recorded, or its c is not that of the steps.
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
            Which samples; ``stop`` None is the end.
        out
            Array of the stored type to read into, at least as long; saves the allocation.
        """
        stop = self.n_samples if stop is None else min(stop, self.n_samples)
        if self.frames is not None:
            column = self.frames.rows(start, stop)[:, self.channels.index(self._known(channel))]
            if out is None:
                return np.ascontiguousarray(column)
            out[: stop - start] = column
            return out[: stop - start]
        dataset = self._file[self._known(channel)]
        if out is None:
            out = np.empty(stop - start, dataset.dtype)
        if stop > start:
            dataset.read_direct(out, np.s_[start:stop], np.s_[: stop - start])
        return out[: stop - start]

    def read_v(self, channel: str, start: int = 0, stop: int | None = None) -> NDArray[np.float64]:
        """Volts ``(stop - start,)`` of a channel."""
        factor, offset = self.scale(channel)
        codes = self.codes(channel, start, stop)
        if factor == 1.0 and offset == 0.0:
            return codes.astype(np.float64, copy=False)
        volts: NDArray[np.float64] = np.multiply(codes, factor, dtype=np.float64)
        if offset:
            volts += offset
        return volts

    def timestamps_ns(self, start: int = 0, stop: int | None = None) -> NDArray[np.int64]:
        """Time of each sample since the first, int64 nanoseconds, gaps included."""
        stop = self.n_samples if stop is None else min(stop, self.n_samples)
        if self.frames is not None:
            return timestamps_ns(start, stop, self.rate_hz, self.gaps)
        return np.asarray(self._file["timestamp"][start:stop], np.int64)

    def _known(self, channel: str) -> str:
        if channel not in self.channels:
            raise InputError(f"{self.path}: has no channel {channel!r}; it has {', '.join(self.channels)}.")
        return channel

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    return value.tolist() if isinstance(value, np.ndarray) else value


def open_file(path: Path) -> Any:
    """Open the HDF5 file, also one that is being recorded or was cut off.

    Raises
    ------
    InputError
        When it is missing or no HDF5 file.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file.")
    try:
        return h5py.File(path, "r", swmr=is_being_written(path))
    except OSError as error:
        raise InputError(f"{path}: cannot be read as HDF5 ({error}).") from error


def open_recording(path: Path | str) -> Recording:
    """Open a recording for reading: a closed one, one that is being written, or one that was cut off.

    Raises
    ------
    InputError
        When the file is missing, not HDF5, or not a recording.
    """
    path = Path(path)
    file = open_file(path)
    try:
        if file.attrs.get("format") != FORMAT:
            raise InputError(
                f"{path}: is HDF5 but not a recording of this software (attribute format is "
                f"{file.attrs.get('format')!r}); turn it into one: bench import {path} --profile P.toml --out REC.h5"
            )
        if int(file.attrs["format_version"]) > FORMAT_VERSION:
            raise InputError(f"{path}: written by a newer version (format {file.attrs['format_version']}); update.")
        return Recording(path, file)
    except (OSError, RuntimeError, KeyError, ValueError) as error:
        file.close()
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: damaged: {_in_words(error)}; run: bench verify {path}") from error


def _in_words(error: Exception) -> str:
    """One line of an error; of a setup that does not fit, the first fault."""
    if isinstance(error, ValidationError):
        first = error.errors(include_url=False)[0]
        return f"setup_json, {'.'.join(map(str, first['loc'])) or 'whole'}: {first['msg']}"
    return str(error)


def attributes_intact(stored: Mapping[str, Any]) -> bool:
    """Whether the attributes of a column file are those that were written."""
    return "attributes_crc32" in stored and int(stored["attributes_crc32"]) == text_crc(stored)
