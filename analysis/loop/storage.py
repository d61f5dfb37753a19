"""Closed loops on disk: one HDF5 file, the arrays as datasets and everything else as one JSON text.

One file cannot lose its other half as JSON with an NPZ can, and HDF5 is the format of the recordings. A loaded result
equals the saved one: floats are written with all their digits, and the types of the result say how to read each value.
"""

from __future__ import annotations

import dataclasses
import json
import math
import types
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import h5py
import numpy as np
from pydantic import BaseModel, ValidationError

from analysis.loop.result import ClosedLoop
from daq.files.disk import disk_file
from daq.files.whole_file import whole
from daq.setup.errors import InputError

FORMAT, VERSION = "shakerbench closed loop", 3


def save_verdict(loop: ClosedLoop, path: Path) -> None:
    """Write a closed loop to the file ``path``; raises `InputError` where the file cannot be written."""
    arrays: dict[str, np.ndarray] = {}
    tree = _plain(loop, "", arrays)
    try:
        with whole(path) as part, disk_file(part) as disk, h5py.File(disk, "w") as file:
            file.attrs.update(format=FORMAT, version=VERSION)
            file["values"] = json.dumps(tree)
            for place, array in arrays.items():
                file.create_dataset(place, data=array)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error}); name a file in a folder you can write to") from error


def is_verdict(path: Path) -> bool:
    """Whether a file was written by `save_verdict`, of any version."""
    try:
        with h5py.File(path, "r") as file:
            return bool(file.attrs.get("format") == FORMAT)
    except OSError:
        return False


def load_verdict(path: Path) -> ClosedLoop:
    """Read a closed loop that `save_verdict` wrote.

    Raises `InputError` where the file holds none, or one of another version.
    """
    wanted = f"wanted a closed loop written by save_verdict, version {VERSION}"
    try:
        with h5py.File(path, "r") as file:
            found = file.attrs.get("format"), file.attrs.get("version")
            if found != (FORMAT, VERSION):
                raise InputError(f"{path}: {wanted}, found format {found[0]!r}, version {found[1]!r}")
            loop: ClosedLoop = _value(ClosedLoop, json.loads(file["values"][()]), file)
    except (OSError, KeyError, TypeError, ValueError, ValidationError) as error:
        raise InputError(f"{path}: {wanted} ({error}); save it again") from error
    return loop


def _plain(value: Any, place: str, arrays: dict[str, np.ndarray]) -> Any:
    """JSON values of a value; arrays go to ``arrays``, by their place in the result."""
    if isinstance(value, np.ndarray):
        arrays[place] = value
        return {"array": place}
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    if dataclasses.is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name), f"{place}/{f.name}", arrays) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {key: _plain(x, f"{place}/{key}", arrays) for key, x in value.items()}
    if isinstance(value, tuple):
        return [_plain(x, f"{place}/{i}", arrays) for i, x in enumerate(value)]
    if isinstance(value, float) and not math.isfinite(value):
        return str(float(value))  # "nan" and "inf" are no JSON numbers
    return value.item() if isinstance(value, np.generic) else value


def _value(kind: Any, tree: Any, file: h5py.File) -> Any:
    """Value of the type ``kind`` from its JSON values."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return None if tree is None else _value(next(k for k in inner if k is not type(None)), tree, file)
    if origin is np.ndarray:
        return file[tree["array"]][()]
    if origin is tuple:
        kinds = inner[:1] * len(tree) if inner[1:] == (Ellipsis,) else inner
        return tuple(_value(k, x, file) for k, x in zip(kinds, tree, strict=True))
    if origin is not None and origin is not Literal and issubclass(origin, Mapping):
        return {key: _value(inner[1], x, file) for key, x in tree.items()}
    if dataclasses.is_dataclass(kind):
        hints = get_type_hints(kind)
        there = [f.name for f in dataclasses.fields(kind) if f.name in tree or f.default is dataclasses.MISSING]
        return kind(**{name: _value(hints[name], tree[name], file) for name in there})  # type: ignore[operator]
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return kind.model_validate(tree)
    return float(tree) if kind is float else tree
