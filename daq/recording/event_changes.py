"""Events that a person corrected: contact edges and impacts that were moved, removed or added by hand.

They stand in the side file of the recording's tags and notes, in the order in which they were made; the recording
stays as it was sealed. Whatever finds flights reads them (`analysis.flights.assemble.flights_of`).
"""

from __future__ import annotations

import getpass
import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

from daq.setup.clock import now_utc
from daq.setup.errors import InputError

Kind = Literal["takeoff", "landing", "impact"]
MOST_CHANGES = 10_000
BY_HAND = "changed by hand"
"""Words of every sentence that says so."""


@dataclass(frozen=True)
class EventChange:
    """One event that was moved, removed (``now_s`` is None) or added (``was_s`` is None)."""

    kind: Kind  # take-off and landing are edges of the contact circuit, an impact is one in the accelerometer
    was_s: float | None  # its time before, on the recording's axis
    now_s: float | None  # its time after
    at: str = ""  # when it was changed (UTC, ISO 8601)
    by: str = ""  # by whom

    def __post_init__(self) -> None:
        """Refuse what is no change; raises `InputError`."""
        times = [t for t in (self.was_s, self.now_s) if t is not None]
        if self.kind not in get_args(Kind) or not times or not all(math.isfinite(t) and t >= 0.0 for t in times):
            raise InputError(
                f"event {self.kind!r} from {self.was_s!r} to {self.now_s!r} s: wanted one of "
                f"{', '.join(get_args(Kind))}, and at least one time of 0 s or later"
            )


def made_now(kind: Kind, was_s: float | None, now_s: float | None) -> EventChange:
    """A change of this moment by the person whose account runs the program (raises InputError for none)."""
    try:
        by = getpass.getuser()
    except (OSError, KeyError, ImportError):  # an account without a name
        by = ""
    return EventChange(kind, was_s, now_s, now_utc(), by)


def from_json(stored: Any) -> EventChange:
    """A change from its JSON; raises ValueError, KeyError or TypeError for anything else, InputError for no change."""
    was_s, now_s = (None if stored[key] is None else float(stored[key]) for key in ("was_s", "now_s"))
    return EventChange(stored["kind"], was_s, now_s, str(stored["at"]), str(stored["by"]))


def in_words(changes: tuple[EventChange, ...]) -> tuple[str, ...]:
    """One sentence on the changes: how many of which sort, the last by whom and when; none where there are none."""
    if not changes:
        return ()
    moved = sum(one.was_s is not None and one.now_s is not None for one in changes)
    removed = sum(one.now_s is None for one in changes)
    sorts = ((moved, "moved"), (removed, "removed"), (len(changes) - moved - removed, "added"))
    n, last = len(changes), changes[-1]
    return (
        f"{n} event{'s were' if n > 1 else ' was'} {BY_HAND} ({', '.join(f'{k} {word}' for k, word in sorts if k)}), "
        f"the last{f' by {last.by}' if last.by else ''} on {last.at[:19].replace('T', ' ')} UTC",
    )
