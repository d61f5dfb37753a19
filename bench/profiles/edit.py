"""Write measured values into a profile's file.

The rule kept here: only the values named change; comments, order and everything else of the file stay as they are, and
a file that would no longer be a profile is not written.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Sequence
from pathlib import Path

import tomlkit
from tomlkit.items import InlineTable, Table

from bench.jobs.calibrate import Measured
from daq.recording.whole_file import whole
from rig.profile import parse_profile


def write_into(path: Path, measured: Sequence[Measured], on: datetime.date) -> None:
    """Put each value, with uncertainty, date and source, at its dotted key in the profile ``path``.

    Raises
    ------
    InputError
        When the file would not be a profile any more; it is left as it was.
    OSError
        When it cannot be read or written.
    """
    document = tomlkit.parse(path.read_bytes().decode("utf-8"))
    for one in measured:
        *tables, key = one.key.split(".")
        table: Table | tomlkit.TOMLDocument = document
        for depth, name in enumerate(tables):
            if name not in table:
                table[name] = tomlkit.table(is_super_table=depth + 1 < len(tables))
            table = table[name]
        table[key] = _quantity(one, on)
    text = tomlkit.dumps(document)
    parse_profile(text, str(path))
    with whole(path) as part:
        part.write_bytes(text.encode("utf-8"))


def _quantity(one: Measured, on: datetime.date) -> InlineTable:
    """An inline table, value and uncertainty rounded to what is known of them."""
    item = tomlkit.inline_table()
    places = 1 - math.floor(math.log10(one.uncertainty)) if one.uncertainty > 0.0 else 12
    item["value"], item["uncertainty"] = round(one.value, places + 1), round(one.uncertainty, places)
    item["date"], item["source"] = on, one.source
    return item
