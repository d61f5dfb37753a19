"""The catalogue of a folder: what its files hold, in memory and in one JSON file that is replaced whole. Decision 400.

All in it is made from the files, each known by its size and time of change: what another process does not find in the
JSON file it reads again. A file of a newer version is left as it is, a damaged one is made anew.
"""

from __future__ import annotations

import contextlib
import datetime
import json
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from analysis.loop.verdict import VERDICTS
from bench.outputs import probe
from bench.runs.folder import PLACE, Found, files_below, run_of, stated_quantities
from daq.files.disk import write_whole
from daq.files.json_values import json_values
from daq.recording.header import Header, read_headers
from daq.recording.notebook import ENDING, Entry, Remarks, change_remarks, notebook, read_remarks, side_file
from daq.recording.opening import in_subprocess
from daq.setup.errors import InputError

VERSION = 4

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
    text: str = ""  # words, each in the file's name, the profile, a note, a tag, the reason of an end or the verdict
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


class Catalogue:
    """The runs below ``folder`` (else `InputError`). Any number of processes and threads may use it at once.

    With ``anew`` it is made from the files: it is empty here, and unchanged for others, until `update` is done. Its
    file is ``path``, None where it is only in memory; ``said`` is what a person should know of that, in a sentence, or
    empty.
    """

    def __init__(self, folder: Path, *, anew: bool = False) -> None:
        if not folder.is_dir():
            raise InputError(f"{folder}: wanted the folder of the recordings; there is none of that name")
        self.folder = folder.resolve()
        path = self.folder / PLACE / "runs.json"
        self.path: Path | None = path
        self.said = ""
        self._files: dict[str, dict[str, Any]] = {}  # by path below the folder
        self._seen: tuple[int, ...] = ()  # state of the catalogue's file when it was read or written
        self._anew = False
        self._lock, self._updating = threading.RLock(), threading.RLock()
        self._take_in()
        try:
            path.parent.mkdir(exist_ok=True)
            probe(path.parent)
        except OSError as error:
            why = error.strerror or error
            self.path = None
            self.said = f"{path}: cannot be written ({why}); the catalogue is in memory for this call"
        if anew:
            self._files, self._anew = {}, True

    def update(self, *, all_bytes: bool = False, progress: Callable[[str, float], None] | None = None) -> int:
        """Read files that are new, changed or (``all_bytes``) not compared whole, and forget those gone; how many."""
        found = {file.path: file for file in files_below(self.folder)}
        with self._updating:
            self._take_in()
            with self._lock:
                gone = self._files.keys() - found.keys()
                for path in gone:
                    del self._files[path]
                changed = []
                for file in found.values():
                    entry = self._files.get(file.path)
                    is_new = entry is None or (entry["size"], entry["mtime_ns"]) != (file.size, file.mtime_ns)
                    # known, but of a recording whose bytes were not all compared yet
                    if is_new or (all_bytes and entry and "run" in entry and not entry["run"]["all_bytes"]):
                        changed.append(file)
            saved = time.monotonic()
            for done, (file, entry) in enumerate(self._read(changed, all_bytes=all_bytes), start=1):
                with self._lock:
                    self._files[file.path] = _plain(entry | {"size": file.size, "mtime_ns": file.mtime_ns})
                if progress is not None:
                    progress("reading recordings", done / len(changed))
                # a reading of many recordings that is broken off goes on from here
                if time.monotonic() - saved > 10.0:
                    self._save()
                    saved = time.monotonic()
            if changed or gone or self._anew:
                self._anew = False
                self._save()
        return len(changed)

    def runs(self, query: Query | None = None) -> list[Row]:
        """Rows (`bench.runs.folder.run_of`) that a query asks for, with ``tags``, ``notes`` and the latest ``loop``."""
        with self._lock:
            self._take_in()
            loops = self._loops()
            rows = [self._row(entry["run"], loops) for entry in self._files.values() if "run" in entry]
        return (query or Query()).of(rows)

    def run(self, id: str) -> Row | None:
        """The run of that short name; None where there is none."""
        with self._lock:
            self._take_in()
            found = (entry["run"] for entry in self._files.values() if "run" in entry and entry["run"]["id"] == id)
            return next((self._row(run, self._loops()) for run in found), None)

    def counts(self) -> dict[str, list[str]]:
        """Profiles and tags that occur."""
        rows = self.runs()
        return {
            "profiles": sorted({row["profile"] for row in rows if row["profile"]}),
            "tags": sorted({tag for row in rows for tag in row["tags"]}),
        }

    def loops(self, identity: str) -> list[Row]:
        """Verdicts on the recording of that identity, the latest first."""
        with self._lock:
            return self._loops().get(identity, []) if identity else []

    def quantities(self, ids: Sequence[str] = ()) -> list[Row]:
        """Calibrations and effects by date, as profiles state and the latest verdicts fit them; of all or some runs."""
        with self._lock:
            loops, entries = self._loops(), [entry for entry in self._files.values() if "run" in entry]
        out: list[Row] = []
        fitted: list[Row] = []
        for entry in entries:
            run = entry["run"]
            if run["date"] is None or (ids and run["id"] not in ids):
                continue
            about = {name: run[name] for name in ("id", "path", "date")}
            verdicts = loops.get(run["identity"], [])[:1] if run["identity"] else []
            own = [about | q for q in (*entry["quantities"], *(q for loop in verdicts for q in loop["quantities"]))]
            out += own
            # the sensitivity by a verdict: as stated, times the factor by which the accelerometer reads too much
            stated = next((q for q in own if q["name"] == "accelerometer.sensitivity"), None)
            for q in own:
                if stated is not None and q["name"] == "accelerometer_gain.relative" and q["origin"] == "verdict":
                    value = stated["value"] * (1.0 + q["value"])
                    sigma = None if q["sigma"] is None else abs(stated["value"]) * q["sigma"]
                    fitted.append(stated | {"value": value, "sigma": sigma, "origin": "verdict"})
        return sorted(out, key=lambda q: (q["name"], q["date"])) + sorted(fitted, key=lambda q: q["date"])

    def file_of(self, row: Row) -> Path:
        """The file of a run, never one outside the folder; raises `InputError` where it is gone, or leads elsewhere."""
        try:
            path = self.folder.joinpath(str(row["path"])).resolve(strict=True)
        except (OSError, RuntimeError) as error:
            raise InputError(f"{row['path']}: is no longer there") from error
        if not path.is_relative_to(self.folder):
            raise InputError(f"{row['path']}: lies outside the runs' folder")
        return path

    def notebook(self, row: Row) -> tuple[Entry, ...]:
        """All notes of a run, from its file and its side file (raises InputError)."""
        found = [header for _, header in read_headers([self.file_of(row)]) if isinstance(header, Header)]
        return notebook(found[0] if found else None, self.remarks(row))

    def remarks(self, row: Row) -> Remarks:
        """Tags, later notes and changed events of a run, from its side file (raises InputError)."""
        return read_remarks(side_file(self.file_of(row)))

    def change_remarks(self, row: Row, change: Callable[[Remarks], Remarks]) -> Remarks:
        """Change tags and notes of a run in its side file, one process at a time (raises `InputError`)."""
        changed = change_remarks(self.file_of(row), row["identity"], change)
        name = row["path"] + ENDING
        with self._lock:
            self._take_in()
            self._files.pop(name, None)
            with contextlib.suppress(FileNotFoundError):
                state = (self.folder / name).stat()
                about = {"size": state.st_size, "mtime_ns": state.st_mtime_ns}
                self._files[name] = _plain(self._remarks(name) | about)
            self._save()
        return changed

    def _read(self, changed: Iterable[Found], *, all_bytes: bool) -> Iterator[tuple[Found, dict[str, Any]]]:
        """What files hold, as they are read."""
        files = {self.folder / file.path: file for file in changed}
        for file in files.values():
            if file.kind == "remarks":
                yield file, self._remarks(file.path)
        hdf5 = [path for path, file in files.items() if file.kind == "hdf5"]
        for path, header in read_headers(hdf5, all_bytes=all_bytes):
            entry: dict[str, Any] = {}
            if isinstance(header, Header):
                entry = {"run": run_of(files[path].path, header), "quantities": stated_quantities(header)}
            elif header.damaged:  # else it is HDF5 of something else
                entry = {"run": run_of(files[path].path, header), "quantities": []}
            yield files[path], entry
        left = [str(path) for path, file in files.items() if file.kind == "loop"]
        while left:  # another process reads them, which may die of one
            answer = in_subprocess("bench.runs.prepare:look", left)
            if not answer.died:
                yield from ((files[Path(name)], {"loop": loop}) for name, loop in answer.value.items())
                return
            culprit = answer.at if answer.at in left else left[0]
            left.remove(culprit)
            yield files[Path(culprit)], {"loop": None}

    def _remarks(self, name: str) -> dict[str, Any]:
        """The entry of a side file."""
        remarks, problem = Remarks(), None
        try:
            remarks = read_remarks(self.folder / name)
        except InputError as error:
            problem = str(error)
        notes = "\n".join(note.text for note in remarks.notes)
        return {"remarks": {"identity": remarks.identity, "notes": notes, "tags": remarks.tags, "problem": problem}}

    def _loops(self) -> dict[str, list[Row]]:
        """Verdicts by the identity of a recording, the latest first."""
        out: dict[str, list[Row]] = {}
        latest_first = sorted(self._files.items(), key=lambda item: (-item[1]["mtime_ns"], item[0]))
        for path, entry in latest_first:
            if loop := entry.get("loop"):
                row = loop | {"path": path, "together": len(loop["identities"])}
                for identity in dict.fromkeys(loop["identities"]):
                    out.setdefault(identity, []).append(row)
        return out

    def _row(self, run: Row, loops: dict[str, list[Row]]) -> Row:
        """A recording with the remarks on it and the latest verdict."""
        identity = run["identity"]
        remarks = self._files.get(run["path"] + ENDING, {}).get("remarks")
        if remarks is None or (remarks["identity"] and identity and remarks["identity"] != identity):
            remarks = {"notes": "", "tags": [], "problem": None}  # none, or of another recording of that name
        loop = next(iter(loops.get(identity, ())), None) if identity else None
        about = ("verdict", "summary", "before_us", "after_us", "floor_us")
        return run | {
            "tags": remarks["tags"],
            "notes": f"{run['notes']}\n{remarks['notes']}".strip("\n"),
            "remarks_problem": remarks["problem"],
            "loop": None if loop is None else {
                **{name: loop[name] for name in about}, "file": loop["path"], "recordings": loop["together"],
            },
        }  # fmt: skip

    def _take_in(self) -> None:
        """Read the catalogue's file where it is another one than was read or written here last."""
        if self.path is None or self._anew or not self._updating.acquire(blocking=False):
            return  # another thread brings it up to date
        try:
            state = self.path.stat()
            seen = state.st_mtime_ns, state.st_size, state.st_ino
            if seen == self._seen:
                return
            found = json.loads(self.path.read_bytes())
            self._seen = seen
            if found["version"] > VERSION:
                self.said = (
                    f"{self.path}: was made by a newer version of this software (catalogue {found['version']}, this "
                    f"one knows {VERSION}) and is left as it is; the recordings are read anew for this call: update, "
                    "or remove that file"
                )
                self.path = None
            elif found["version"] == VERSION:
                self._files = dict(found["files"])
        except OSError:
            pass  # there is none yet, or it is being replaced
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            self.said = f"{self.path}: was damaged ({error}) and is made again from the recordings"
        finally:
            self._updating.release()

    def _save(self) -> None:
        """Replace the catalogue's file; one that cannot be written now is written the next time."""
        if self.path is None or self._anew:
            return
        with self._lock, contextlib.suppress(OSError):
            write_whole(self.path, json.dumps({"version": VERSION, "files": self._files}))
            state = self.path.stat()
            self._seen = state.st_mtime_ns, state.st_size, state.st_ino


def _plain(entry: dict[str, Any]) -> dict[str, Any]:
    """An entry as JSON has it; text that is not Unicode has marks in its place."""
    plain: dict[str, Any] = json.loads(json.dumps(json_values(entry), ensure_ascii=False).encode("utf-8", "replace"))
    return plain
