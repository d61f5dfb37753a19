"""Recordings: write one while a run lasts, open one afterwards, and say what state it is in.

A recording is never overwritten and never half-written. While the run lasts the file holds raw
frames that survive a kill (`daq.recording.frame_file`); `RecordingWriter.close` writes the column file beside it
(`daq.recording.column_file`), checks it, and renames it into place. `open_recording` reads both alike. The layout is in
docs/reference/recording-format.md.
"""

from daq.recording.reader import Recording, open_recording
from daq.recording.tables import BLOCK_DTYPE, CHANNELS, STEP_DTYPE, Block, BlockFlag
from daq.recording.verify import VerifyReport, verify
from daq.recording.writer import RecordingWriter

__all__ = [
    "BLOCK_DTYPE",
    "CHANNELS",
    "STEP_DTYPE",
    "Block",
    "BlockFlag",
    "Recording",
    "RecordingWriter",
    "VerifyReport",
    "open_recording",
    "verify",
]
