"""Mass and size of balls by their names, from a table such as ``ball, weight (oz), circumference (cm)``."""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from daq.importers.tables import read_sheets
from daq.setup.errors import InputError

_KG = {"kg": 1.0, "g": 1e-3, "oz": 0.028349523, "lb": 0.45359237, "lbs": 0.45359237}
_M = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254, "inch": 0.0254}
_MASSES = {"mass": 1.0, "weight": 1.0}
_DIAMETERS = {"diameter": 1.0, "radius": 2.0, "circumference": 1.0 / np.pi, "girth": 1.0 / np.pi}


def read_balls(path: Path, balls: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Mass (kg) and diameter (m) of those ``balls`` that the table names.

    Raises `InputError` where there is no such file, or no heading of a mass or a size with its unit.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    rows = [row for row in read_sheets(path)[0].rows if len(row) >= 3]
    columns = [_column([str(cell).lower() for cell in rows[0]], *asked) for asked in ((_KG, _MASSES), (_M, _DIAMETERS))]
    known = [column for column in columns if column is not None]
    if len(known) < 2:
        raise InputError(
            f"{path}: expected a heading such as: ball, mass (g), diameter (mm); with weight, circumference, girth or "
            "radius instead, and kg, g, oz, lb, m, cm, mm or in"
        )
    named = {_plain(str(row[0])): row for row in rows[1:]}
    found = {}
    for ball in balls:
        numbered = [name for name in named if re.findall(r"\d+", name) == re.findall(r"\d+", _plain(ball))]
        # "wiffleball1" is "Whiffle Ball 1" at 0.8, but "softball" is no "Golf Ball"
        like = difflib.get_close_matches(_plain(ball), numbered, 1, 0.8)
        cells = [(named[name][j], factor) for name in like for j, factor in known if j < len(named[name])]
        numbers = [cell * factor for cell, factor in cells if isinstance(cell, float) and cell > 0.0]
        if len(numbers) == 2:
            found[ball] = (numbers[0], numbers[1])
    return found


def _column(head: list[str], units: dict[str, float], kinds: dict[str, float]) -> tuple[int, float] | None:
    """The first column of such a kind, and its factor to kilograms or to metres of diameter; None without a unit."""
    for j, heading in enumerate(head):
        words = re.findall(r"[a-z]+", heading)
        kind = next((kinds[word] for word in words if word in kinds), None)
        unit = next((units[word] for word in words[1:] if word in units), None)
        if kind is not None and unit is not None:
            return j, unit * kind
    return None


def _plain(name: str) -> str:
    return re.sub(r"[\W_]+", "", name).lower()
