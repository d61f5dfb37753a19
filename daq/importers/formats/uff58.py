"""Universal files (data set 58, text or binary) as tables, through the package pyuff.

pyuff holds a file in memory several times over, so its size is limited. A channel may come in several sets, one for
each piece of time.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from daq.importers.formats.arrays import MOST_OBJECTS, HeldSource
from daq.importers.formats.columns import listed, with_unit
from daq.setup.errors import InputError
from kernels.arrays import Floats

MOST_BYTES = 512 << 20  # of a file; in memory it is several times as large
HALF_DIGIT = 5.5e-6  # relative rounding of a number of six digits
_EXACT = re.compile(r"rate_hz=(\S+) first_sample=(\d+) time_ns=(-?\d+)")


class UffSource(HeldSource):
    """Time responses of a universal file: ``time_s`` and a column for each label, node and direction."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        size = path.stat().st_size
        if size > MOST_BYTES:
            raise InputError(
                f"{path}: has {size >> 20} MiB; a universal file is read into memory, and wanted is one of at most "
                f"{MOST_BYTES >> 20} MiB: split it by time, or export TDMS or HDF5 instead."
            )
        sets = [
            s for s in _sets(path) if s.get("type") == 58 and s.get("func_type") in (0, 1) and s["data"] is not None
        ]
        if not sets:
            raise InputError(f"{path}: holds no data set 58 with a time response; export the time signals themselves.")
        if len(sets) > MOST_OBJECTS:
            raise InputError(f"{path}: holds more than {MOST_OBJECTS} data sets; keep only the measured ones.")
        columns: dict[str, list[Floats]] = {}
        times: dict[str, list[Floats]] = {}
        for name, one in zip(_names(sets), sets, strict=True):
            if np.iscomplexobj(one["data"]):
                raise InputError(f"{path}: {listed([name])} is complex; wanted a signal in time.")
            columns.setdefault(name, []).append(np.asarray(one["data"], np.float64))
            times.setdefault(name, []).append(_seconds(one))
        self._hold(self._joined(columns, times))

    def _joined(self, columns: dict[str, list[Floats]], times: dict[str, list[Floats]]) -> dict[str, Floats]:
        """Every column whole, with one time for all."""
        whole = {name: np.concatenate(parts) for name, parts in columns.items()}
        seconds = {name: np.concatenate(parts) for name, parts in times.items()}
        first, shared = next(iter(seconds.items()))
        for name, own in seconds.items():
            if len(own) != len(shared) or not np.array_equal(own, shared):
                raise InputError(
                    f"{self.path}: {listed([name])} ({len(own)} values) and {listed([first])} ({len(shared)}) were not "
                    "sampled at the same times; export them with one rate and one length."
                )
        return {"time_s": shared, **whole}


def _sets(path: Path) -> list[dict[str, Any]]:
    try:
        import pyuff
    except ImportError as error:
        raise InputError(
            f"{path}: universal files need the package pyuff: pip install pyuff, or "
            "pip install 'shakerbench[interchange]'"
        ) from error
    try:
        found = pyuff.UFF(str(path)).read_sets()
    except Exception as error:  # pyuff raises the base class for everything
        raise InputError(f"{path}: cannot be read as a universal file ({error}).") from error
    return [found] if isinstance(found, dict) else list(found)


def _names(sets: list[dict[str, Any]]) -> list[str]:
    """Label of each set; its node and direction are added where a label alone would mean several channels."""
    places = [(_text(s["id1"]), s.get("rsp_node"), s.get("rsp_dir")) for s in sets]
    shared = {label for label, *_ in places if len({p for p in places if p[0] == label}) > 1}
    names = [
        f"{label or 'channel'} {node}:{way}" if label in shared or not label else label for label, node, way in places
    ]
    return [with_unit(n, _text(s.get("ordinate_axis_units_lab", ""))) for n, s in zip(names, sets, strict=True)]


def _text(text: Any) -> str:
    stripped = str(text).strip()
    return "" if stripped.upper() == "NONE" else stripped


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
    if whole > 0 and abs(step * whole - 1.0) < HALF_DIGIT:
        step = 1.0 / whole
    return np.asarray(float(one["abscissa_min"]) + np.arange(n) * step)
