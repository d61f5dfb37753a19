"""MDF files (versions 3 and 4) of measuring systems as tables, through the package asammdf."""

from __future__ import annotations

import warnings
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.importers.formats.arrays import MOST_OBJECTS, ArraySource, refusals
from daq.importers.formats.columns import with_unit
from daq.setup.errors import InputError, package


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
