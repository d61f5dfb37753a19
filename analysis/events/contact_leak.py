"""Contact volts that leak into the accelerometer, by a ground that both share or a multiplexer that remembers.

No plate jumps when a ball leaves it, so the step that the accelerometer makes at an opening is the leak's.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from analysis.events.levels import Levels
from analysis.signals import Piece


def contact_leak(pieces: Sequence[Piece], levels: Levels, rate_hz: float) -> float:
    """Part of the contact's volts that the accelerometer's volts hold; 0 where openings show none that lasts."""
    # a millisecond on each side of an opening, before which nothing may touch for four
    half, quiet = max(round(1e-3 * rate_hz), 6), max(round(4e-3 * rate_hz), 12)
    window = np.arange(-half, half + 1)
    whole, late = np.ones(window.size, np.bool_), np.abs(window) > half // 2
    # a cubic is the tones' part of two milliseconds
    motion = [np.linalg.qr(np.vander(window[rows] / half, 4))[0] for rows in (whole, late)]
    found = [np.zeros((0, 2))]
    for piece in pieces:
        both = np.stack([piece.own(name) for name in ("continuity", "accelerometer")]).astype(np.float64)
        is_open = (both[0] - levels.closed_v) / (levels.open_v - levels.closed_v) > 0.5
        edges = np.flatnonzero(np.diff(is_open)) + 1
        before, after = np.diff(edges, prepend=0), np.diff(edges, append=is_open.size)
        opens = edges[is_open[edges] & (before > quiet) & (after > 2 * half)]
        own = np.zeros((opens.size, 2))
        for k, rows in enumerate((whole, late)):
            contact, acceleration = both[:, opens[:, None] + window[rows]]
            contact = contact - contact @ motion[k] @ motion[k].T
            own[:, k] = np.sum(contact * acceleration, axis=1) / np.sum(contact**2, axis=1)
        found.append(own)
    leaks = np.concatenate(found)
    if len(leaks) < 8:
        return 0.0
    leak, lasting = np.median(leaks, axis=0)
    # of the medians of normal numbers
    sigma = 1.86 * np.median(np.abs(leaks - np.array([leak, lasting])), axis=0) / np.sqrt(len(leaks))
    # a larger step is an impact, under a profile that exchanges open and closed
    if not 6.0 * sigma[0] < abs(leak) < 0.03 or abs(lasting - leak) > max(0.1 * abs(leak), 3.0 * sigma[1]):
        return 0.0  # what a cable's capacity lets through at an edge does not last
    return float(leak)
