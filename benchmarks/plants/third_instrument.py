"""The third plant's instruments: accelerometer on a ringing table, contact circuit, and the card that samples them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import bessel, bilinear, butter, firwin, lfilter, upfirdn

from kernels.arrays import Floats

G = 9.80665
V_PER_G, OPEN_V, RANGE_V = 0.1, 5.0, 10.0
FILTER_SAMPLES = 40  # delay of the card's linear-phase filter
MOUNT_DAMPING = 0.04
CARDS = ("24-bit card", "16-bit card")


@dataclass(frozen=True)
class Instrument:
    """What stands between the rig and the recorded volts.

    Attributes
    ----------
    rate_hz, over
        Samples a second, and points for each on which the analogue parts are computed.
    bits, linear_phase
        Of the card, +-10 V; its filter delays all channels alike.
    low_pass_hz, coupling_hz
        Corners of a Bessel low-pass of four poles and of the coupling behind the accelerometer; 0 for none.
    reads_gravity
        Whether the accelerometer shows 1 g at rest.
    mount_hz
        Resonance of the accelerometer on its mount.
    table_hz, table_damping, table_share, push_s
        An impact pushes the place where the accelerometer is for ``push_s``, half a sine of ``table_share`` of the
        ball's change of speed, and it rings.
    white_v, pink_g, mains_hz, mains_g, bias_v
        Noise of the accelerometer up to half the rate, 1/f noise, mains with a third harmonic, and a constant.
    film_v, chatter_s, held_closed_s
        Typical voltage of the closed contact, time after a landing in which it opens up to three times, and for which
        it does not open for good.
    rise_s, fall_s
        Time constants of the contact circuit as it opens and closes.
    """

    rate_hz: float = 51200.0
    over: int = 8
    bits: int = 24
    linear_phase: bool = True
    low_pass_hz: float = 0.0
    coupling_hz: float = 0.0
    reads_gravity: bool = False
    mount_hz: float = 6000.0
    table_hz: float = 780.0
    table_damping: float = 0.03
    table_share: float = 0.08
    push_s: float = 2.5e-4
    white_v: float = 3e-4
    pink_g: float = 4e-3
    mains_hz: float = 50.0
    mains_g: float = 0.0
    bias_v: float = 0.0
    film_v: float = 0.05
    chatter_s: float = 0.0
    held_closed_s: float = 1.5e-4
    rise_s: float = 3e-5
    fall_s: float = 3e-6

    @property
    def late_s(self) -> float:
        """By how much every channel is late."""
        return FILTER_SAMPLES / self.rate_hz * self.linear_phase

    def accelerometer_v(self, plate_g: Floats, impacts: Floats, rng: np.random.Generator) -> Floats:
        """Volts at each sample, without white noise.

        Parameters
        ----------
        plate_g : (n over,)
            Acceleration of the plate on the fine grid.
        impacts : (k, 2)
            Time, s, and the ball's change of speed, m/s.
        rng : numpy.random.Generator
        """
        grid_hz = self.rate_hz * self.over
        push = np.zeros(plate_g.size)
        for landing_s, change_mps in impacts:
            first = math.ceil(landing_s * grid_hz)
            angle = math.pi * (np.arange(first, first + int(self.push_s * grid_hz)) / grid_hz - landing_s) / self.push_s
            own = push[first : first + angle.size]
            own -= (change_mps * math.pi / (2.0 * self.push_s) / G * np.sin(angle))[: own.size]
        ringing = self._resonance([1.0, 0.0, 0.0], self.table_hz, self.table_damping, self.table_share * push)
        x = self._resonance([1.0], self.mount_hz, MOUNT_DAMPING, plate_g + ringing)
        if self.low_pass_hz:
            x = lfilter(*bessel(4, self.low_pass_hz, fs=grid_hz, norm="mag"), x)
        if self.coupling_hz:
            x = lfilter(*butter(1, self.coupling_hz, "high", fs=grid_hz), x)
        x = self._sampled(x + self.reads_gravity)
        time_s = np.arange(x.size) / self.rate_hz
        turn = 2.0 * math.pi * self.mains_hz * time_s + 1.0
        mains = self.mains_g * (np.sin(turn) + 0.4 * np.sin(3.0 * turn))
        octaves = np.maximum(np.fft.rfftfreq(x.size, 1.0 / x.size), 1.0)
        pink = np.fft.irfft(np.fft.rfft(rng.standard_normal(x.size)) / np.sqrt(octaves), x.size)
        return np.asarray(V_PER_G * (x + mains + self.pink_g * pink / pink.std()) + self.bias_v)

    def _resonance(self, numerator: list[float], hz: float, damping: float, x: Floats) -> Floats:
        """``x`` behind ``numerator`` over s^2 + 2 damping s + 1, with s in units of 2 pi ``hz``."""
        w = 2.0 * math.pi * hz
        above = [part * w ** (3 - len(numerator) + i) for i, part in enumerate(numerator)]
        return np.asarray(lfilter(*bilinear(above, [1.0, 2.0 * damping * w, w * w], self.rate_hz * self.over), x))

    def contact_v(self, flights: Floats, n: int, rng: np.random.Generator) -> Floats:
        """Volts at each of ``n`` samples, without white noise; ``flights`` (m, 2) are take-off and landing, s."""
        opens = flights[:, 0].copy()
        opens[1:] = np.maximum(opens[1:], flights[:-1, 1] + self.held_closed_s)
        gaps = [np.column_stack([opens, flights[:, 1]])[opens < flights[:, 1]]]
        until = np.append(opens[1:], np.inf)
        for _ in range(3 if self.chatter_s else 0):
            begins = flights[:, 1] + rng.uniform(0.05, 1.0, len(flights)) * self.chatter_s
            ends = begins + rng.uniform(5e-6, 5e-5, begins.size)
            gaps.append(np.column_stack([begins, ends])[(ends < until) & (rng.random(begins.size) < 0.5)])
        edges = np.concatenate(gaps)
        edges = edges[np.argsort(edges[:, 0])]
        edges[:, 1] = np.minimum(edges[:, 1], np.append(edges[1:, 0], np.inf))
        times = np.append(-np.inf, edges.ravel())
        film = self.film_v * rng.lognormal(0.0, 0.3, len(edges) + 1)
        levels = np.append(film[0], np.column_stack([np.full(len(edges), OPEN_V), film[1:]]).ravel())
        tau = np.append(self.fall_s, np.tile([self.rise_s, self.fall_s], len(edges)))
        start = np.empty(times.size)  # voltage at which each piece begins
        start[0] = levels[0]
        for k in range(1, times.size):
            passed = math.exp(-(times[k] - times[k - 1]) / tau[k - 1])
            start[k] = levels[k - 1] + (start[k - 1] - levels[k - 1]) * passed
        times[0] = 0.0
        points = self.over if self.linear_phase else 1
        at_s = np.arange(n * points) / (self.rate_hz * points)
        piece = np.searchsorted(times, at_s, side="right") - 1
        v = levels[piece] + (start - levels)[piece] * np.exp(-(at_s - times[piece]) / tau[piece])
        return self._sampled(v) if self.linear_phase else v

    def _sampled(self, x: Floats) -> Floats:
        """Samples of a signal on the fine grid."""
        if not self.linear_phase:
            return x[:: self.over]
        half = FILTER_SAMPLES * self.over
        taps = firwin(2 * half + 1, 0.45 * self.rate_hz, fs=self.rate_hz * self.over)
        padded = np.concatenate([np.full(2 * half, x[0]), x])
        return np.asarray(upfirdn(taps, padded, down=self.over)[2 * FILTER_SAMPLES :][: x.size // self.over])

    def converted(self, volts: Floats, noise_v: float, rng: np.random.Generator) -> Floats:
        """Volts with a channel's white noise, as the card's numbers give them."""
        step_v = 2.0 * RANGE_V / 2**self.bits
        noisy = volts + noise_v * rng.standard_normal(volts.size)
        return np.clip(np.round(noisy / step_v) * step_v, -RANGE_V, RANGE_V - step_v)


def drawn(card: str, rng: np.random.Generator) -> Instrument:
    """An ordinary instrument with one of `CARDS`: sizes of its faults are drawn."""

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(math.log(low), math.log(high))))

    fine = card == "24-bit card"
    coupling_hz = float(rng.choice((0.0, 0.05, 0.16, 0.5)))
    return Instrument(
        rate_hz=float(rng.choice((25600.0, 51200.0) if fine else (20000.0, 50000.0))),
        over=8 if fine else 16,
        bits=24 if fine else 16,
        linear_phase=fine,
        low_pass_hz=0.0 if fine else float(rng.choice((2e3, 3e3, 5e3, 8e3))),
        coupling_hz=coupling_hz,
        reads_gravity=not coupling_hz and bool(rng.random() < 0.5),
        mount_hz=between(5e3, 9e3),
        table_hz=between(780.0, 1900.0),
        table_damping=between(0.02, 0.1),
        table_share=between(0.03, 0.1),
        push_s=between(1.5e-4, 4e-4),
        white_v=between(1e-4, 1e-3),
        pink_g=between(1e-3, 4e-3),
        mains_hz=float(rng.choice((50.0, 60.0))),
        mains_g=between(3e-4, 1e-2),
        bias_v=float(rng.uniform(-3e-3, 3e-3)),
        film_v=between(0.02, 0.2),
        chatter_s=float(rng.choice((0.0, 2e-4))),
        held_closed_s=float(rng.choice((0.0, 1.5e-4))),
        rise_s=between(1e-5, 5e-5),
        fall_s=between(2e-6, 1e-5),
    )
