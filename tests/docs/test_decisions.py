"""The record of decisions: every entry stands in its index."""

from __future__ import annotations

import re
from pathlib import Path

TEXT = (Path(__file__).parents[2] / "DECISIONS.md").read_text(encoding="utf-8")


def test_every_decision_stands_in_the_index() -> None:
    """Each entry has one row, with its number, its package and its title."""
    rows = re.findall(r"^\| (\d+) \| ([^|]+) \| ([^|]+) \| [^|]+ \|$", TEXT, re.MULTILINE)
    entries = re.findall(r"^## (\d+)\. (.+)\n\nPackage: ([^.]+)\.", TEXT, re.MULTILINE)
    assert len(entries) == len(re.findall(r"^## \d", TEXT, re.MULTILINE))
    wanted = [(number, package, title) for number, title, package in entries]
    numbers = {number for number, _, _ in wanted}
    assert [row for row in rows if row[0] in numbers] == wanted
