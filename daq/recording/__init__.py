"""Recordings: open one, and say what state it is in; `daq.recording.writer` writes one while a run lasts.

A recording is never overwritten and never half-written. While the run lasts the file holds raw frames that survive a
kill (`daq.files.frames.frame_writer`); `RecordingWriter.close` writes the column file next to it
(`daq.files.column_file`), checks it, and renames it into place. `open_recording` reads both alike. The layout is in
docs/reference/recording-format.md.
"""

from __future__ import annotations

import functools
import logging
from pathlib import Path

from daq.channels.registry import CHANNELS
from daq.files.tables import BLOCK_DTYPE, STEP_DTYPE, Block, BlockFlag
from daq.recording.reader import Recording
from daq.recording.verify import VerifyReport, examine, verify

__all__ = [
    "BLOCK_DTYPE",
    "CHANNELS",
    "STEP_DTYPE",
    "Block",
    "BlockFlag",
    "Recording",
    "VerifyReport",
    "open_recording",
    "verify",
]

log = logging.getLogger(__name__)


def open_recording(path: Path | str) -> Recording:
    """Open a recording for reading: a closed one, one that is being written, or one that was cut off.

    All of a closed file is compared with its checksums first; a file without them is read by another process first.
    What is damaged is put right where the checksums suffice, and else is a gap in what is read; `Recording.damage` and
    a warning (`logging`) say so.

    Raises `InputError` when the file is missing, not HDF5, not a recording, or damaged where nothing can be read
    without it.
    """
    path = Path(path)
    recording, _ = examine(path)
    for line in recording.damage:
        _say(f"{path}: {line}")
    return recording


@functools.lru_cache(maxsize=256)
def _say(line: str) -> None:
    """Warn of the same thing once."""
    log.warning("%s", line)
