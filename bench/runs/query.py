"""Filter and order of the runs that are shown."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from typing import Any

from analysis.loop.verdicts import VERDICTS
from daq.setup.errors import InputError

SORTS = {
    "date": "date", "name": "path", "profile": "profile", "c": "c", "gamma": "gamma_high", "steps": "steps",
    "length": "seconds", "lost": "lost_samples", "ended": "ended", "verdict": "summary", "note": "shown_note",
    "tags": "tags",
}  # fmt: skip
"""Keys to sort by, and the expressions behind them."""
ENDS = ("complete", "stopped", "failed", "incomplete", "damaged")
FIRST_DATE = "0001-01-01T00:00:00"
WITH_NONE = (*VERDICTS, "none")


@dataclass(frozen=True)
class Query:
    """Conditions that a run must meet, all of them; None or empty: any.

    Attributes
    ----------
    profile
        Part of the profile's name.
    c
        Ratio of the tones.
    gamma
        Range; a run is shown whose own range overlaps it.
    tags
        All of them.
    verdict, ended
        One of `WITH_NONE`, of `ENDS`.
    since, until
        Dates as ISO 8601, or the beginning of one; ``until`` includes what begins so.
    text
        Every word of it occurs in the file's name, the profile, a note, a tag, the reason of an end or the verdict.
    lost
        Only runs that lost samples.
    sort, backwards, limit, offset
        One of `SORTS`; how many rows, from which on.
    """

    profile: str = ""
    c: int | None = None
    gamma: tuple[float, float] | None = None
    tags: tuple[str, ...] = ()
    verdict: str = ""
    ended: str = ""
    since: str = ""
    until: str = ""
    text: str = ""
    lost: bool = False
    sort: str = "date"
    backwards: bool = False
    limit: int = -1
    offset: int = 0

    def __post_init__(self) -> None:
        """Refuse words that are none of those known."""
        for option, value, known in (
            ("sort", self.sort, tuple(SORTS)), ("verdict", self.verdict, ("", *WITH_NONE)),
            ("ended", self.ended, ("", *ENDS)),
        ):  # fmt: skip
            if value not in known:
                raise InputError(f"--{option} {value}: wanted one of {', '.join(filter(None, known))}")
        for option, value in (("since", self.since), ("until", self.until)):
            try:
                datetime.datetime.fromisoformat(value + FIRST_DATE[len(value) :])
            except ValueError as error:
                raise InputError(f"--{option} {value}: wanted a date, as 2026-11-20, or its beginning") from error


BASE = """
SELECT runs.*, coalesce(remarks.tags, '') AS tags, coalesce(remarks.note, '') AS later_notes,
  coalesce(remarks.problem, '') AS remarks_problem,
  trim(runs.notes || char(10) || coalesce(remarks.note, ''), char(10)) AS shown_note,
  loops.verdict AS verdict, loops.summary AS summary, loops.together AS together, loops.before_us AS before_us,
  loops.after_us AS after_us, loops.floor_us AS floor_us, loops.path AS loop_path
FROM runs
LEFT JOIN remarks ON remarks.run = runs.path
  AND (remarks.identity = '' OR runs.identity = '' OR remarks.identity = runs.identity)
LEFT JOIN loops ON runs.identity <> '' AND loops.rowid = (
  SELECT l.rowid FROM loops AS l WHERE l.identity = runs.identity ORDER BY l.at DESC, l.path LIMIT 1)
"""


def sql(query: Query) -> tuple[str, list[Any]]:
    """The statement of a query, and its values."""
    where: list[str] = []
    values: list[Any] = []

    def add(condition: str, *given: Any) -> None:
        where.append(condition)
        values.extend(given)

    if query.profile:
        add("profile LIKE ? ESCAPE '\\'", _part(query.profile))
    if query.c is not None:
        add("c = ?", query.c)
    if query.gamma is not None:
        add("gamma_high >= ? AND gamma_low <= ?", *query.gamma)
    for tag in query.tags:
        add("instr(' ' || tags || ' ', ' ' || ? || ' ') > 0", tag)
    if query.verdict:
        add("verdict IS NULL") if query.verdict == "none" else add("verdict = ?", query.verdict)
    if query.ended:
        add("ended = ?", query.ended)
    if query.since:
        add("date >= ?", query.since)
    if query.until:
        add("substr(date, 1, ?) <= ?", len(query.until), query.until)
    if query.lost:
        add("lost_samples > 0")
    for word in query.text.split():
        fields = ("path", "profile", "shown_note", "tags", "why", "coalesce(summary, '')")
        add("(" + " OR ".join(f"{f} LIKE ? ESCAPE '\\'" for f in fields) + ")", *[_part(word)] * len(fields))
    order = SORTS[query.sort]
    direction = "DESC" if query.backwards else "ASC"
    text = f"SELECT * FROM ({BASE})" + (f" WHERE {' AND '.join(where)}" if where else "")
    text += f" ORDER BY {order} IS NULL, {order} {direction}, path {direction} LIMIT ? OFFSET ?"
    return text, [*values, query.limit, query.offset]


def _part(text: str) -> str:
    """Pattern of texts that hold this one."""
    escaped = text.replace("\\", "\\\\").replace("%", "\\%").replace("_", "\\_")
    return f"%{escaped}%"
