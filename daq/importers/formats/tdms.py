"""TDMS files of LabVIEW and DIAdem as tables, read piece by piece (package npTDMS)."""

from __future__ import annotations

import weakref
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.importers.formats.arrays import LIBRARY_ERRORS, MOST_OBJECTS, ArraySource
from daq.importers.formats.columns import listed, with_unit
from daq.setup.errors import InputError

_TICKS_NS = 1_000_000_000


class TdmsSource(ArraySource):
    """Channels of every group, ``group/channel``; codes with one linear scale stay codes.

    The rate is that of the waveforms' increment where all channels agree. A channel of time stamps is nanoseconds.
    """

    time_unit = ""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        try:
            from nptdms import TdmsFile
        except ImportError as error:
            raise InputError(
                f"{path}: TDMS needs the package npTDMS: pip install npTDMS, or pip install 'shakerbench[interchange]'"
            ) from error
        self._channels: dict[str, tuple[Any, bool]] = {}
        increments: set[float] = set()
        handle = path.open("rb")
        weakref.finalize(self, handle.close)  # neither the library nor a source closes it
        try:
            self._file = TdmsFile.open(handle)
            for group in self._file.groups():
                for channel in group.channels():
                    self._take(group.name, channel, increments)
        except LIBRARY_ERRORS as error:
            if isinstance(error, InputError):
                raise
            handle.close()
            raise InputError(f"{path}: cannot be read as TDMS ({error}).") from error
        if not self._lengths:
            handle.close()
            raise InputError(f"{path}: cannot be read as TDMS: it holds no channel of numbers.")
        if len(increments) == 1 and (step := increments.pop()) > 0:
            rate_hz = 1.0 / step
            whole = round(rate_hz)  # taken where the increment is its reciprocal in double precision
            self.rate_hz = float(whole) if whole > 0 and abs(rate_hz / whole - 1.0) < 1e-14 else rate_hz

    def _take(self, group: str, channel: Any, increments: set[float]) -> None:
        if len(self._channels) >= MOST_OBJECTS:
            raise InputError(f"{self.path}: holds more than {MOST_OBJECTS} channels; keep only the measured ones.")
        name = with_unit(f"{group}/{channel.name}", channel.properties.get("unit_string"))
        n, kind, properties = len(channel), channel.dtype, channel.properties
        linear = kind.kind in "iuf" and _linear(properties)
        if kind.kind == "M":
            kind = np.dtype("<i8")
        elif properties.get("NI_Number_Of_Scales") and linear is None:
            kind = np.dtype("<f8")
        self._channels[name] = channel, linear is not None
        if linear:
            self._scales[name] = linear
            kind = np.dtype(channel.data_type.nptype)
        self._offer(name, (n,), kind)
        if name in self._lengths and "wf_increment" in properties:
            increments.add(float(properties["wf_increment"]))

    def _refuse_claims(self, name: str) -> None:
        self._refuse_size(name, self._lengths[name] * self._types[name].itemsize, self.path.stat().st_size)

    def _read(self, name: str, start: int, stop: int) -> NDArray[Any]:
        channel, raw = self._channels[name]
        try:
            values = channel.read_data(start, stop - start, scaled=not raw)
        except LIBRARY_ERRORS as error:
            raise InputError(f"{self.path}: {listed([name])} does not read ({error}).") from error
        if values.dtype.kind == "M":
            return np.asarray(values.astype("datetime64[ns]").astype(np.int64) / _TICKS_NS)
        return np.asarray(values)


def _linear(properties: Any) -> tuple[float, float] | None:
    """Slope and intercept where the one scale is linear; None where there is another, or none."""
    if int(properties.get("NI_Number_Of_Scales", 0)) != 1 or properties.get("NI_Scale[0]_Scale_Type") != "Linear":
        return None
    if properties.get("NI_Scaling_Status", "unscaled") == "scaled":
        return None
    return float(properties["NI_Scale[0]_Linear_Slope"]), float(properties["NI_Scale[0]_Linear_Y_Intercept"])
