"""The notebook of a recording: notes from before, during and after the run, tags, and events changed by hand.

Notes made until the run was over stand in the recording. Later ones, tags and changed events (contact edges and impacts
moved, removed or added, in the order in which that was done) stand in a small file next to it, so that the recording
stays as it was sealed. Whatever finds flights reads them (`analysis.flights.assemble.flights_of`).
"""

from __future__ import annotations

import getpass
import json
import math
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, get_args

from daq.files.disk import write_whole
from daq.recording.header import Header, stored_id
from daq.recording.reader import Recording
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


ENDING = ".remarks.json"
FORMAT, VERSION = "shakerbench remarks", 2
LONGEST_TAG, LONGEST_NOTE = 64, 10_000


@dataclass(frozen=True)
class Note:
    """A note: when it was written (UTC, ISO 8601), and its text."""

    at: str
    text: str


@dataclass(frozen=True)
class Entry:
    """One entry of the notebook."""

    at: str  # when it was written (UTC, ISO 8601); empty where that is not known
    at_s: float | None  # recorded time before it, s; None for one that was written before or after the run
    text: str


@dataclass(frozen=True)
class Remarks:
    """Later notes and tags of a recording, and its events that were changed by hand."""

    # of the recording they were written for (`daq.recording.header.stored_id`); empty: whatever has its name
    identity: str = ""
    tags: tuple[str, ...] = ()  # in order, each once
    notes: tuple[Note, ...] = ()  # in the order they were written
    events: tuple[EventChange, ...] = ()  # in the order they were made


