"""Missing and expired calibrations of a setup's scales.

A recording is judged by the day it was made, a run by today. The warnings change nothing.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterator

from daq.setup.setup import Setup
from daq.setup.values import QuantityTable


def quantities(setup: Setup) -> Iterator[tuple[str, str, QuantityTable | None]]:
    """Quantities that can be calibrated: ``(kind of bench calibrate or empty, dotted key, quantity or None)``."""
    channels, drive = setup.channels.recorded(), setup.drive
    rows = {
        name: [(channel.calibrated_by, f"channels.{name}.{key}", q) for key, q in channel.calibrations().items()]
        for name, channel in channels.items()
    }
    yield from rows.pop("accelerometer")
    yield "drive", "drive.g_per_volt", drive.g_per_volt
    yield "drive", "drive.phase_deg", drive.phase_deg
    if drive.second is not None:
        yield "drive", "drive.second.g_per_volt", drive.second.g_per_volt
        yield "drive", "drive.second.phase_deg", drive.second.phase_deg
    for others in rows.values():
        yield from others


def calibration_warnings(setup: Setup, on: datetime.date) -> list[str]:
    """One sentence for each kind of calibration that is missing or too old on the day ``on``."""
    missing: dict[str, list[str]] = {}
    expired: dict[str, list[str]] = {}
    for kind, key, quantity in quantities(setup):
        if quantity is None or quantity.date is None:
            missing.setdefault(kind, []).append(key)
        elif (on - quantity.date).days > setup.calibration_days:
            expired.setdefault(kind, []).append(f"{key} ({quantity.date})")
    late = f"calibrated more than {setup.calibration_days} days before"
    return [
        f"{words}: {', '.join(keys)}; "
        + (f"bench calibrate {kind} --into PROFILE" if kind else "write value, date and source into the profile")
        for words, found in (("never calibrated", missing), (late, expired))
        for kind, keys in found.items()
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
