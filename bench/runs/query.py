"""Filter and order of the runs that are shown."""

from __future__ import annotations

import datetime
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from analysis.loop.verdict import VERDICTS
from daq.setup.errors import InputError

Row = dict[str, Any]

SORTS = {
    "date": "date", "name": "path", "profile": "profile", "c": "c", "gamma": "gamma_high", "steps": "steps",
    "length": "seconds", "lost": "lost_samples", "ended": "ended", "verdict": "", "note": "notes", "tags": "tags",
}  # fmt: skip
"""Words to sort by, and the column behind each; a verdict is in the row's loop."""
ENDS = ("complete", "stopped", "failed", "incomplete", "damaged")
FIRST_DATE = "0001-01-01T00:00:00"
WITH_NONE = (*VERDICTS, "none")


@dataclass(frozen=True)
class Query:
    """Conditions that a run must meet, all of them; None or empty: any."""

    profile: str = ""  # part of the profile's name
    c: int | None = None  # ratio of the tones
    gamma: tuple[float, float] | None = None  # range; a run is shown whose own range overlaps it
    tags: tuple[str, ...] = ()  # all of them
    verdict: str = ""  # one of `WITH_NONE`
    ended: str = ""  # one of `ENDS`
    since: str = ""  # date as ISO 8601, or the beginning of one
    until: str = ""  # the same; what begins so is included
    # every word of it occurs in the file's name, the profile, a note, a tag, the reason of an end or the
    # verdict
    text: str = ""
    lost: bool = False  # only runs that lost samples
    sort: str = "date"  # one of `SORTS`; after a minus: backwards
    limit: int = -1  # how many rows at most; -1: all

    def __post_init__(self) -> None:
        """Refuse words that are none of those known."""
        for option, value, known in (
            ("sort", self.sort.removeprefix("-"), tuple(SORTS)), ("verdict", self.verdict, ("", *WITH_NONE)),
            ("ended", self.ended, ("", *ENDS)),
        ):  # fmt: skip
            if value not in known:
                raise InputError(f"--{option} {value}: wanted one of {', '.join(filter(None, known))}")
        for option, value in (("since", self.since), ("until", self.until)):
            try:
                datetime.datetime.fromisoformat(value + FIRST_DATE[len(value) :])
            except ValueError as error:
                raise InputError(f"--{option} {value}: wanted a date, as 2026-11-20, or its beginning") from error

    def of(self, rows: Iterable[Row]) -> list[Row]:
        """The rows that meet the conditions, in the order asked for; what is not known comes last either way."""

        column, backwards = SORTS[self.sort.removeprefix("-")], self.sort.startswith("-")

        def key(row: Row) -> Any:
            return row[column] if column else _summary(row) or None

        found = sorted((row for row in rows if self._meets(row)), key=lambda row: row["path"], reverse=backwards)
        known = sorted((row for row in found if key(row) is not None), key=key, reverse=backwards)
        ordered = known + [row for row in found if key(row) is None]
        return ordered if self.limit < 0 else ordered[: self.limit]

    def _meets(self, row: Row) -> bool:
        """Whether a row meets every condition."""
        date = row["date"] or ""
        verdict = row["loop"]["verdict"] if row["loop"] else "none"
        texts = [row["path"], row["profile"] or "", row["notes"], " ".join(row["tags"]), row["why"], _summary(row)]
        low, high = row["gamma_low"], row["gamma_high"]
        return (
            self.profile.casefold() in (row["profile"] or "").casefold()
            and self.c in (None, row["c"])
            and (self.gamma is None or (low is not None and high >= self.gamma[0] and low <= self.gamma[1]))
            and set(self.tags) <= set(row["tags"])
            and self.verdict in ("", verdict)
            and self.ended in ("", row["ended"])
            and date >= self.since
            and (not self.until or "" < date[: len(self.until)] <= self.until)
            and (not self.lost or (row["lost_samples"] or 0) > 0)
            and all(any(word in text.casefold() for text in texts) for word in self.text.casefold().split())
        )


def _summary(row: Row) -> str:
    """The verdict in words; empty without one."""
    return str(row["loop"]["summary"]) if row["loop"] else ""
