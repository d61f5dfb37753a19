"""Files below the runs' folder that the catalogue knows, and what it holds of a recording and its calibrations."""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from bench.jobs.loops import SAVED
from daq.recording.header import Header, Unread
from daq.recording.notebook import ENDING, entries_of
from daq.setup.errors import InputError
from model.effects.registry import unit_of

PLACE = ".shakerbench"
"""Folder, in the runs' folder, of what can be made again: the catalogue, the pyramids, the flights."""
RECORDINGS = (".h5", ".hdf5")

Kind = Literal["hdf5", "remarks", "loop"]


@dataclass(frozen=True)
class Found:
    """A file: its path below the folder with forward slashes, its size and time of change."""

    path: str
    size: int
    mtime_ns: int

    @property
    def kind(self) -> Kind:
        """The kind of file that its name stands for."""
        if self.path.endswith(ENDING):
            return "remarks"
        return "loop" if self.path.lower().endswith(SAVED) else "hdf5"


def run_id(path: str) -> str:
    """Short name of a recording in addresses: a hash of its path below the folder."""
    return hashlib.sha256(path.encode("utf-8", "surrogateescape")).hexdigest()[:12]


def files_below(folder: Path) -> Iterator[Found]:
    """Files that may matter to the catalogue, no hidden ones and no links that lead out (`InputError`: unreadable)."""
    root = folder.resolve()
    try:
        yield from _below(root, "", root, 0)
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({error.strerror or error})") from error


def _below(folder: Path, prefix: str, root: Path, depth: int) -> Iterator[Found]:
    with os.scandir(folder) as entries:
        for entry in sorted(entries, key=lambda one: one.name):
            name = entry.name
            if name.startswith(".") or any("\ud800" <= c <= "\udfff" for c in name):  # a name in another code page
                continue
            try:
                if entry.is_dir(follow_symlinks=False):
                    if depth < 32:
                        yield from _below(Path(entry.path), f"{prefix}{name}/", root, depth + 1)
                    continue
                if not name.lower().endswith((*RECORDINGS, SAVED, ENDING)):
                    continue
                if entry.is_symlink() and not Path(entry.path).resolve(strict=True).is_relative_to(root):
                    continue
                state = entry.stat()
            except (OSError, RuntimeError):
                continue  # gone since, or a folder that may not be read
            yield Found(prefix + name, state.st_size, state.st_mtime_ns)


def run_of(path: str, header: Header | Unread) -> dict[str, Any]:
    """The row of a recording, or of a file that should be one and does not read; None where something is not known."""
    attrs: Mapping[str, Any] = {} if isinstance(header, Unread) else header.attrs
    identity = "" if isinstance(header, Unread) else header.identity
    row: dict[str, Any] = {"id": run_id(path), "path": path, "identity": identity}  # as in `daq.recording.header`
    nothing = (
        "date", "profile", "c", "frequency_hz", "gamma_low", "gamma_high", "steps", "seconds", "rate_hz", "n_samples",
        "lost_samples",
    )  # fmt: skip
    row |= dict.fromkeys(nothing) | {"steps": 0, "ended": "damaged", "why": "", "all_bytes": False}
    row |= {"note": str(attrs.get("note") or ""), "notes": "", "simulated": bool(attrs.get("simulated"))}
    row["backend"] = str(attrs.get("backend") or "")
    if isinstance(header, Unread):
        return row | {"why": header.why}
    forcing = header.setup["forcing"]
    pairs = zip(header.achieved_gammas, header.gammas, strict=True)
    gammas = [g for achieved, commanded in pairs if (g := commanded if achieved is None else achieved) is not None]
    damaged, ended = header.state == "damaged", str(attrs.get("ended", "") or "incomplete")
    return row | {
        "date": str(attrs.get("started") or attrs.get("imported_at") or "") or None,  # UTC
        "profile": str(header.setup["name"]),
        "c": header.ratios[0] if len(set(header.ratios)) == 1 else int(forcing["ratio"]),
        "frequency_hz": float(forcing["frequency_hz"]),  # of the first tone
        "gamma_low": min(gammas, default=None),  # achieved where it was measured, else commanded
        "gamma_high": max(gammas, default=None),
        "steps": len(header.gammas),
        "seconds": header.n_samples / header.rate_hz,  # without what was lost
        "rate_hz": header.rate_hz,
        "n_samples": header.n_samples,  # of a channel
        "lost_samples": header.lost_samples,  # that were declared as lost
        "ended": "damaged" if damaged else "incomplete" if header.state == "incomplete" else ended,
        "why": "; ".join(header.where) if damaged else str(attrs.get("why") or ""),
        "all_bytes": header.all_bytes,  # whether every byte was compared with the checksums, or tables and indexes
        "notes": "\n".join(one.text for one in entries_of(header)),  # as given, and typed during the run; a line each
    }


def stated_quantities(header: Header) -> list[dict[str, Any]]:
    """Scales and effects that the profile of a recording states, as `quantity` has them."""
    setup = header.setup
    accelerometer, drive = setup["channels"]["accelerometer"], setup["drive"]
    stated = [("accelerometer.sensitivity", accelerometer["sensitivity"], accelerometer["unit"])]
    if drive.get("g_per_volt"):
        stated.append(("drive.g_per_volt", drive["g_per_volt"], "g/V"))
    for effect, table in (setup.get("declared") or {}).items():
        stated += [(f"{effect}.{name}", x, unit_of(effect, name)) for name, x in table.items()]
    found = (quantity(name, x["value"], float(x["uncertainty"]) or None, unit, "profile") for name, x, unit in stated)
    return [one for one in found if math.isfinite(one["value"])]


def quantity(name: str, value: float, sigma: float | None, unit: str, origin: str) -> dict[str, Any]:
    """A value with its standard deviation (None: unknown) and unit; ``origin``: profile or verdict."""
    return {"name": name, "value": float(value), "sigma": sigma, "unit": unit, "origin": origin}
