"""The protocol of a back end: drive volts in, frames out, one call a block.

A back end never hides a fault: it raises `BackendError` and never falls back to another source of samples.
``tests/contract`` tests every back end against this protocol.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from daq.files.tables import Block
from kernels.arrays import Floats


class BackendError(RuntimeError):
    """The device failed or went away; the message says what happened and what to do."""


class Backend(Protocol):
    """A device that plays drive samples and records channels on one clock.

    Attributes
    ----------
    name
        The kind, as ``[backend] kind`` has it.
    simulated
        Whether no real plate moves.
    channels
        Names, in the order of a frame's columns.
    scales
        ``(volts_per_code, offset_v)`` by channel name.
    rate_hz
        Samples a second, of drive and frames alike.
    scenario_sha256
        Fingerprint of what the simulated rig was given; None for a device.
    """

    @property
    def name(self) -> str: ...  # the kind, as ``[backend] kind`` has it
    @property
    def simulated(self) -> bool: ...  # whether no real plate moves
    @property
    def channels(self) -> tuple[str, ...]: ...  # names, in the order of a frame's columns
    @property
    def scales(self) -> Mapping[str, tuple[float, float]]: ...  # ``(volts_per_code, offset_v)`` by channel name
    @property
    def rate_hz(self) -> float: ...  # samples a second, of drive and frames alike
    @property
    def scenario_sha256(self) -> str | None: ...  # of what the simulated rig was given; None for a device

    def start(self) -> None:
        """Open the device; the drive is at 0 V afterwards. Raises `BackendError`."""

    def exchange(self, drive_v: Floats) -> Block:
        """Play ``drive_v`` (n,) and return n frames: same order, indices without holes, losses declared in the block.

        Raises `BackendError` when the device failed, went away, or is not started, `ValueError` when ``drive_v`` is not
        one-dimensional, or holds something not finite.
        """

    def stop(self) -> None:
        """Leave the drive at 0 V and let the device go. May be called at any time, any number of times."""


@runtime_checkable
class TwoClocked(Protocol):
    """A back end whose frames are converted by another clock than the one that plays the drive.

    Its blocks say by `daq.files.tables.Block.place` where they belong among the played samples, declare their own
    losses, and hold a frame more or less than were played where the clocks have parted by one.
    """

    @property
    def readings(self) -> NDArray[np.void]:
        """Raw readings of the two clocks since the start, `daq.files.tables.CLOCK_DTYPE` rows."""


@runtime_checkable
class Lagging(Protocol):
    """A back end whose frames lie behind what was handed over to be played, by as much all along.

    Where it lost samples a block ends, and the next one declares them: it never comes short without saying where.
    """

    @property
    def lag_samples(self) -> float:
        """Samples from handing over to recording, known once started."""


@runtime_checkable
class FlipsSensor(Protocol):
    """A back end that can lay its accelerometer upside down by itself; on a real rig a person does it."""

    def turn(self, over: bool) -> None:
        """While it runs, the plate at rest: upside down, or back as it was mounted."""


@contextmanager
def running(backend: Backend) -> Iterator[None]:
    """A back end started on entry and stopped on exit, whatever happened between."""
    backend.start()
    try:
        yield
    finally:
        backend.stop()


def checked_drive(drive_v: Floats) -> Floats:
    """``drive_v`` as contiguous float64; raises `ValueError` for a wrong shape or a value that is not finite."""
    drive = np.ascontiguousarray(drive_v, dtype=np.float64)
    if drive.ndim != 1 or not np.all(np.isfinite(drive)):
        raise ValueError(f"wanted finite drive volts of shape (n,), came shape {drive.shape}")
    return drive


class Port(Protocol):
    """What is used of `serial.Serial`."""

    @property
    def in_waiting(self) -> int: ...
    def read(self, size: int) -> bytes: ...
    def write(self, data: bytes) -> Any: ...
    def reset_input_buffer(self) -> None: ...
    def close(self) -> None: ...


def open_port(name: str, baud: int, timeout_s: float, *, whose: str, key: str) -> Port:
    """The port ``name`` of the profile's ``key``; its reads wait for ``timeout_s``. Raises `BackendError`."""
    import serial  # only where there is a port

    try:
        port: Port = serial.Serial(name, baud, timeout=timeout_s)
    except (serial.SerialException, OSError, ValueError) as error:
        raise BackendError(
            f"{whose} {name}: cannot be opened ({error}); is it plugged in, and is {key} its name? "
            "bench devices lists what is there"
        ) from error
    return port
