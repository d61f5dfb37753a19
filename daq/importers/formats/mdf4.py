"""MDF files (versions 3 and 4) of measuring systems as tables, through the package asammdf."""

from __future__ import annotations

import warnings
import weakref
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daq.importers.formats.arrays import LIBRARY_ERRORS, MOST_OBJECTS, ArraySource
from daq.importers.formats.columns import with_unit
from daq.setup.errors import InputError


class MdfSource(ArraySource):
    """Channels of every group in physical units, read by records; names carry the group where there are several."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        try:
            from asammdf import MDF
            from asammdf.blocks.utils import MdfException
        except ImportError as error:
            raise InputError(
                f"{path}: MDF needs the package asammdf: pip install asammdf, or pip install 'shakerbench[interchange]'"
            ) from error
        self._errors = (*LIBRARY_ERRORS, MdfException)
        self._places: dict[str, tuple[int, int]] = {}
        handle = path.open("rb")
        head = handle.read(68)
        if head[:3] not in (b"MDF", b"UnF") or head[64:] not in (b"##HD", b"HD" + head[66:]):
            handle.close()
            raise InputError(f"{path}: cannot be read as MDF: it does not begin as one.")
        weakref.finalize(self, handle.close)  # neither the library nor a source closes it
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of other programs' files
                self._file: Any = MDF(handle)
                for group in range(len(self._file.groups)):
                    self._take(group)
        except self._errors as error:
            if isinstance(error, InputError):
                raise
            handle.close()
            raise InputError(f"{path}: cannot be read as MDF ({error}).") from error

    def _take(self, group: int) -> None:
        own = self._file.groups[group]
        master = self._file.masters_db.get(group)
        n = int(own.channel_group.cycles_nr)
        lead = f"group {group + 1}/" if len(self._file.groups) > 1 else ""
        for index, channel in enumerate(own.channels):
            if len(self._places) >= MOST_OBJECTS:
                raise InputError(f"{self.path}: holds more than {MOST_OBJECTS} channels; keep only the measured ones.")
            if n < 2:
                continue
            first = self._signal(group, index, 0, 1)
            name = f"{lead}time (s)" if index == master else with_unit(f"{lead}{channel.name}", first.unit)
            name = name if name not in self._places else f"{name} {index}"
            self._places[name] = group, index
            self._offer(name, (n,), np.dtype(first.samples.dtype))

    def _signal(self, group: int, index: int, start: int, count: int) -> Any:
        return self._file.get(group=group, index=index, record_offset=start, record_count=count)

    def _refuse_claims(self, name: str) -> None:
        self._refuse_size(name, self._lengths[name] * self._types[name].itemsize, self.path.stat().st_size)

    def _read(self, name: str, start: int, stop: int) -> NDArray[Any]:
        try:
            return np.asarray(self._signal(*self._places[name], start, stop - start).samples)
        except self._errors as error:
            raise InputError(f"{self.path}: rows {start + 1} to {stop} do not read: {error}") from error
