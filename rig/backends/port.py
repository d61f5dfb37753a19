"""A serial port, as the back ends use it."""

from __future__ import annotations

from typing import Any, Protocol

import serial

from rig.backends.base import BackendError


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
    try:
        port: Port = serial.Serial(name, baud, timeout=timeout_s)
    except (serial.SerialException, OSError, ValueError) as error:
        raise BackendError(
            f"{whose} {name}: cannot be opened ({error}); is it plugged in, and is {key} its name? "
            "bench devices lists what is there"
        ) from error
    return port