def entries_of(header: Header) -> tuple[Entry, ...]:
    """Entries of the recording itself: the note that the run was given, and those typed while it went on."""
    given = str(header.attrs.get("note") or "").strip()
    first = (Entry(str(header.attrs.get("started") or ""), None, given),) if given else ()
    typed = []
    for sample, unix_ns, text in header.notes:
        at = datetime.fromtimestamp(unix_ns / 1e9, UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
        typed.append(Entry(at, sample / header.rate_hz, text))
    return (*first, *typed)


def notebook(header: Header | None, later: Remarks) -> tuple[Entry, ...]:
    """All entries of a recording's notebook, in the order in which they were written.

    ``header`` is None where the recording does not read; ``later`` are notes since then.
    """
    own = () if header is None else entries_of(header)
    return (*own, *(Entry(note.at, None, note.text) for note in later.notes))


def as_line(entry: Entry) -> str:
    """An entry as a line of text: when, where in the run, and what."""
    where = "" if entry.at_s is None else f" ({entry.at_s:.2f} s)"
    return f"{entry.at[:16].replace('T', ' ')}{where}  {' '.join(entry.text.split())}".strip()


def as_text(header: Header | None, later: Remarks) -> str:
    """Tags and all entries as a text; empty where there is nothing."""
    tags = [f"tags: {' '.join(later.tags)}"] if later.tags else []
    lines = [*tags, *map(as_line, notebook(header, later))]
    return "\n".join(lines) + "\n" if lines else ""


def side_file(recording: Path) -> Path:
    """The file next to a recording that holds its tags and later notes."""
    return recording.with_name(recording.name + ENDING)


def read_remarks(path: Path) -> Remarks:
    """Tags and notes from the side file ``path``, none where there is none (raises InputError for anything else)."""
    try:
        if not path.exists():
            return Remarks()
        if path.stat().st_size > 4 << 20:
            raise ValueError(f"more than {4 << 20} bytes")
        stored = json.loads(path.read_text(encoding="utf-8"))
        if stored["format"] != FORMAT or stored["version"] > VERSION:
            raise ValueError(f"format {stored['format']!r}, version {stored['version']!r}")
        tags = tuple(str(tag) for tag in stored["tags"])
        notes = tuple(Note(str(note["at"]), str(note["text"])) for note in stored["notes"])
        events = tuple(map(from_json, stored.get("events", ())))
        return Remarks(str(stored["identity"]), tags, notes, events)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(
            f"{path}: wanted the tags and notes of a recording, version {VERSION} ({error}); mend it, or move it away"
        ) from error


def change_remarks(recording: Path, identity: str, change: Callable[[Remarks], Remarks]) -> Remarks:
    """Change tags and notes of a recording, one process at a time; ``change`` gives those that are to be.

    ``identity`` is the recording's as far as it is known. Raises `InputError` where the side file cannot be read or
    written or is of another recording, or ``change`` refuses.
    """
    path = side_file(recording)
    with _held(path.with_name(f"{path.name}.lock"), path):
        found = read_remarks(path)
        if identity and found.identity and identity != found.identity:
            raise InputError(
                f"{path}: holds tags, notes and events of another recording that had this name; move it away to begin "
                "with none"
            )
        changed = change(found)
        changed = replace(changed, identity=identity or changed.identity)
        stored = {"format": FORMAT, "version": VERSION, **asdict(changed)}
        try:  # whole or not at all; a file with nothing in it is removed
            if changed.tags or changed.notes or changed.events:
                write_whole(path, json.dumps(stored, indent=1, ensure_ascii=False) + "\n")
            else:
                path.unlink(missing_ok=True)
        except OSError as error:
            raise InputError(_unwritable(path, error)) from error
    return changed


@contextmanager
def _held(lock: Path, path: Path) -> Iterator[None]:
    """A file that only one process can make; one left behind by a process that died counts for five seconds."""
    # longest time to change a side file
    ends = time.monotonic() + 5.0
    while True:
        try:
            os.close(os.open(lock, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
            break
        except FileExistsError:
            if time.monotonic() > ends:
                lock.unlink(missing_ok=True)
            time.sleep(0.02)
        except OSError as error:
            raise InputError(_unwritable(path, error)) from error
    try:
        yield
    finally:
        lock.unlink(missing_ok=True)


def _unwritable(path: Path, error: OSError) -> str:
    return (
        f"{path}: cannot be written ({error.strerror or error}); tags and notes lie next to the recording: make its "
        "folder writable, or copy the recording to another"
    )


def with_tags(remarks: Remarks, tags: tuple[str, ...], *, remove: bool = False) -> Remarks:
    """Remarks with more tags, or fewer (raises InputError for what is no tag)."""
    checked = [tag.strip() for tag in tags]
    for tag in checked:
        if not tag or len(tag) > LONGEST_TAG or any(c.isspace() or c == "," or not c.isprintable() for c in tag):
            raise InputError(f"tag {tag!r}: wanted one word of at most {LONGEST_TAG} characters, without commas")
    if remove:
        return replace(remarks, tags=tuple(t for t in remarks.tags if t not in checked))
    return replace(remarks, tags=tuple(dict.fromkeys((*remarks.tags, *checked))))


def with_note(remarks: Remarks, text: str) -> Remarks:
    """Remarks with one more note, of this moment (raises InputError for an empty or endless one)."""
    text = text.strip()
    if not text or len(text) > LONGEST_NOTE:
        raise InputError(f"note: wanted 1 to {LONGEST_NOTE} characters, came {len(text)}")
    return replace(remarks, notes=(*remarks.notes, Note(now_utc(), text)))


def event_changes_of(recording: Recording) -> tuple[EventChange, ...]:
    """Events of an open recording that were changed by hand; none of another recording that had or has its name.

    As they change what is measured, an identity that is not known counts as another: changes made before a run was over
    are of none that is closed.

    Raises `InputError` where its side file does not read.
    """
    remarks = read_remarks(side_file(recording.path))
    return remarks.events if remarks.events and stored_id(recording) == remarks.identity else ()


def state_of(recording: Path) -> list[object]:
    """What a result from a file depends on: its place, size, time of change, and events changed by hand.

    Raises `OSError` or `InputError` where there is no such file, or its side file does not read.
    """
    state = recording.stat()
    events = read_remarks(side_file(recording)).events
    return [recording.resolve().as_posix(), state.st_size, state.st_mtime_ns, *events]


def with_event(remarks: Remarks, change: EventChange | None) -> Remarks:
    """Remarks with one more changed event; for None, without the last one (raises InputError)."""
    if change is None and not remarks.events:
        raise InputError("no event was changed by hand: there is nothing to take back")
    if len(remarks.events) >= MOST_CHANGES and change is not None:
        raise InputError(f"{MOST_CHANGES} events were changed by hand already; correct the detection instead")
    return replace(remarks, events=remarks.events[:-1] if change is None else (*remarks.events, change))


def without_last_note(remarks: Remarks) -> Remarks:
    """Remarks without the latest note (raises InputError where there is none)."""
    if not remarks.notes:
        raise InputError("there is no note to take back; the note that `bench ramp` was given stays in the recording")
    return replace(remarks, notes=remarks.notes[:-1])
