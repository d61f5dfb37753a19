"""State of a recording: complete, stopped, incomplete or damaged, where, and what of it can be read.

Every byte is compared with the seal before HDF5 sees it. A file without a seal (cut off, by an earlier version, written
to by another program) is read by a process of its own. Where that one dies or hangs, the next goes round the place,
until all else has been read.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from daq.files.column_file import CHUNK_SAMPLES, TABLES, read_table
from daq.files.disk import in_words, mapped, refuse_columns
from daq.files.frames.frame_file import (
    FRAME_SIDE,
    FRAME_STEPS,
    FRAMES,
    is_being_written,
    is_cut_short,
    stated_bytes,
    table_of,
)
from daq.files.frames.marked_frames import MarkedFrames, has_marks
from daq.files.seal import Checked, check, once_per_state
from daq.files.tables import SIDE_TABLES, STEP_DTYPE, crc32, joined
from daq.recording.opening import (
    UNCHECKED,
    Tell,
    differing_blocks,
    in_subprocess,
    open_checked,
    open_file,
    require_hdf5,
    unsealed,
)
from daq.recording.reader import ALL, Recording, attributes_intact
from daq.setup.errors import InputError


@dataclass(frozen=True)
class Survey(Checked):
    """Result of reading a file without a seal, as a comparison with one; ``lost`` holds tables too, without range."""

    bad_blocks: tuple[int, ...] = ()  # of a frames file: they do not read, or differ from what was recorded
    opens: bool = True  # False where nothing of it reads


class UnreadableError(InputError):
    """A recording of which nothing can be read; ``where`` says why, line by line."""

    def __init__(self, path: Path, where: list[str]) -> None:
        super().__init__(f"{path}: damaged, and nothing of it can be read: {'; '.join(where)}")
        self.where = where


def examine(path: Path) -> tuple[Recording, Survey]:
    """Open a recording in whatever state, all of it checked first; and what another process found, where one read it.

    Raises `InputError` when there is no such file, or it never was a recording; `UnreadableError` when nothing of it
    can be read.
    """
    require_hdf5(path)
    found = check(path)
    if found is not None and not found.seal_differs:
        try:
            recording, looked = open_checked(path, found), Survey()
        except InputError as error:
            if "not a recording" in str(error) or not found.where:
                raise
            raise UnreadableError(path, [*found.where, str(error)]) from error
    else:
        looked = survey(path)
        marked = _by_marks(path, looked) if looked.where else None
        if not looked.opens and marked is None:
            raise UnreadableError(path, [*(() if found is None else found.where), *looked.where])
        if marked is not None:
            recording, looked = marked
        else:
            recording = open_checked(path, looked, ended=bool(looked.where))
        intact = recording.frames is not None or attributes_intact(recording.stored)
        recording.damage += unsealed(recording, found, intact=intact)
    recording.damage += tuple(differing_blocks(recording))
    return recording, looked


def _by_marks(path: Path, looked: Survey) -> tuple[Recording, Survey] | None:
    """A damaged frames file as its marks have it; None without marks, or where HDF5 reads more of it."""
    further: dict[str, NDArray[np.void]] = {}
    n_samples = 0
    if looked.opens:
        with open_checked(path, looked, ended=True) as recording:
            if recording.frames is None:
                return None
            n_samples = recording.n_samples
            further = {"steps": recording.frames.steps, **recording.frames.side}
    try:
        frames = MarkedFrames(mapped(path), further)
    except LookupError:
        return None
    known = {f"block {i}" for i in range(len(frames.blocks))}  # of which the marks know it more exactly
    frames.faults += [line for line in looked.where if line.startswith("block ") and line.split(":")[0] not in known]
    others = [line for line in looked.where if not line.startswith("block ")]
    lines = (*others, *frames.faults) or (
        "rows of its tables differ from what was written; marks in the file have them",
    )
    found = Survey(where=lines, bad_blocks=tuple(frames.bad_blocks))
    recording = Recording(path, frames, {}, found.where)
    if recording.n_samples < n_samples:
        recording.close()
        return None
    return recording, found


@once_per_state
def survey(path: Path) -> Survey:
    """Read all of a recording, in other processes, once for each state (raises InputError: it never was one)."""
    before = path.stat()
    found = _survey(path, ended=True)
    after = path.stat()
    moved = (before.st_mtime_ns, before.st_size) != (after.st_mtime_ns, after.st_size)
    # HDF5 waits up to seconds for a writer to put right what does not read: only of a file that was written meanwhile
    if moved and is_being_written(path) and (found.lost or not found.opens):
        now = _survey(path, ended=False, tries=1)
        return now if now.opens and not now.lost else found
    return found


def _survey(path: Path, *, ended: bool, tries: int = 12) -> Survey:
    """Read all of it, round the places where a process died."""
    skip: list[str] = []
    why: list[str] = []
    for _ in range(tries):
        try:
            answer = in_subprocess("daq.recording.verify:look", str(path), ended, skip)
        except InputError as error:
            if "damaged" not in str(error) and "cannot be read as HDF5" not in str(error):
                if not has_marks(path):
                    raise
                return Survey(where=("its root attributes are gone",), opens=False)
            size, stated = path.stat().st_size, stated_bytes(path)
            cut_short = (
                f"cut off after {size} of {stated} bytes: what is left may hold samples, but set-up, scales and the "
                "tables that say where each sample stands were in the part that is missing; copy the whole file again"
            )
            return Survey(where=(cut_short if size < stated else str(error),), opens=False)
        except OSError as error:
            return Survey(where=(f"does not read back ({in_words(error)})",), opens=False)
        if not answer.died:
            value: dict[str, Any] = answer.value
            lost = {name: tuple((a, b) for a, b in spans) for name, spans in value["lost"].items()}
            return Survey(lost=lost, where=(*why, *value["where"]), bad_blocks=tuple(value["bad_blocks"]))
        why.append(f"{answer.at or 'its beginning'}: {answer.died}")
        if not answer.at or answer.at in skip:
            break
        skip.append(answer.at)
    return Survey(where=tuple(why), opens=False)


def look(path: str, ended: bool, skip: list[str], tell: Tell) -> dict[str, Any]:
    """Body of the process: read everything but ``skip``."""
    lost: dict[str, list[tuple[int, int]]] = {}
    where: list[str] = []
    if is_cut_short(Path(path)):
        where.append("the file is shorter than it says: its end was never written, or not copied")
    with open_file(Path(path), Checked(), ended=ended) as file:
        if file.attrs.get("format") is not None:
            for name in _unreadable_tables(file, Path(path), skip, tell):
                lost[name] = []
                where.append(f"the table {name} does not read back")
            for name in [] if FRAMES in file else list(file.attrs["channels"]):
                tell(f"{name}'s place")
                try:
                    refuse_columns(file, (name,), Path(path))
                except (InputError, KeyError, OSError, RuntimeError) as error:
                    lost[name] = [ALL]
                    where.append(f"{name}: is left out ({in_words(error)})")
    tell("its set-up")
    without = Checked(lost={name: tuple(spans) for name, spans in lost.items()})
    with open_checked(Path(path), without, ended=ended) as recording:
        bad: list[int] = []
        if recording.frames is not None:
            where += recording.frames.faults
            bad = _look_at_frames(recording, lost, where, skip, tell)
        else:
            where += _look_at_columns(recording, lost, skip, tell)
            spans = [(name, a, b) for name in lost for a, b in joined(lost[name]) if (a, b) != ALL]
            where += [f"{name}: samples {a} to {b - 1} do not read back" for name, a, b in spans]
    return {"lost": {name: joined(spans) for name, spans in lost.items()}, "bad_blocks": bad, "where": where}


def _unreadable_tables(file: Any, path: Path, skip: list[str], tell: Tell) -> Iterator[str]:
    """Tables without which a recording still is one."""
    frame_tables = {FRAME_STEPS: STEP_DTYPE} | {FRAME_SIDE[name]: dtype for name, dtype in SIDE_TABLES.items()}
    for name, dtype in frame_tables.items() if FRAMES in file else TABLES.items():
        tell(name)
        try:
            if name in skip:
                raise OSError(name)
            if FRAMES not in file:
                read_table(file, name, dtype, path)
            elif name in file:
                table_of(file, name, dtype, path)
        except (OSError, RuntimeError, KeyError, ValueError):
            yield name


def _look_at_frames(
    recording: Recording, lost: dict[str, Any], where: list[str], skip: list[str], tell: Tell
) -> list[int]:
    """Read every block; those that do not read, or differ. They are added to ``lost``."""
    bad, frames = [], recording.frames
    for i, block in enumerate(recording.blocks):
        label = f"block {i}"
        tell(label)
        first, last = int(block["first_sample"]), int(block["first_sample"] + block["n_samples"])
        try:
            if label in skip or frames is None:
                raise OSError(label)
            if crc32(frames.rows(first, last)) == block["crc32"]:
                continue
            where.append(f"{label}: samples {first} to {last - 1} differ from what was recorded")
        except (OSError, RuntimeError):
            where.append(f"{label}: samples {first} to {last - 1} do not read back")
        bad.append(i)
        lost.setdefault(FRAMES, []).append((first, last))
    return bad


def _look_at_columns(recording: Recording, lost: dict[str, Any], skip: list[str], tell: Tell) -> list[str]:
    """Read every sample; what is wrong with a whole channel. What does not read is added to ``lost``."""
    faults, n_samples = [], recording.n_samples
    for name in (*recording.channels, "timestamp"):
        dataset, crc = recording._file[name], 0
        if dataset.shape != (n_samples,):
            faults.append(f"{name}: {dataset.shape[0]} samples, but timestamp has {n_samples}")
        for first in range(0, n_samples, CHUNK_SAMPLES):
            last = min(first + CHUNK_SAMPLES, n_samples)
            # announced before it is read: if it kills this process, the next one leaves it out
            label = f"{name} from {first}"
            tell(label)
            try:
                if label in skip:
                    raise OSError(label)
                crc = crc32(dataset[first:last], crc)
            except (OSError, RuntimeError, ValueError):
                lost.setdefault(name, []).append((first, last))
        if name not in lost and crc != int(dataset.attrs.get("crc32", -1)):
            faults.append(f"{name}: the checksum over all its samples does not fit")
    return faults


State = Literal["complete", "stopped", "incomplete", "damaged"]


@dataclass(frozen=True)
class VerifyReport:
    """State of a recording."""

    # ``complete``: the run ended as planned. ``stopped``: ended early, whole. ``incomplete``: cut off, or still
    # being written. ``damaged``: something does not read back as it was written.
    state: State
    # one line for each thing a person should know: damaged ranges, the reason of a stop, gaps
    where: list[str] = field(default_factory=list)
    n_samples: int = 0
    rate_hz: float = float("nan")
    lost_samples: int = 0  # declared as lost
    suspect: bool = False  # samples are missing that no gap accounts for


def verify(path: Path | str) -> VerifyReport:
    """Read a recording from end to end and say what state it is in (raises InputError: no recording)."""
    try:
        recording, _ = examine(Path(path))
    except UnreadableError as error:
        return VerifyReport("damaged", error.where)
    with recording:
        return report_of(recording)


def report_of(recording: Recording) -> VerifyReport:
    """State of an open recording, by its tables and what was found when it was opened."""
    faults, n = [line for line in recording.damage if line != UNCHECKED], recording.blocks["n_samples"]
    if recording.frames is None and n.sum() != recording.n_samples:
        faults.append(f"the block table counts {n.sum()} samples, the channels have {recording.n_samples}")
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
