"""Universal files (data set 58, text or binary) as tables, through the package pyuff.

pyuff holds a file in memory several times over, so its size is limited. A channel may come in several sets, one for
each piece of time.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from daq.importers.formats.arrays import MOST_OBJECTS, ArraySource
from daq.importers.formats.columns import listed, with_unit
from daq.setup.errors import InputError, package
from kernels.arrays import Floats

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
