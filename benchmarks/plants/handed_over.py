"""What a foreign rig hands over, as its owner imports it: volts in a table and a profile."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import resample_poly

from daq.importers.formats.open import open_source
from daq.importers.import_recording import import_recording
from rig.profile import load_setup

Volts = dict[str, np.ndarray]
CHANNELS = ("continuity_v", "accelerometer_v", "drive_v")
FLIGHTS = "flights"  # the truth's times, in seconds, (m, 2): they follow the file's clock


@dataclass(frozen=True)
class Afterwards:
    """What happens to a recording on its way to whoever imports it; each default leaves it as it is.

    Attributes
    ----------
    resampled_hz, polyphase
        The rate to which someone has interpolated it, by straight lines or by a polyphase filter.
    drive
        ``inverted``; ``scaled``: tapped before an amplifier of unknown gain; ``missing``: not recorded.
    late_samples
        By how many samples a channel lags behind the others.
    filled_hz
        The accelerometer's own rate: what lies between two readings is filled with the one before.
    losses
        How often 20 to 300 rows are missing.
    clock, time_jitter_s
        Relative error of its times' rate, and their scatter.
    """

    resampled_hz: float = 0.0
    polyphase: bool = False
    drive: str = ""
    late_samples: tuple[tuple[str, int], ...] = ()
    filled_hz: float = 0.0
    losses: int = 0
    clock: float = 0.0
    time_jitter_s: float = 0.0

    def apply(self, given: Mapping[str, np.ndarray], rate_hz: float, rng: np.random.Generator) -> Volts:
        """The volts as they are handed over, and the true times by their clock."""
        v = {name: given[name] for name in ("time_s", *CHANNELS, FLIGHTS)}
        if self.resampled_hz:
            _resample(v, rate_hz, self.resampled_hz, self.polyphase)
        if self.filled_hz:
            each = rate_hz / self.filled_hz
            last = np.arange(v["time_s"].size) // each * each
            v["accelerometer_v"] = v["accelerometer_v"][last.astype(np.int64)]
        for name, samples in self.late_samples:
            v[name] = np.concatenate([np.full(samples, v[name][0]), v[name][:-samples]])
        if self.drive == "missing":
            del v["drive_v"]
        elif self.drive:
            v["drive_v"] = v["drive_v"] * {"inverted": -1.0, "scaled": 0.37}[self.drive]
        kept = np.ones(v["time_s"].size, dtype=bool)
        for _ in range(self.losses):
            first = rng.integers(1000, kept.size - 1000)
            kept[first : first + rng.integers(20, 300)] = False
        v = {name: x if name == FLIGHTS else x[kept] for name, x in v.items()}
        v["time_s"] = v["time_s"] * (1.0 + self.clock) + self.time_jitter_s * rng.standard_normal(kept.sum())
        v[FLIGHTS] = v[FLIGHTS] * (1.0 + self.clock)
        return v

    def profile(self, text: str) -> str:
        """The owner's profile: with the new rate, and without the scale of a drive that nobody has calibrated."""
        if self.resampled_hz:
            text = re.sub(r"(?m)^rate_hz = .*$", f"rate_hz = {self.resampled_hz}", text)
        if self.drive in ("missing", "scaled"):
            text = re.sub(r"(?m)^g_per_volt = .*\n", "", text)
        return text


def _resample(v: Volts, rate_hz: float, to_hz: float, polyphase: bool) -> None:
    """Bring time and channels to another rate."""
    time_s = np.arange(int(v["time_s"].size * to_hz / rate_hz)) / to_hz
    for name in CHANNELS:
        if polyphase:
            whole = np.gcd(int(to_hz), int(rate_hz))
            v[name] = resample_poly(v[name], int(to_hz) // whole, int(rate_hz) // whole, padtype="line")[: time_s.size]
        else:
            v[name] = np.interp(time_s, v["time_s"], v[name])
    v["time_s"] = time_s


def imported(volts: Mapping[str, np.ndarray], profile: str, folder: Path) -> Path:
    """The recording made of ``time_s`` and the channels' volts, (n,) each, and the text of a profile."""
    raw, described, out = folder / "recording.npz", folder / "profile.toml", folder / "recording.h5"
    np.savez(raw, allow_pickle=False, **{name: x for name, x in volts.items() if name in ("time_s", *CHANNELS)})
    described.write_text(profile, encoding="utf-8")
    setup, text = load_setup(described)
    import_recording(open_source(raw), out, setup, text)
    return out
