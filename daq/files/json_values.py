"""Values as JSON holds them: what every command, report and page writes for a machine. Decision 318."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def json_values(value: Any) -> Any:
    """A value as plain dictionaries, lists, texts and numbers; what is not a finite number is None.

    Dataclasses become dictionaries by their fields, whose names carry the units; arrays become lists, paths and dates
    texts. Anything else raises `TypeError`.

    Examples
    --------
    >>> json_values({"rms_us": float("nan"), "file": Path("run.h5"), "steps": (1, 2)})
    {'rms_us': None, 'file': 'run.h5', 'steps': [1, 2]}
    """
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return json_object(value)
    if isinstance(value, list | tuple):
        return [json_values(x) for x in value]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: json_values(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if hasattr(value, "tolist"):  # arrays and numbers of numpy
        return json_values(value.tolist())
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "isoformat"):
        return value.isoformat()
    raise TypeError(f"cannot write {type(value).__name__} as JSON")


def json_object(named: Mapping[str, Any]) -> dict[str, Any]:
    """Named values as `json_values` gives them."""
    return {str(key): json_values(x) for key, x in named.items()}


def json_text(payload: Any) -> str:
    """JSON as the commands write it, with a line feed at its end."""
    return json.dumps(json_values(payload), indent=1, allow_nan=False) + "\n"
