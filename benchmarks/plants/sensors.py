"""Plain sensors of the other plant: contact edges as they happen, delays, a capacitor, a converter's steps."""

from __future__ import annotations

import math

import numpy as np
from scipy.signal import lfilter


def edge_times(
    edges: np.ndarray, latency_s: float, closure_s: float, jitter_s: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """When the contact circuit changes, seconds (k,), and whether it opens then: late, held closed, jittered."""
    times = np.abs(edges) + latency_s
    opens = edges > 0.0
    held = np.where(~opens, times, -np.inf)
    held = np.maximum.accumulate(held) + closure_s
    times = np.where(opens, np.maximum(times, held), times)
    times = times + jitter_s * rng.standard_normal(times.size)
    return np.maximum.accumulate(times), opens  # jitter moves edges, it does not swap them


def square_contact(times: np.ndarray, opens: np.ndarray, n: int, rate_hz: float, rc_s: float) -> np.ndarray:
    """Volts of a contact that is open or closed at each sample; one between two samples is not seen."""
    place = np.searchsorted(times, np.arange(n) / rate_hz, side="right") - 1
    is_open = np.where(place >= 0, opens[np.maximum(place, 0)], False)
    volts = np.where(is_open, 4.96, 0.03)
    if rc_s > 0.0:
        keep = math.exp(-1.0 / (rc_s * rate_hz))
        volts = lfilter([1.0 - keep], [1.0, -keep], volts, zi=[keep * volts[0]])[0]
    return np.asarray(volts)


def late(felt: np.ndarray, samples: float) -> np.ndarray:
    """Two equal low-passes in a row that together hold a slow signal back by so many samples."""
    keep = samples / 2.0 / (1.0 + samples / 2.0)  # a low-pass y = keep y + (1 - keep) x is late by keep / (1 - keep)
    for _ in range(2):
        felt = lfilter([1.0 - keep], [1.0, -keep], felt, zi=[keep * felt[0]])[0]
    return np.asarray(felt)


def blocked(felt: np.ndarray, corner: float) -> np.ndarray:
    """A capacitor and a resistor, at rest before; the corner in units of the rate."""
    turn = math.tan(math.pi * corner)
    return np.asarray(lfilter([1.0 / (1.0 + turn), -1.0 / (1.0 + turn)], [1.0, (turn - 1.0) / (turn + 1.0)], felt))


def converted(bits: int, volts: np.ndarray) -> np.ndarray:
    """Volts as a converter of +-10 V gives them; 0 bits: fine enough not to matter."""
    if not bits:
        return volts
    step_v = 20.0 / 2**bits
    return np.asarray(np.round(volts / step_v) * step_v)
