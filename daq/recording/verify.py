"""Say whether a recording is complete, stopped, incomplete or damaged, and where.

The rule kept here: every byte is read. A checksum that fits a chunk is not enough (a chunk that is missing reads as
zeros), so each channel also carries the CRC-32 of all its samples.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from daq.recording.column_file import CHUNK_SAMPLES, check_columns
from daq.recording.frame_file import is_being_written, is_whole
from daq.recording.reader import Recording, attributes_intact, open_recording
from daq.recording.tables import BlockFlag
from daq.setup.errors import InputError

State = Literal["complete", "stopped", "incomplete", "damaged"]


@dataclass(frozen=True)
class VerifyReport:
    """What `verify` found.

    Attributes
    ----------
    state
        ``complete``: the run ended as planned. ``stopped``: ended early, whole. ``incomplete``: cut off, or still being
        written. ``damaged``: something does not read back as it was written.
    where
        One line for each thing a person should know: damaged ranges, the reason of a stop, gaps.
    n_samples, rate_hz, lost_samples
        Size, and samples declared as lost.
    suspect
        Samples are missing that no gap accounts for.
    """

    state: State
    where: list[str] = field(default_factory=list)
    n_samples: int = 0
    rate_hz: float = float("nan")
    lost_samples: int = 0
    suspect: bool = False


def verify(path: Path | str) -> VerifyReport:
    """Read a recording from end to end and say what state it is in.

    Parameters
    ----------
    path
        Recording, closed or cut off.

    Raises
    ------
    InputError
        When there is no such file, or it never was a recording.
    """
    path = Path(path)
    if path.is_file() and is_being_written(path) and not is_whole(path):
        return VerifyReport("damaged", [f"{path}: cut off, and shorter than its index says: a copy that broke off?"])
    try:
        recording = open_recording(path)
    except InputError as error:
        never_was = "not a recording" in str(error) or path.suffix.lower() not in (".h5", ".hdf5")
        if not path.is_file() or never_was:
            raise
        return VerifyReport("damaged", [str(error)])
    with recording:
        try:
            faults = _faults(recording)
        except (OSError, RuntimeError, KeyError) as error:
            faults = [f"{path}: does not read back ({error})"]
        return _report(recording, faults)


def _faults(recording: Recording) -> list[str]:
    frames = recording.frames
    if frames is not None:
        bad = [i for which, rows in frames.pieces(CHUNK_SAMPLES) for i in frames.damaged_in(which, rows)]
    else:
        bad = list(np.flatnonzero(recording.blocks["flags"] & BlockFlag.DAMAGED))
    first, n = recording.blocks["first_sample"], recording.blocks["n_samples"]
    faults = [f"block {i}: samples {first[i]} to {first[i] + n[i] - 1} differ from what was recorded" for i in bad]
    if frames is None:
        faults += check_columns(recording._file)
        if not attributes_intact(recording.stored):
            faults.append("the root attributes differ from what was written")
        if n.sum() != recording.n_samples:
            faults.append(f"the block table counts {n.sum()} samples, the channels have {recording.n_samples}")
    return faults


def _report(recording: Recording, faults: list[str]) -> VerifyReport:
    ended, why = str(recording.attrs.get("ended", "")), str(recording.attrs.get("why", ""))
    where = list(faults)
    state: State
    if faults:
        state = "damaged"
    elif recording.frames is not None or ended == "incomplete":
        state = "incomplete"
        where.append(
            f"cut off or still being written after {recording.n_samples} samples; run: bench recover {recording.path}"
        )
    else:
        state = "complete" if ended == "complete" else "stopped"
    if ended not in ("complete", "incomplete"):
        where.append(f"ended: {ended}" + (f" ({why})" if why else ""))
    where += [f"{lost} samples lost before sample {first}" for first, lost in recording.gaps]
    suspect = bool(recording.attrs.get("suspect", False))
    if suspect:
        where.append("suspect: samples are missing that no gap accounts for")
    lost = int(recording.gaps[:, 1].sum())
    return VerifyReport(state, where, recording.n_samples, recording.rate_hz, lost, suspect)
