"""Closed loops that differ from another one."""

from __future__ import annotations

import dataclasses
from typing import Any

from analysis.loop.result import ClosedLoop


def changed(loop: ClosedLoop, **values: Any) -> ClosedLoop:
    """The loop with other values, those of its selection and of its errors under their own names."""
    for part in ("selection", "errors"):
        value = getattr(loop, part)
        own = {f.name: values.pop(f.name) for f in dataclasses.fields(value) if f.name in values}
        values[part] = dataclasses.replace(value, **own)
    return dataclasses.replace(loop, **values)
