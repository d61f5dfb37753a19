"""The instrument behind the simulated rig's sensors: mount, coupling, low-pass, converter, and what they add.

The accelerometer's analogue part runs on `SUBSTEPS` points an interval, where the plate's cubic, the ringing and each
impact's moment are known; a section is a biquad whose memory is carried on. What comes behind the converter's samples
(its linear-phase filter, 1/f noise, bias, mains) is added block by block.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.signal import bilinear, butter, firwin

from kernels import njit
from kernels.arrays import Floats
from rig.sim.forces import G_MPS2

SUBSTEPS = 8

SIDEWAYS, MOUNT, COUPLING, LOW_PASS = range(4)  # sections in order, two of the last; the sensor clips behind its mount
SECTIONS = LOW_PASS + 2


OCTAVES = 18
"""Of 1/f noise, down from a quarter of the rate."""


ANALOGUE = ("low_pass_hz", "high_pass_hz", "mount_hz", "cross_axis", "sensor_clip_g", "between_channels_s")
"""Keys of which one that is not zero makes the accelerometer's signal pass the sections."""


def sections(rig: Mapping[str, float], rate_hz: float) -> Floats:
    """Coefficients b0, b1, b2, a1, a2 of each section at the rate of the substeps, (`SECTIONS`, 5)."""
    fine_hz = rate_hz * SUBSTEPS
    out = np.zeros((SECTIONS, 5))
    out[MOUNT:, 0] = 1.0

    def put(place: int, numerator: Any, denominator: Any) -> None:
        """A rational function of s."""
        b, a = bilinear(numerator, denominator, fs=fine_hz)
        out[place] = [*b, *[0.0] * (3 - len(b)), *a[1:], *[0.0] * (3 - len(a))]

    if rig["cross_axis"] != 0.0:
        # the table's sideways mode, driven by its vertical acceleration: 90 Hz, damping 0.05, three times as large
        w = 2.0 * math.pi * 90.0
        width = 2.0 * 0.05 * w
        put(SIDEWAYS, [rig["cross_axis"] * 3.0 * width, 0.0], [1.0, width, w * w])
    if rig["mount_hz"] > 0.0:
        w = 2.0 * math.pi * rig["mount_hz"]
        put(MOUNT, [w * w], [1.0, 2.0 * rig["mount_damping"] * w, w * w])
    if rig["high_pass_hz"] > 0.0:
        put(COUPLING, [1.0, 0.0], [1.0, 2.0 * math.pi * rig["high_pass_hz"]])
    if rig["low_pass_hz"] > 0.0:
        corner = min(rig["low_pass_hz"] / (0.5 * fine_hz), 0.9)
        sos = butter(int(rig["low_pass_poles"]), corner, output="sos")
        out[LOW_PASS : LOW_PASS + len(sos)] = sos[:, [0, 1, 2, 4, 5]]
    return out


@njit()
def _through(taps: Any, memory: Any, k: int, x: float) -> float:
    """One point through section ``k``, direct form II transposed."""
    y = taps[k, 0] * x + memory[k, 0]
    memory[k, 0] = taps[k, 1] * x - taps[k, 3] * y + memory[k, 1]
    memory[k, 1] = taps[k, 2] * x - taps[k, 4] * y
    return float(y)


@njit()
def _settle(taps: Any, memory: Any, k: int, x: float) -> float:
    """Set section ``k`` as if it had had ``x`` for ever; what it gives then."""
    y = x * (taps[k, 0] + taps[k, 1] + taps[k, 2]) / (1.0 + taps[k, 3] + taps[k, 4])
    memory[k, 1] = taps[k, 2] * x - taps[k, 4] * y
    memory[k, 0] = y - taps[k, 0] * x
    return float(y)


@njit()
def _clipped(p: Any, a: float) -> float:
    most = p.sensor_clip_g * G_MPS2
    return min(max(a, -most), most) if most > 0.0 else a


