"""Say whether a recording is complete, stopped, incomplete or damaged, and where.

Every byte is compared with the seal before HDF5 sees it. A file without one is read by another
process, to the end, whatever that meets.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from daq.recording.opening import UNCHECKED
from daq.recording.reader import Recording
from daq.recording.survey import UnreadableError, examine

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
    try:
        recording, _ = examine(Path(path))
    except UnreadableError as error:
        return VerifyReport("damaged", error.where)
    with recording:
        return report_of(recording)


def report_of(recording: Recording) -> VerifyReport:
    """State of an open recording, by its tables and what was found when it was opened."""
    return _report(recording, _faults(recording))


def _faults(recording: Recording) -> list[str]:
    """Everything that does not read back as it was written."""
    faults, n = [line for line in recording.damage if line != UNCHECKED], recording.blocks["n_samples"]
    if recording.frames is None and n.sum() != recording.n_samples:
        faults.append(f"the block table counts {n.sum()} samples, the channels have {recording.n_samples}")
    return faults


def _report(recording: Recording, faults: list[str]) -> VerifyReport:
    ended, why = str(recording.attrs.get("ended", "")), str(recording.attrs.get("why", ""))
    where = list(faults)
    if UNCHECKED in recording.damage:
        where.append(UNCHECKED)
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
