"""Small tables of text as rows of cells, whatever encoding, separator and decimal mark they came with. Decision 314."""

from __future__ import annotations

import csv
import re
from pathlib import Path

from daq.setup.errors import InputError

Cell = float | str

_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?")
_COMMA_GROUPED = re.compile(r"[+-]?\d{1,3}(,\d{3})+\.\d*")
_POINT_GROUPED = re.compile(r"[+-]?\d{1,3}([.' \u202f\xa0]\d{3})+,\d*")


def number_or_text(text: str) -> Cell:
    """A number if the whole cell is one, with point or comma; else the stripped text."""
    text = text.strip().strip('"').strip().replace("\N{MINUS SIGN}", "-")
    if _NUMBER.fullmatch(text):
        return float(text.replace(",", "."))
    if _COMMA_GROUPED.fullmatch(text):
        return float(text.replace(",", ""))
    if _POINT_GROUPED.fullmatch(text):
        return float(re.sub(r"[.' \u202f\xa0]", "", text).replace(",", "."))
    return text


def text_rows(path: Path) -> list[list[Cell]]:
    """Rows of a text table; blank lines and comments (``#``) are left out.

    Raises
    ------
    InputError
        The file is no text.
    """
    raw = path.read_bytes()
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        text = raw.decode("utf-16", errors="replace")
    elif b"\x00" in raw[:4096]:
        raise InputError(f"{path}: neither text nor a known spreadsheet, sound, video or recording; is it damaged?")
    else:
        try:
            text = raw.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = raw.decode("latin-1")
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    separator = _separator(lines)
    cut = [line.split() if separator is None else next(csv.reader([line], delimiter=separator)) for line in lines]
    return [[number_or_text(cell) for cell in row] for row in cut]


def _separator(lines: list[str]) -> str | None:
    """Tab, semicolon or comma, or None for spaces; a comma inside every number is its decimal mark."""
    body = [line for line in lines if re.match(r"\s*[\"+\-.,\d]", line)] or lines
    for mark in ("\t", ";"):
        if sum(mark in line for line in body) > 0.5 * len(body):
            return mark
    tokens = [line.replace('"', " ").split() for line in body]
    plain = sum(all(_NUMBER.fullmatch(token) or token == "*" for token in row) for row in tokens)
    several = sum(len(row) > 1 for row in tokens)
    commas = sum("," in line for line in body)
    headed = any("," in line for line in lines if line not in body)
    if commas > 0.5 * len(body) and (plain < 0.5 * len(body) or (several < 0.5 * len(body) and headed)):
        return ","
    if several > 0.5 * len(body):
        return None
    return "," if commas > 0.5 * len(body) and (headed or plain < len(body)) else "\t"
