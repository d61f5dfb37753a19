"""One row of the catalogue: a recording with its tags, notes and verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

from bench.runs.folder import Found, run_id
from bench.runs.loops import Quantity
from daq.recording.header import Header, Unread
from daq.recording.notebook import entries_of


@dataclass(frozen=True)
class Run:
    """One recording as the catalogue keeps it; None where something is not known.

    Attributes
    ----------
    id, path
        Short name in addresses, and the file's path below the folder.
    identity
        `daq.recording.identity.stored_id`.
    date
        Start of the run (UTC), or when it was imported.
    profile, c, frequency_hz
        Name of the profile, ratio of the tones, frequency of the first.
    gamma_low, gamma_high, steps
        Range of the steps' gamma (achieved where it was measured, else commanded), and their number.
    seconds, rate_hz, n_samples, lost_samples
        Length without what was lost, samples a second, samples a channel, samples declared as lost.
    ended
        complete, stopped, failed or incomplete; damaged where something does not read back.
    why
        Reason of a stop, or what is damaged.
    all_bytes
        Whether every byte was compared with the checksums, or only tables and indexes.
    note
        As `bench ramp` was given it.
    notes
        That one and those typed during the run, a line each.
    """

    id: str
    path: str
    identity: str
    date: str | None
    profile: str | None
    c: int | None
    frequency_hz: float | None
    gamma_low: float | None
    gamma_high: float | None
    steps: int
    seconds: float | None
    rate_hz: float | None
    n_samples: int | None
    lost_samples: int | None
    ended: str
    why: str
    all_bytes: bool
    note: str
    notes: str
    simulated: bool
    backend: str


COLUMNS = tuple(f.name for f in fields(Run))


def run_of(file: Found, header: Header | Unread) -> Run:
    """Row of a recording, or of a file that should be one and does not read."""
    if isinstance(header, Unread):
        nothing: dict[str, Any] = dict.fromkeys(COLUMNS)
        return Run(**nothing | {
            "id": run_id(file.path), "path": file.path, "identity": "", "steps": 0, "ended": "damaged",
            "why": header.why, "all_bytes": False, "note": "", "notes": "", "simulated": False, "backend": "",
        })  # fmt: skip
    attrs, forcing = header.attrs, header.setup["forcing"]
    pairs = zip(header.achieved_gammas, header.gammas, strict=True)
    gammas = [g for achieved, commanded in pairs if (g := commanded if achieved is None else achieved) is not None]
    ended = str(attrs.get("ended", "") or "incomplete")
    damaged = header.state == "damaged"
    return Run(
        id=run_id(file.path),
        path=file.path,
        identity=header.identity,
        date=str(attrs.get("started") or attrs.get("imported_at") or "") or None,
        profile=str(header.setup["name"]),
        c=header.ratios[0] if len(set(header.ratios)) == 1 else int(forcing["ratio"]),
        frequency_hz=float(forcing["frequency_hz"]),
        gamma_low=min(gammas, default=None),
        gamma_high=max(gammas, default=None),
        steps=len(header.gammas),
        seconds=header.n_samples / header.rate_hz,
        rate_hz=header.rate_hz,
        n_samples=header.n_samples,
        lost_samples=header.lost_samples,
        ended="damaged" if damaged else "incomplete" if header.state == "incomplete" else ended,
        why="; ".join(header.where) if damaged else str(attrs.get("why") or ""),
        all_bytes=header.all_bytes,
        note=str(attrs.get("note") or ""),
        notes="\n".join(one.text for one in entries_of(header)),
        simulated=bool(attrs.get("simulated")),
        backend=str(attrs.get("backend") or ""),
    )


def stated_quantities(header: Header) -> list[Quantity]:
    """Scales and effects that the profile of a recording states."""
    from bench.runs.loops import unit_of

    setup = header.setup
    accelerometer, drive = setup["channels"]["accelerometer"], setup["drive"]
    found = [_stated("accelerometer.sensitivity", accelerometer["sensitivity"], accelerometer["unit"])]
    if drive.get("g_per_volt"):
        found.append(_stated("drive.g_per_volt", drive["g_per_volt"], "g/V"))
    for effect, table in (setup.get("declared") or {}).items():
        found += [_stated(f"{effect}.{name}", x, unit_of(effect, name)) for name, x in table.items()]
    return [q for q in found if math.isfinite(q.value)]


def _stated(name: str, quantity: dict[str, Any], unit: str) -> Quantity:
    return Quantity(name, float(quantity["value"]), float(quantity["uncertainty"]) or None, unit, "profile")