@njit()
def shown_acceleration(
    s: Any, p: Any, taps: Any, memory: Any, noise: Any, ring_re: float, ring_im: float, rest: float
) -> float:
    """What the converter takes of the accelerometer for the sample at the interval's end, m/s^2.

    ``noise`` (`SUBSTEPS`,), read where there is a low-pass, is white, of unit variance; ``ring_re, ring_im`` the
    ringing at the interval's start; ``rest`` what is felt at its end besides drive and ringing, and runs there straight
    from the last sample's.
    """
    before = s.felt_rest if s.sample > 0 else rest
    s.felt_rest = rest
    if s.sample == 0:
        x = s.a0 + rest
        x = _settle(taps, memory, MOUNT, x + _settle(taps, memory, SIDEWAYS, x))
        x = _settle(taps, memory, COUPLING, _clipped(p, x))
        for k in range(LOW_PASS, SECTIONS):
            x = _settle(taps, memory, k, x)
        s.filtered = x
    step_s, w = s.dt_s / SUBSTEPS, 2.0 * math.pi * p.ring_frequency_hz
    decay = math.exp(-step_s / p.ring_decay_s)
    turn_re, turn_im = decay * math.cos(w * step_s), decay * math.sin(w * step_s)
    noise_mps2 = p.accelerometer_noise_g * G_MPS2 * math.sqrt(1.0 * SUBSTEPS)  # white: a density, not a variance
    place = SUBSTEPS * (1.0 - min(p.between_channels_s / s.dt_s, 1.0))
    taken = s.filtered
    for j in range(1, SUBSTEPS + 1):
        u = j / SUBSTEPS
        ring_re, ring_im = turn_re * ring_re - turn_im * ring_im, turn_re * ring_im + turn_im * ring_re
        ring = ring_im
        for i in range(s.n_hits):
            since = (u - s.hit_u[i]) * s.dt_s
            if since > 0.0:
                ring -= s.hit_mps[i] * math.exp(-since / p.ring_decay_s) * math.sin(w * since)
        x = s.a0 + u * (s.a1 + u * (s.a2 + u * s.a3)) + before + u * (rest - before) + G_MPS2 * p.ring_g_s_per_m * ring
        x = _clipped(p, _through(taps, memory, MOUNT, x + _through(taps, memory, SIDEWAYS, x)))
        x = _through(taps, memory, COUPLING, x)
        if p.low_pass_hz > 0.0:
            x += noise_mps2 * noise[j - 1]
        for k in range(LOW_PASS, SECTIONS):
            x = _through(taps, memory, k, x)
        if j - 1 < place <= j:
            taken = s.filtered + (place - (j - 1)) * (x - s.filtered)
        s.filtered = x
    return float(taken)


@njit()
def _fir(taps: Any, last: Any, x: Any) -> None:
    """Filter ``x`` (n,) in place; ``last`` (taps,) holds the latest inputs, the newest first."""
    for i in range(x.size):
        for k in range(last.size - 1, 0, -1):
            last[k] = last[k - 1]
        last[0] = x[i]
        total = 0.0
        for k in range(taps.size):
            total += taps[k] * last[k]
        x[i] = total


@njit()
def _add_flicker(keep: Any, drifts: Any, pushes: Any, rms: float, x: Any) -> None:
    """Add 1/f noise of so much rms an octave to ``x`` (n,): a Lorentzian noise of that rms for each octave."""
    for i in range(x.size):
        total = 0.0
        for k in range(keep.size):
            drifts[k] = keep[k] * drifts[k] + math.sqrt(1.0 - keep[k] * keep[k]) * pushes[i, k]
            total += drifts[k]
        x[i] += rms * total


class Converter:
    """What is added to the volts of the channels at the converter's samples, and its linear-phase filter.

    ``rig`` has all keys of `rig.sim.scenario.RIG_DEFAULTS`; ``rng`` is for 1/f noise.
    """

    def __init__(self, rig: Mapping[str, float], rate_hz: float, rng: np.random.Generator, mains_hz: float) -> None:
        self._rig, self._rate_hz, self._mains_hz = rig, rate_hz, mains_hz
        size = int(rig["fir_samples"])
        self._fir = firwin(2 * size + 1, 0.94, window=("kaiser", 8.0)) if size else np.ones(1)
        self._filtered = () if not size else (1,) if rig["fir_accelerometer_only"] else (0, 1, 2)
        self._last = np.zeros((3, self._fir.size))
        corners_hz = rate_hz / 4.0 / 2.0 ** np.arange(OCTAVES)
        self._keep = np.exp(-2.0 * math.pi * corners_hz / rate_hz)
        flickers = {0: rig["contact_flicker_v"], 1: rig["flicker_v"]}
        chances = dict(zip(flickers, rng.spawn(len(flickers)), strict=True))
        self._flickers = [
            (channel, rms_v, chances[channel], chances[channel].standard_normal(OCTAVES))
            for channel, rms_v in flickers.items() if rms_v
        ]  # fmt: skip
        lines = {
            0: (rig["contact_mains_v"], 0.0),
            1: (rig["mains_v"], rig["mains_odd"]),
            2: (rig["drive_mains_v"], 0.0),
        }
        self._lines = {channel: line for channel, line in lines.items() if line[0]}
        self.changes = bool(size or self._lines or self._flickers or rig["bias_v"] or rig["warm_up_v"])

    def apply(self, volts: Floats, first: int) -> None:
        """Change ``volts`` (n, channels) of samples ``first``, ``first + 1``, ... in place."""
        time_s = (first + np.arange(len(volts))) / self._rate_hz
        for channel in self._filtered:
            if first == 0:
                self._last[channel] = volts[0, channel]
            _fir(self._fir, self._last[channel], volts[:, channel])
        for channel, rms_v, rng, drifts in self._flickers:
            _add_flicker(self._keep, drifts, rng.standard_normal((len(volts), OCTAVES)), rms_v, volts[:, channel])
        rig = self._rig
        if rig["bias_v"] or rig["warm_up_v"]:
            volts[:, 1] += rig["bias_v"] + rig["warm_up_v"] * np.exp(-time_s / rig["warm_up_s"])
        for channel, (amplitude_v, odd) in self._lines.items():
            angle = 2.0 * math.pi * self._mains_hz * time_s + 1.0
            volts[:, channel] += amplitude_v * (np.sin(angle) + sum(odd / k * np.sin(k * angle) for k in (3, 5, 7)))
