"""Which scales of a setup nobody measured, or not lately.

The rule kept here: a recording is judged by the day it was made, a run by today; a doubt is said, never acted upon.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterator

from daq.recording.reader import Recording
from daq.setup.setup import QuantityTable, Setup


def quantities(setup: Setup) -> Iterator[tuple[str, str, QuantityTable | None]]:
    """What can be calibrated, as ``(kind of bench calibrate, dotted key, quantity)``; None where it is left out."""
    accelerometer, drive, continuity = setup.channels.accelerometer, setup.drive, setup.channels.continuity
    yield "accelerometer", "channels.accelerometer.sensitivity", accelerometer.sensitivity
    if accelerometer.coupling == "dc":
        yield "accelerometer", "channels.accelerometer.offset_v", accelerometer.offset_v
    yield "drive", "drive.g_per_volt", drive.g_per_volt
    yield "drive", "drive.phase_deg", drive.phase_deg
    if drive.second is not None:
        yield "drive", "drive.second.g_per_volt", drive.second.g_per_volt
        yield "drive", "drive.second.phase_deg", drive.second.phase_deg
    if continuity is not None and continuity.coupling == "dc":
        yield "contact", "channels.continuity.closed_v", continuity.closed_v
        yield "contact", "channels.continuity.open_v", continuity.open_v


def doubts(setup: Setup, on: datetime.date) -> list[str]:
    """One sentence for each kind of calibration that is missing or too old on the day ``on``."""
    missing: dict[str, list[str]] = {}
    expired: dict[str, list[str]] = {}
    for kind, key, quantity in quantities(setup):
        if quantity is None or quantity.date is None:
            missing.setdefault(kind, []).append(key)
        elif (on - quantity.date).days > setup.calibration_days:
            expired.setdefault(kind, []).append(f"{key} ({quantity.date})")
    remedy = "; bench calibrate {} --into PROFILE"
    return [f"never calibrated: {', '.join(keys)}" + remedy.format(kind) for kind, keys in missing.items()] + [
        f"calibrated more than {setup.calibration_days} days before: {', '.join(keys)}" + remedy.format(kind)
        for kind, keys in expired.items()
    ]


def recorded_doubts(recording: Recording) -> list[str]:
    """`doubts` of a recording's setup on the day it was begun; today where it does not say."""
    started = str(recording.attrs.get("started", ""))
    on = datetime.date.fromisoformat(started[:10]) if started else datetime.datetime.now(datetime.UTC).date()
    return doubts(recording.setup, on)
