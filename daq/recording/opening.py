"""Open the HDF5 file of a recording, its damaged bytes put right or left out.

The bytes of a file were compared before (`daq.files.seal`), or another process has read them
(`daq.recording.verify`).
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import h5py
import hdf5plugin  # noqa: F401 (registers bitshuffle-LZ4 with HDF5)
import numpy as np
from pydantic import ValidationError

from daq.files.claims import in_words
from daq.files.column_file import FORMAT, FORMAT_VERSION
from daq.files.disk import PatchedFile
from daq.files.frames.frame_file import FRAMES, as_if_ended, is_being_written, is_cut_short, stated_bytes
from daq.files.frames.marked_frames import has_marks
from daq.files.seal import Checked, check, check_tables
from daq.files.tables import BlockFlag
from daq.recording.reader import Recording
from daq.setup.errors import InputError, require_file

UNCHECKED = "recorded by an earlier version, without checksums over its tables: they are read unchecked"
SIGNATURE = b"\x89HDF\r\n\x1a\n"


def open_quickly(path: Path) -> Recording | None:
    """Open a sealed recording of which only tables, attributes and indexes are compared with the seal.

    Its samples are as safe as HDF5's own checksum of each chunk; `daq.recording.open_recording` compares them all.

    Raises `InputError` when it is not a recording, or cannot be read. None for a file without a sound seal.
    """
    require_file(path)
    found = check_tables(path)
    return None if found is None or found.seal_differs else open_checked(path, found)


def unsealed(recording: Recording, found: Checked | None, *, intact: bool) -> tuple[str, ...]:
    """Faults of a closed recording that cannot be compared with a seal."""
    if recording.frames is not None:
        return ()
    lines = [] if found is None else list(found.where)
    if not intact:
        lines.append("the root attributes differ from what was written")
    if found is None and not recording.stored.get("sealed"):
        lines.append(UNCHECKED)
    elif found is None:
        # a file that HDF5 has written to ends where HDF5's part does
        is_cut = recording.path.stat().st_size > stated_bytes(recording.path) > 0
        cut = "the file was cut off behind its samples and tables, of which nothing is missing"
        lines.append(f"its checksums are gone: {cut if is_cut else 'another program has written to it since'}")
    return tuple(lines)


def differing_blocks(recording: Recording) -> list[str]:
    """Blocks that did not fit their checksum when the recording was closed or recovered."""
    bad = np.flatnonzero(recording.blocks["flags"] & BlockFlag.DAMAGED)
    first, n = recording.blocks["first_sample"], recording.blocks["n_samples"]
    return [f"block {i}: samples {first[i]} to {first[i] + n[i] - 1} differ from what was recorded" for i in bad]


def require_hdf5(path: Path) -> None:
    """Refuse what cannot be an HDF5 file (raises InputError)."""
    require_file(path)
    try:
        with path.open("rb") as raw:
            head, tail = raw.read(len(SIGNATURE)), check(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    if head != SIGNATURE and tail is None and not h5py.is_hdf5(path) and not has_marks(path):
        raise InputError(
            f"{path}: cannot be read as HDF5 (it does not begin as one); other files become recordings with "
            f"bench import {path} --profile P.toml --out REC.h5."
        )


def open_checked(path: Path, found: Checked, *, ended: bool = False) -> Recording:
    """Open a recording whose bytes were compared with its seal, or that was read through before, or just written.

    Raises `InputError` when it is not a recording, or cannot be read.

    Parameters
    ----------
    found
        What differs: it is put right, or left out.
    ended
        Read a file that was not closed, or is shorter than it says, as if its writer had closed it as it is.
    """
    lost = {name: list(spans) for name, spans in found.lost.items()}
    file = open_file(path, found, ended=ended)
    try:
        require_recording(path, file)
        for name, spans in found.mended.items():
            for first, last in spans:
                try:  # HDF5's own checksum of the chunk must fit what was put right
                    file[name][first:last]
                except (OSError, RuntimeError):
                    lost[name] = [*lost.get(name, ()), (first, last)]
        return Recording(path, file, lost, found.where)
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError) as error:
        file.close()
        if isinstance(error, InputError):
            raise
        why = in_words(error)
        if isinstance(error, ValidationError):
            first_fault = error.errors(include_url=False)[0]
            why = f"setup_json, {'.'.join(map(str, first_fault['loc'])) or 'whole'}: {first_fault['msg']}"
        raise InputError(f"{path}: damaged: {why}; run: bench verify {path}") from error


def open_file(path: Path, found: Checked, *, ended: bool = False) -> Any:
    """The HDF5 file, its damaged bytes put right (raises InputError)."""
    try:
        if found.patches:
            return h5py.File(PatchedFile(path, found.patches), "r")
        if is_being_written(path):
            return h5py.File(as_if_ended(path), "r") if ended else h5py.File(path, "r", swmr=True)
        # frames follow one another: what is left of them can be read, as if the run had ended there
        if ended and is_cut_short(path) and (frames := _frames_cut_short(path)) is not None:
            return frames
        # each open column holds the chunk that the next read begins in; by default HDF5 would drop the latest chunks,
        # and hold those that were read in part however long ago
        return h5py.File(path, "r", rdcc_nbytes=1 << 20, rdcc_w0=0.0)
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as HDF5 ({in_words(error)}).") from error


def _frames_cut_short(path: Path) -> Any:
    """A frames file that is shorter than it says; None for columns, whose tables stand at the end that is missing."""
    with contextlib.suppress(OSError, RuntimeError, KeyError):
        file = h5py.File(as_if_ended(path), "r")
        with contextlib.suppress(OSError, RuntimeError, KeyError):
            if FRAMES in file and file.attrs.get("format") == FORMAT:
                return file
        file.close()
    return None


def require_recording(path: Path, file: Any) -> None:
    """Refuse HDF5 that is no recording, or one of a later format (raises InputError)."""
    if file.attrs.get("format") != FORMAT:
        raise InputError(
            f"{path}: is HDF5 but not a recording of this software (attribute format is "
            f"{file.attrs.get('format')!r}); turn it into one: bench import {path} --profile P.toml --out REC.h5."
        )
    if int(file.attrs["format_version"]) > FORMAT_VERSION:
        raise InputError(f"{path}: written by a newer version (format {file.attrs['format_version']}); update.")
