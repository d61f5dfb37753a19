"""Units that a file states beside a column, put into the column's name where the importer finds them."""

from __future__ import annotations

from typing import Any

from daq.importers.formats.columns import ACCELERATION_UNITS, TIME_UNITS_S, VOLT_UNITS, split_name

_SPELLINGS = {"m/s²": "m/s^2", "m/s**2": "m/s^2", "gn": "g", "g_n": "g", "volts": "v", "microseconds": "us"}


def with_unit(name: str, unit: Any) -> str:
    """``name (unit)`` where the unit is one that is understood and the name states none."""
    text = str(unit or "").strip().lower()
    text = _SPELLINGS.get(text, text)
    known = text in TIME_UNITS_S or text in VOLT_UNITS or text in ACCELERATION_UNITS
    return f"{name} ({text})" if known and not split_name(name)[1] else name
