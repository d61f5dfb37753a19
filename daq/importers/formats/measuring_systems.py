"""Files of measuring systems as tables, each through a package of its own: TDMS, MDF 3 and 4, universal files.

pyuff holds a file in memory several times over, so its size is limited.
"""

from __future__ import annotations

import re
import warnings
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.importers.formats.arrays import MOST_OBJECTS, ArraySource, refusals
from daq.importers.formats.columns import listed, with_unit
from daq.setup.errors import InputError, package
from kernels.arrays import Floats


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


class MdfSource(ArraySource):
    """Channels of every group in physical units, read by records; names carry the group where there are several."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        with package("asammdf", f"{path}: MDF needs"):
            from asammdf import MDF
            from asammdf.blocks.utils import MdfException
        handle = self._handle()
        head = handle.read(68)
        if head[:3] not in (b"MDF", b"UnF") or head[64:] not in (b"##HD", b"HD" + head[66:]):
            raise InputError(f"{path}: cannot be read as MDF: it does not begin as one.")
        self._damage = MdfException
        with refusals(path, "cannot be read as MDF", MdfException), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of other programs' files
            self._file: Any = MDF(handle)  # type: ignore[arg-type]
            for group in range(len(self._file.groups)):
                self._take(group)

    def _take(self, group: int) -> None:
        """Take the channels of a group that has values."""
        own, master = self._file.groups[group], self._file.masters_db.get(group)
        n = int(own.channel_group.cycles_nr)
        lead = f"group {group + 1}/" if len(self._file.groups) > 1 else ""
        for index, channel in enumerate(own.channels if n > 1 else ()):
            if len(self._columns) >= MOST_OBJECTS:
                raise InputError(f"{self.path}: holds more than {MOST_OBJECTS} channels; keep only the measured ones.")
            first = self._file.get(group=group, index=index, record_offset=0, record_count=1)
            name = f"{lead}time (s)" if index == master else with_unit(f"{lead}{channel.name}", first.unit)
            name = name if name not in self._columns else f"{name} {index}"
            self._offer(name, (n,), np.dtype(first.samples.dtype), partial(self._read, group, index))

    def _read(self, group: int, index: int, start: int, stop: int, column: int | None) -> NDArray[Any]:
        with refusals(self.path, f"rows {start + 1} to {stop} do not read", self._damage):
            part = self._file.get(group=group, index=index, record_offset=start, record_count=stop - start)
        return np.asarray(part.samples)


_MOST_MIB = 512  # of a file; in memory it is several times as large
_EXACT = re.compile(r"rate_hz=(\S+) first_sample=(\d+) time_ns=(-?\d+)")


class UffSource(ArraySource):
    """Time responses of a universal file: ``time_s`` and a column for each label, node and direction."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        if (size := path.stat().st_size >> 20) >= _MOST_MIB:
            raise InputError(
                f"{path}: has {size} MiB; a universal file is read into memory, and wanted is one of at most "
                f"{_MOST_MIB} MiB: split it by time, or export TDMS or HDF5 instead."
            )
        with package("pyuff", f"{path}: universal files need"):
            import pyuff
        try:
            found = pyuff.UFF(str(path)).read_sets()
        except Exception as error:  # pyuff raises the base class for everything
            raise InputError(f"{path}: cannot be read as a universal file ({error}).") from error
        sets = [
            s for s in (found if isinstance(found, list) else [found])
            if s.get("type") == 58 and s.get("func_type") in (0, 1) and s["data"] is not None
        ]  # fmt: skip
        if not sets:
            raise InputError(f"{path}: holds no data set 58 with a time response; export the time signals themselves.")
        if len(sets) > MOST_OBJECTS:
            raise InputError(f"{path}: holds more than {MOST_OBJECTS} data sets; keep only the measured ones.")
        parts: dict[str, list[tuple[Floats, Floats]]] = {}
        for name, one in zip(_names(sets), sets, strict=True):
            if np.iscomplexobj(one["data"]):
                raise InputError(f"{path}: {listed([name])} is complex; wanted a signal in time.")
            parts.setdefault(name, []).append((_seconds(one), np.asarray(one["data"], np.float64)))
        whole = {name: np.concatenate(own, axis=1) for name, own in parts.items()}
        first, (shared, _) = next(iter(whole.items()))
        for name, (seconds, _) in whole.items():
            if not np.array_equal(seconds, shared):
                raise InputError(
                    f"{path}: {listed([name])} ({len(seconds)} values) and {listed([first])} ({len(shared)}) were not "
                    "sampled at the same times; export them with one rate and one length."
                )
        self._hold({"time_s": shared} | {name: values for name, (_, values) in whole.items()})


def _names(sets: list[dict[str, Any]]) -> list[str]:
    """Label of each set; its node and direction are added where one label would mean several channels."""

    def bare(text: Any) -> str:
        stripped = str(text).strip()
        return "" if stripped.upper() == "NONE" else stripped

    places = [(bare(s["id1"]), s.get("rsp_node"), s.get("rsp_dir")) for s in sets]
    shared = {label for label, *_ in places if len({p for p in places if p[0] == label}) > 1} | {""}
    names = [f"{label or 'channel'} {node}:{way}" if label in shared else label for label, node, way in places]
    return [with_unit(n, bare(s.get("ordinate_axis_units_lab", ""))) for n, s in zip(names, sets, strict=True)]


def _seconds(one: dict[str, Any]) -> Floats:
    """Times of a set: exact where its text says the rate, else by the header's six digits, rounded to a whole rate."""
    n = len(one["data"])
    if not one["abscissa_spacing"]:
        return np.asarray(one["x"], np.float64)
    exact = _EXACT.search(str(one.get("id4", "")))
    if exact is not None:
        return np.asarray((int(exact[3]) + np.rint(np.arange(n) * (1e9 / float(exact[1])))) * 1e-9)
    step = float(one["abscissa_inc"])
    whole = round(1.0 / step) if step > 0 else 0
    # a number of six digits is rounded by as much
    if whole > 0 and abs(step * whole - 1.0) < 5.5e-6:
        step = 1.0 / whole
    return np.asarray(float(one["abscissa_min"]) + np.arange(n) * step)
