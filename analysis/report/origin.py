"""Tables of a report that say where its data come from: the file, the rig, and how old each calibration was.

Rows of plain text; the page escapes them.
"""

from __future__ import annotations

import datetime

import numpy as np

from daq.channels.registry import CHANNELS
from daq.files.tables import BlockFlag
from daq.instrument.stored import instrument_of
from daq.recording import Recording
from daq.recording.verify import VerifyReport
from daq.setup.setup import quantities

LISTED = 12  # gaps and remarks in one row

Rows = list[tuple[str, ...]]

STATES = {
    "complete": "complete: the run ended as planned",
    "stopped": "stopped: ended early, whole",
    "incomplete": "incomplete: cut off, or still being written",
    "damaged": "damaged: something does not read back as it was written",
}


def source_words(name: str, *, simulated: bool) -> str:
    """The source of a figure's data, as written below it."""
    return f"{name}, {'simulated rig' if simulated else 'measured'}"


def software_words(version: str, commit: str) -> str:
    """Version and commit of the software, as text."""
    return f"shakerbench {version}{f' ({commit[:10]}{commit[40:]})' if commit else ''}"


def file_rows(recording: Recording, found: VerifyReport) -> Rows:
    """State of the file, its seal, its losses, and what made it."""
    a, blocks = recording.attrs, recording.blocks
    seal = "every byte agrees with its seal" if a.get("sealed") and found.state != "damaged" else "no seal that agrees"
    flags = {f.name: int(np.sum(blocks["flags"] & f.value > 0)) for f in BlockFlag}
    noted = ", ".join(f"{str(name).lower()} in {n}" for name, n in flags.items() if n)
    rows: Rows = [
        ("file", recording.path.name),
        ("state", STATES[found.state] + (f" ({a.get('ended')}: {a['why']})" if a.get("why") else "")),
        ("seal", f"{seal}; read from end to end for this page"),
        ("begun, ended", f"{_when(a.get('started'))}, {_when(a.get('ended_at'))}"),
        (
            "samples",
            f"{recording.n_samples} a channel at {recording.rate_hz:.9g} Hz "
            f"({recording.n_samples / recording.rate_hz:.3f} s); channels {', '.join(recording.channels)}",
        ),
        ("lost", _losses(recording, found)),
        ("blocks", f"{len(blocks)}; {noted or 'none overflown, late, clipped, filled or damaged'}"),
        ("software", software_words(str(a.get("software_version") or "unknown"), str(a.get("software_commit") or ""))),
    ]
    for key, words in (
        ("imported_from", "imported from"),
        ("imported_sha256", "SHA-256 of that file"),
        ("recovered_from", "recovered from"),
        ("scenario_sha256", "SHA-256 of the hidden scenario"),
    ):
        if a.get(key):
            rows.append((words, str(a[key])))
    rows += [(f"key {key}", str(value)) for key, value in a["extra"].items()]
    return [*rows, *(("remark", line) for line in found.where[:LISTED])]


def _losses(recording: Recording, found: VerifyReport) -> str:
    if not len(recording.gaps):
        return "no sample" + (", but samples are missing that no gap accounts for" if found.suspect else "")
    listed = [f"{lost} before sample {first}" for first, lost in recording.gaps[:LISTED]]
    more = f", and {len(recording.gaps) - LISTED} gaps more" if len(recording.gaps) > LISTED else ""
    return f"{found.lost_samples} samples in {len(recording.gaps)} gaps: {', '.join(listed)}{more}"


def _when(text: object) -> str:
    return f"{str(text)[:19].replace('T', ' ')} UTC" if text else "unknown"


def rig_rows(recording: Recording) -> Rows:
    """The measurement: forcing, ball, channels, declared effects."""
    setup = recording.setup
    forcing, channels = setup.forcing, setup.channels
    kind = "simulated rig" if recording.attrs.get("simulated") else "a rig"
    declared = [
        f"{name}: " + ", ".join(f"{k} = {v:.5g}" for k, v in table.items()) if table else name
        for name, table in setup.declared_values().items()
    ]
    rows: Rows = [
        ("profile", setup.name + (f": {setup.description}" if setup.description else "")),
        ("made on", f"{kind}, back end {recording.attrs.get('backend') or 'unknown'}"),
        (
            "forcing",
            f"{forcing.frequency_hz:g} Hz, c = {forcing.ratio}, amplitudes {forcing.amplitude[0]:g} and "
            f"{forcing.amplitude[1]:g}, phases {forcing.phase_deg[0]:g} and {forcing.phase_deg[1]:g} degrees",
        ),
        ("ball", f"{setup.ball.mass_kg:g} kg; g = {setup.g_mps2.value:g} m/s^2"),
        ("declared effects", "; ".join(declared) or "none: the ideal ball"),
    ]
    for name in dict.fromkeys((*CHANNELS, *channels.recorded())):
        channel = channels.get(name)
        if channel is None:
            rows.append((name, "not recorded"))
            continue
        words = [f"{channel.coupling}, +-{channel.range_v:g} V"]
        words += [f"terminal {channel.terminal}"] if channel.terminal else []
        words += [f"serial number {channel.serial_number}"] if channel.serial_number else []
        rows.append((name, ", ".join(words)))
    if (instrument := instrument_of(recording)) is not None:
        rows += [("measured", line) for line in instrument.in_words()]
        rows += [("doubt", doubt.sentence) for doubt in instrument.doubts]
    return rows


def calibration_rows(recording: Recording) -> Rows:
    """Each quantity that can be calibrated: key, value, uncertainty, date, age when the run began, source, remark."""
    started = str(recording.attrs.get("started") or "")
    day = datetime.date.fromisoformat(started[:10]) if started else None
    most = recording.setup.calibration_days
    rows: Rows = []
    for _, key, quantity in quantities(recording.setup):
        if quantity is None:
            rows.append((key, "-", "-", "-", "-", "", "not measured"))
            continue
        age = (day - quantity.date).days if day is not None and quantity.date is not None else None
        remark = "never calibrated" if quantity.date is None else ""
        remark = f"older than {most} days" if age is not None and age > most else remark
        rows.append(
            (
                key,
                f"{quantity.value:.6g}",
                f"{quantity.uncertainty:.2g}" if quantity.uncertainty else "not stated",
                str(quantity.date or "-"),
                "-" if age is None else f"{age} days",
                quantity.source,
                remark,
            )
        )
    return rows
