"""The replay back end: a recording plays the part of the device, code for code.

It returns the recorded frames, whatever is driven. It counts as ``simulated``, and it ends where the recording
ends.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from daq.files.tables import Block
from daq.recording import Recording, open_recording
from daq.setup.errors import InputError
from kernels.arrays import Floats
from rig.backends.base import BackendError, checked_drive
from rig.backends.kinds.base import OpenOptions
from rig.profile import Profile


class ReplayBackend:
    """Frames of ``path``, from its first sample on.

    Raises `daq.setup.errors.InputError` when the file is no recording, or holds volts instead of codes (an imported
    one).
    """

    name = "replay"
    simulated = True
    scenario_sha256: str | None = None

    def __init__(self, path: Path | str) -> None:
        self._path = Path(path)
        with open_recording(self._path) as recording:
            self.channels = recording.channels
            self.rate_hz = recording.rate_hz
            self.scales = {name: recording.scale(name) for name in recording.channels}
            kinds = {recording.codes(name, 0, 1).dtype for name in recording.channels}
        if kinds != {np.dtype(np.int16)}:
            raise InputError(f"{self._path}: wanted a recording of int16 codes, came {', '.join(map(str, kinds))}")
        self._recording: Recording | None = None
        self._position = 0

    def start(self) -> None:
        """Open the recording at its first sample."""
        self.stop()
        self._recording = open_recording(self._path)
        self._position = 0

    def exchange(self, drive_v: Floats) -> Block:
        """The next frames, as many as ``drive_v`` has samples.

        Raises `BackendError` when not started, or when fewer frames are left.
        """
        n = len(checked_drive(drive_v))
        if self._recording is None:
            raise BackendError("not started")
        first, last = self._position, self._position + n
        if last > self._recording.n_samples:
            raise BackendError(f"{self._path}: the recording ends after {self._recording.n_samples} samples")
        codes = np.column_stack([self._recording.codes(name, first, last) for name in self.channels])
        lost = sum(int(count) for at, count in self._recording.gaps if first <= at < last)
        self._position = last
        return Block(first_sample=first, codes=codes, lost_before=lost)

    def stop(self) -> None:
        """Close the recording."""
        if self._recording is not None:
            self._recording.close()
            self._recording = None


def open_replay(profile: Profile, options: OpenOptions) -> ReplayBackend:
    """The recording that the command line names; raises `InputError` where it names none."""
    if options.replay is None:
        raise InputError("backend.kind is replay: name the recording to play by --replay REC.h5")
    return ReplayBackend(options.replay)
