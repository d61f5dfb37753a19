"""TDMS files of LabVIEW and DIAdem as tables, read piece by piece (package npTDMS)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.importers.formats.arrays import MOST_OBJECTS, ArraySource, refusals
from daq.importers.formats.columns import with_unit
from daq.setup.errors import InputError, package


class TdmsSource(ArraySource):
    """Channels of every group, ``group/channel``; codes with one linear scale stay codes.

    The rate is that of the waveforms' increment where all channels agree. A channel of time stamps is nanoseconds.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        with package("npTDMS", f"{path}: TDMS needs"):
            from nptdms import TdmsFile
            from nptdms.types import TimeStamp
        self._time_stamp = TimeStamp
        increments_s: set[float] = set()
        with refusals(path, "cannot be read as TDMS"):
            channels = [
                (group.name, c)
                for group in TdmsFile.open(self._handle(), raw_timestamps=True).groups()
                for c in group.channels()
            ]
            if len(channels) > MOST_OBJECTS:
                raise InputError(f"{path}: holds more than {MOST_OBJECTS} channels; keep only the measured ones.")
            for group, channel in channels:
                self._take(group, channel, increments_s)
        if not self._columns:
            raise InputError(f"{path}: cannot be read as TDMS: it holds no channel of numbers.")
        if len(increments_s) == 1 and (step_s := increments_s.pop()) > 0:
            rate_hz = 1.0 / step_s
            whole = round(rate_hz)  # taken where the increment is its reciprocal in double precision
            self.rate_hz = float(whole) if whole > 0 and abs(rate_hz / whole - 1.0) < 1e-14 else rate_hz

    def _take(self, group: str, channel: Any, increments_s: set[float]) -> None:
        """Take a channel, as codes where its one scale is linear."""
        kind, properties, is_stamp = channel.dtype, channel.properties, channel.data_type is self._time_stamp
        name = with_unit(f"{group}/{channel.name}", "ns" if is_stamp else properties.get("unit_string"))
        scales = int(properties.get("NI_Number_Of_Scales", 0))
        is_linear = kind.kind in "iuf" and scales == 1 and properties.get("NI_Scale[0]_Scale_Type") == "Linear"
        is_linear = is_linear and properties.get("NI_Scaling_Status", "unscaled") != "scaled"
        scale = (1.0, 0.0)
        if is_linear:
            keys = ("NI_Scale[0]_Linear_Slope", "NI_Scale[0]_Linear_Y_Intercept")
            scale, kind = (float(properties[keys[0]]), float(properties[keys[1]])), np.dtype(channel.data_type.nptype)
        elif is_stamp:
            kind = np.dtype("<i8")
        elif scales:
            kind = np.dtype("<f8")

        def read(start: int, stop: int, column: int | None) -> NDArray[Any]:
            values = channel.read_data(start, stop - start, scaled=not is_linear)
            return np.asarray(values.as_datetime64("ns") if is_stamp else values)

        self._offer(name, (len(channel),), kind, read, scale=scale)
        if name in self._columns and "wf_increment" in properties:
            increments_s.add(float(properties["wf_increment"]))
