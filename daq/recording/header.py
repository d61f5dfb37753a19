"""Headers of recordings, read without samples: attributes, tables, and the identity by which a run counts once.

A list of thousands of recordings is made in seconds. Tables, attributes and indexes are compared with the seal first;
files without one are read by another process, which may hang or die of them. The same file under two names, or the
same samples in two files, are one run: data given twice would make every uncertainty too small.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daq.files.column_file import CHUNK_SAMPLES, FORMAT
from daq.files.seal import Checked, check, check_tables, read_seal
from daq.files.tables import crc32, notes_of_rows
from daq.recording import open_recording
from daq.recording.opening import SIGNATURE, Tell, differing_blocks, in_subprocess, open_checked, open_file, unsealed
from daq.recording.reader import Recording, attributes_intact
from daq.recording.verify import report_of
from daq.setup.errors import InputError


def stored_id(recording: Recording) -> str:
    """Hash of name, number of samples and CRC-32 of every channel, as a closed recording stores them; none is read.

    The same for each copy of a run: profile, note and compression do not enter, so a copy that was calibrated anew
    holds the same run. Empty while a run lasts, and for one that was cut off.
    """
    content = recording.stored_content()
    return _hash(content) if content else ""


def content_id(recording: Recording) -> str:
    """The same of any recording: where a checksum is not stored, of its samples, all of which are read."""
    content = recording.stored_content()
    if not content or any(crc < 0 for _, _, crc in content):
        content = []
        for name in recording.channels:
            crc = 0
            for start in range(0, recording.n_samples, CHUNK_SAMPLES):
                crc = crc32(recording.codes(name, start, start + CHUNK_SAMPLES), crc)
            content.append((name, recording.n_samples, crc))
    return _hash(content)


def _hash(content: Sequence[tuple[str, int, int]]) -> str:
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:32]


def refuse_repeated(paths: Sequence[Path]) -> None:
    """Refuse a recording that is named twice.

    Raises `InputError`, naming the two: one file, by a second name or a link, or two files that hold the same samples.
    """
    seen: dict[Path, tuple[int, str]] = {}  # number of samples, and `content_id` where it had to be known
    for path in paths if len(paths) > 1 else ():
        for other in seen:
            if path.exists() and other.exists() and path.samefile(other):
                raise InputError(f"{other} and {path} are one file; name each recording once, or its run counts twice.")
        with open_recording(path) as recording:
            own = recording.n_samples
            # samples may have to be read for it: only where two recordings have as many
            alike = [other for other, (n, _) in seen.items() if n == own]
            content = content_id(recording) if alike else ""
        for other in alike:
            if not seen[other][1]:
                with open_recording(other) as recording:
                    seen[other] = own, content_id(recording)
            if seen[other][1] == content:
                raise InputError(f"{other} and {path} hold the same samples; name each run once, or it counts twice.")
        seen[path] = own, content


SMALL_BYTES = 32 << 20
"""Size up to which every byte is compared with the seal, because opening the file takes as long."""


@dataclass(frozen=True)
class Header:
    """One recording in plain values, as JSON knows them."""

    # `stored_id`: the same for each copy of a run; empty where the run is not closed
    identity: str
    state: str  # as in `daq.recording.verify.VerifyReport`, of what was compared
    where: tuple[str, ...]  # the same
    all_bytes: bool  # whether the samples were compared with the seal as well
    attrs: dict[str, Any]  # root attributes
    setup: dict[str, Any]  # the setup as a JSON object (`daq.setup.setup.Setup`)
    rate_hz: float
    n_samples: int  # of a channel
    lost_samples: int  # declared as lost
    channels: tuple[str, ...]  # names
    gammas: tuple[float | None, ...] = ()  # of each step; None where it is not known
    achieved_gammas: tuple[float | None, ...] = ()  # the same
    ratios: tuple[int, ...] = ()  # of each step
    notes: tuple[tuple[int, int, str], ...] = ()  # Sample, Unix time (ns) and text of each note of the run


@dataclass(frozen=True)
class Unread:
    """A file without a header: damaged, or HDF5 of another ``format`` (empty: none is stated)."""

    why: str
    damaged: bool
    format: str = ""


def read_headers(paths: Iterable[Path], *, all_bytes: bool = False) -> Iterator[tuple[Path, Header | Unread]]:
    """Read the headers of recordings, those without a seal last.

    ``paths`` are HDF5 files, recordings or not. With ``all_bytes`` samples are compared with the seal too, as
    `daq.recording.verify.verify` does, whatever the size.

    Yields
    ------
    Path, Header or Unread
        A file that is no longer there is left out.
    """
    later: dict[str, list[str]] = {}  # files that only another process may read, with the faults that are known
    for path in paths:
        try:
            answer = _sealed(path, later, all_bytes=all_bytes)
        except FileNotFoundError:
            continue
        except OSError as error:
            answer = Unread(f"cannot be read ({error.strerror or error})", damaged=True)
        if answer is not None:
            yield path, answer
    yield from _by_subprocess(later)


def _sealed(path: Path, later: dict[str, list[str]], *, all_bytes: bool) -> Header | Unread | None:
    """Header of a sealed file, read here; None where another process has to."""
    size = path.stat().st_size
    with path.open("rb") as raw:
        head = raw.read(len(SIGNATURE))
    if read_seal(path) is False:
        if head != SIGNATURE:
            return Unread("cannot be read as HDF5 (it does not begin as one)", damaged=True)
        later[str(path)] = []
        return None
    every = all_bytes or size <= SMALL_BYTES
    found = check(path) if every else check_tables(path)
    if found is None or found.seal_differs:
        later[str(path)] = list(found.where) if found else []
        return None
    try:
        with open_checked(path, found) as recording:
            recording.damage += tuple(differing_blocks(recording))
            return header_of(recording, all_bytes=every)
    except InputError as error:
        return Unread(_without(path, str(error)), damaged=True)


def header_of(recording: Recording, *, all_bytes: bool) -> Header:
    """Header of an open recording."""
    report, steps = report_of(recording), recording.steps
    gammas, achieved = (
        tuple(float(x) if math.isfinite(x) else None for x in steps[name]) for name in ("gamma", "achieved_gamma")
    )
    attrs = {k: v for k, v in recording.attrs.items() if not k.endswith("_json") and k != "profile_text"}
    return Header(
        stored_id(recording), report.state, tuple(report.where), all_bytes, attrs,
        recording.setup.model_dump(mode="json"), recording.rate_hz, recording.n_samples, report.lost_samples,
        recording.channels, gammas, achieved,
        tuple(int(c) for c in steps["ratio"]), tuple(notes_of_rows(recording.notes)),
    )  # fmt: skip


def _by_subprocess(left: dict[str, list[str]]) -> Iterator[tuple[Path, Header | Unread]]:
    """Headers of files without a seal, by another process; where it dies, the next goes on after that file."""
    while left:
        answer = in_subprocess("daq.recording.header:look", list(left), left)
        for name, read in (answer.value or {}).items():
            left.pop(name)
            if read is not None:
                values: dict[str, Any] = {key: tuple(x) if isinstance(x, list) else x for key, x in read.items()}
                yield Path(name), Header(**values) if "attrs" in values else Unread(**values)
        if not answer.died:
            return
        at = answer.at if answer.at in left else next(iter(left))
        left.pop(at)
        yield Path(at), Unread(f"{answer.died}; run: bench verify {at}", damaged=True)


def look(names: list[str], found: dict[str, list[str]], tell: Tell) -> dict[str, Any]:
    """Body of the process: the headers of all of them."""
    headers: dict[str, Any] = {}
    for name in names:
        tell(name)
        checked = Checked(where=tuple(found[name]), seal_differs=True) if found[name] else None
        try:
            try:
                header = _opened(Path(name), checked, ended=True)  # as if its writer had closed it
            except InputError:
                header = _opened(Path(name), checked, ended=False)  # as it is being written
            headers[name] = dataclasses.asdict(header)
        except FileNotFoundError:
            headers[name] = None
        except (InputError, OSError, RuntimeError) as error:
            headers[name] = dataclasses.asdict(Unread(_without(Path(name), str(error)), damaged=True))
    return headers


def _opened(path: Path, found: Checked | None, *, ended: bool) -> Header | Unread:
    """Header of a file without a sound seal."""
    with open_file(path, Checked(), ended=ended) as file:
        format = file.attrs.get("format", "")
    if format != FORMAT:
        return Unread("is HDF5 but not a recording of this software", damaged=False, format=str(format))
    with open_checked(path, Checked(), ended=ended) as recording:
        recording.damage += unsealed(recording, found, intact=attributes_intact(recording.stored))
        recording.damage += tuple(differing_blocks(recording))
        if recording.frames is not None and recording.frames.faults:
            if ended:
                raise InputError(f"{path}: {recording.frames.faults[0]}")
            recording.damage += tuple(recording.frames.faults)
        return header_of(recording, all_bytes=False)


def _without(path: Path, text: str) -> str:
    """The text of an error without the path that it begins with."""
    return text.removeprefix(f"{path}:").strip()
