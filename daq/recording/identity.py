"""Identity of recordings: the same file under two names, or the same samples in two files.

A run counts once: data given twice would make every uncertainty too small.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path

from daq.files.column_file import CHUNK_SAMPLES
from daq.files.tables import crc32
from daq.recording import open_recording
from daq.recording.reader import Recording
from daq.setup.errors import InputError


def content_id(recording: Recording) -> tuple[tuple[str, int, int], ...]:
    """Name, number of samples and CRC-32 of every channel, as stored; the same for each copy of a run.

    Profile, note and compression do not enter: a copy that was calibrated anew holds the same run.
    """
    found = []
    for name in recording.channels:
        crc = 0
        for start in range(0, recording.n_samples, CHUNK_SAMPLES):
            crc = crc32(recording.codes(name, start, start + CHUNK_SAMPLES), crc)
        found.append((name, recording.n_samples, crc))
    return tuple(found)


def stored_id(recording: Recording) -> str:
    """Hash of `content_id` by the checksums that a closed recording stores; no sample is read.

    The same for each copy of a run. Empty while a run lasts, and for one that was cut off.
    """
    if recording.frames is not None:
        return ""
    stored = recording.stored_checksums()
    content = [(name, recording.stored_samples, crc) for name, crc in stored.items()]
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:32] if stored else ""


def refuse_repeated(paths: Sequence[Path]) -> None:
    """Refuse a recording that is named twice.

    Parameters
    ----------
    paths
        Recordings that are to be judged together.

    Raises
    ------
    InputError
        Naming the two: one file, by a second name or a link, or two files that hold the same samples.
    """
    if len(paths) < 2:
        return
    seen: list[tuple[Path, int, tuple[tuple[str, int, int], ...] | None]] = []
    for path in paths:
        for other, _, _ in seen:
            if path.exists() and other.exists() and path.samefile(other):
                raise InputError(f"{other} and {path} are one file; name each recording once, or its run counts twice.")
        with open_recording(path) as recording:
            own = recording.n_samples
            alike = [i for i, (_, n, _) in enumerate(seen) if n == own]
            known = content_id(recording) if alike else None
        for i in alike:  # samples are read only where two recordings have as many
            other, n, content = seen[i]
            if content is None:
                with open_recording(other) as recording:
                    content = content_id(recording)
                seen[i] = (other, n, content)
            if content == known:
                raise InputError(f"{other} and {path} hold the same samples; name each run once, or it counts twice.")
        seen.append((path, own, known))
