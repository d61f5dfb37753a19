"""Missing and expired calibrations of a setup's scales.

A recording is judged by the day it was made, a run by today. The warnings change nothing.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterator

from daq.setup.setup import QuantityTable, Setup


def quantities(setup: Setup) -> Iterator[tuple[str, str, QuantityTable | None]]:
    """Quantities that can be calibrated: ``(kind of bench calibrate, dotted key, quantity or None)``."""
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


def calibration_warnings(setup: Setup, on: datetime.date) -> list[str]:
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


def warnings_at_start(setup: Setup, started: str) -> list[str]:
    """`calibration_warnings` on the day a recording was begun.

    Parameters
    ----------
    setup
        The recording's setup.
    started
        Its attribute ``started``, ISO 8601; empty where the file lacks it, then today counts.
    """
    today = datetime.datetime.now(datetime.UTC).date()
    return calibration_warnings(setup, datetime.date.fromisoformat(started[:10]) if started else today)
