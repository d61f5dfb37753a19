"""The instrument between the other plant's physics and its volts: sensor, filter, converter, contact circuit.

The accelerometer's chain works on a grid several times finer than the sampling, as an analogue circuit does; the
converter takes its samples from there. The contact's voltage is followed from edge to edge in closed form.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import bilinear, butter, firwin, lfilter, lfilter_zi, upfirdn

from benchmarks.plants.sensors import blocked
from kernels import njit
from kernels.arrays import Bools, Floats

V_PER_G = 0.1
RINGING = (14.0, 1800.0, 1e-3)  # of the table after an impact: g for each m/s, Hz, decay s
PULSE = (0.01, 1e-4)  # velocity that an impact gives the table, over the impact's; how long that takes, s
LATERAL_HZ, LATERAL_DAMPING, LATERAL_GAIN = 90.0, 0.05, 3.0  # of the table's sideways mode
FILM_SCATTER = 0.3  # of the film's resistance from contact to contact
CONTINUITY, ACCELEROMETER, DRIVE = range(3)
"""Channels in the order in which a multiplexed card takes them."""


@dataclass(frozen=True)
class Instrument:
    """Parts of the instrument; each default leaves its part out. The simulated rig's scenarios call them the same.

    Attributes
    ----------
    pulse
        An impact is a short push of the table, which does not ring.
    low_pass_hz, low_pass_poles
        Corner and order of the accelerometer's Butterworth low-pass, in front of the converter.
    high_pass_hz
        Corner of the coupling behind the accelerometer; a constant, gravity too, does not come through.
    mount_hz, mount_damping
        Resonance of the accelerometer on its mount; with a damping of 1 the sensitivity falls with frequency.
    cross_axis
        Part of the table's sideways acceleration that the accelerometer takes for a vertical one.
    sensor_clip_g
        Largest acceleration that the accelerometer gives.
    flicker_v
        1/f noise of the accelerometer, rms in each octave.
    bias_v, warm_up_v, warm_up_s
        Constant in the accelerometer's volts, and one that decays.
    contact_flicker_v
        The same in the contact circuit.
    mains_v, mains_odd, contact_mains_v, drive_mains_v
        Mains of 50 Hz in the channels, amplitudes; the accelerometer's k-th harmonic is ``mains_odd / k`` of it, k odd.
    fir_samples, fir_accelerometer_only
        Delay of a sigma-delta converter's linear-phase filter, in samples; whether the other channels have none.
    between_channels_s
        Time from one channel's sample to the next channel's.
    bounce_s
        A landed contact chatters no longer than this.
    film_v
        By so much a film raises the closed contact's voltage.
    rc_open_s, rc_close_s
        Time constants of the contact circuit's voltage.
    hysteresis_v
        Width between the thresholds of a comparator behind the contact circuit.
    """

    pulse: float = 0.0
    low_pass_hz: float = 0.0
    low_pass_poles: float = 2.0
    high_pass_hz: float = 0.0
    mount_hz: float = 0.0
    mount_damping: float = 0.05
    cross_axis: float = 0.0
    sensor_clip_g: float = 0.0
    flicker_v: float = 0.0
    bias_v: float = 0.0
    warm_up_v: float = 0.0
    warm_up_s: float = 5.0
    mains_v: float = 0.0
    mains_odd: float = 0.0
    contact_flicker_v: float = 0.0
    contact_mains_v: float = 0.0
    drive_mains_v: float = 0.0
    fir_samples: float = 0.0
    fir_accelerometer_only: float = 0.0
    between_channels_s: float = 0.0
    bounce_s: float = 0.0
    film_v: float = 0.0
    rc_open_s: float = 0.0
    rc_close_s: float = 0.0
    hysteresis_v: float = 0.0

    def shown_at_s(self, channel: int, rate_hz: float) -> float:
        """Time of what a sample of a channel shows, from the sample's own."""
        shift_s = channel * self.between_channels_s
        has_filter = channel == ACCELEROMETER or not self.fir_accelerometer_only
        return shift_s - (self.fir_samples / rate_hz if has_filter else 0.0)

    def mains(self, volts: float, odd: float, time_s: Floats) -> Floats:
        """A line at 50 Hz with its odd harmonics."""
        angle = 2.0 * math.pi * 50.0 * time_s + 1.0
        return np.asarray(volts * (np.sin(angle) + sum(odd / k * np.sin(k * angle) for k in (3, 5, 7))))


@njit()
def add_impacts(felt, impacts, grid_hz, size, hz, decay_s, pulse_s):
    """Add each impact's g from its exact time on: a decaying sine, or half a sine of the same length for all."""
    for k in range(impacts.shape[0]):
        start, speed = impacts[k, 0], impacts[k, 1]
        lasts = pulse_s if pulse_s > 0.0 else 12.0 * decay_s
        first = math.ceil(start * grid_hz)
        for i in range(first, min(int((start + lasts) * grid_hz) + 1, felt.size)):
            t = i / grid_hz - start
            if pulse_s > 0.0:
                felt[i] -= size * speed * math.sin(math.pi * t / pulse_s)
            else:
                felt[i] -= size * speed * math.exp(-t / decay_s) * math.sin(2.0 * math.pi * hz * t)


def through(x: Floats, b: Floats, a: Floats) -> Floats:
    """Behind a filter that has had the first value for long."""
    return np.asarray(lfilter(b, a, x, zi=lfilter_zi(b, a) * x[0])[0])


def _second_order(numerator: list[float], hz: float, damping: float, grid_hz: float) -> tuple[Floats, Floats]:
    """``numerator`` over s^2 + 2 damping w s + w^2 on the grid, s in units of w."""
    w = 2.0 * math.pi * hz
    scaled = [c * w ** (3 - len(numerator) + i) for i, c in enumerate(numerator)]
    b, a = bilinear(scaled, [1.0, 2.0 * damping * w, w * w], fs=grid_hz)
    return np.asarray(b), np.asarray(a)


def taken(part: Instrument, x: Floats, over: int, channel: int) -> Floats:
    """The converter's samples of a signal on a grid ``over`` times as fine; its filter delays them."""
    if part.fir_samples and (channel == ACCELEROMETER or not part.fir_accelerometer_only):
        half = int(part.fir_samples) * over
        taps = firwin(2 * half + 1, 1.0 / over, window=("kaiser", 8.0))
        padded = np.concatenate([np.full(2 * half, x[0]), x])
        first = 2 * int(part.fir_samples)
        return np.asarray(upfirdn(taps, padded, down=over)[first : first + x[::over].size])
    return x[::over]


def accelerometer_v(
    part: Instrument,
    felt_g: Floats,
    impacts: Floats,
    rate_hz: float,
    over: int,
    noise_g: float,
    rng: np.random.Generator,
) -> Floats:
    """Volts of the accelerometer at each sample.

    Parameters
    ----------
    part : Instrument
    felt_g : (n over,)
        What an ideal sensor on a table that does not ring would feel, on the fine grid.
    impacts : (k, 2)
        Times, s, and speeds, m/s.
    rate_hz, over
        Samples a second, and points of the grid for each.
    noise_g
        White noise, rms up to half the sampling rate; it passes the filters.
    rng : numpy.random.Generator
    """
    grid_hz, n = rate_hz * over, felt_g.size // over
    x = np.array(felt_g)
    if part.pulse:
        share, lasts_s = PULSE
        add_impacts(x, impacts, grid_hz, share * math.pi / (2.0 * lasts_s) / 9.80665, 0.0, 1.0, lasts_s)
    else:
        add_impacts(x, impacts, grid_hz, *RINGING, 0.0)
    if part.cross_axis:
        sideways = _second_order([2.0 * LATERAL_DAMPING * LATERAL_GAIN, 0.0], LATERAL_HZ, LATERAL_DAMPING, grid_hz)
        x = x + part.cross_axis * through(x, *sideways)
    if part.mount_hz:
        x = through(x, *_second_order([1.0], part.mount_hz, part.mount_damping, grid_hz))
    if part.sensor_clip_g:
        x = np.clip(x, -part.sensor_clip_g, part.sensor_clip_g)
    if part.high_pass_hz:
        x = blocked(x - x[0], part.high_pass_hz / grid_hz)
    filtered = part.low_pass_hz or part.fir_samples
    if filtered:
        noise = noise_g * math.sqrt(over) * rng.standard_normal(x.size)
        noise[0] = 0.0  # the filters have had the first value for long
        x = x + noise
    if part.low_pass_hz:
        x = through(x, *butter(int(part.low_pass_poles), part.low_pass_hz / (grid_hz / 2.0)))
    shift_s = ACCELEROMETER * part.between_channels_s
    if shift_s:
        where = np.arange(x.size, dtype=float)
        x = np.interp(where + shift_s * grid_hz, where, x)
    volts = V_PER_G * taken(part, x, over, ACCELEROMETER)
    if not filtered:
        volts = volts + V_PER_G * noise_g * rng.standard_normal(n)
    time_s = np.arange(n) / rate_hz + shift_s
    if part.flicker_v:
        volts = volts + flicker(n, part.flicker_v, rng)
    volts = volts + part.bias_v + part.warm_up_v * np.exp(-time_s / part.warm_up_s)
    return np.asarray(volts + part.mains(part.mains_v, part.mains_odd, time_s))


def flicker(n: int, rms_an_octave: float, rng: np.random.Generator) -> Floats:
    """1/f noise of so much rms in each octave; one octave has the power that one bin's share ``1/k ln 2`` has."""
    k = np.fft.rfftfreq(n, 1.0 / n)
    k[0] = np.inf
    spectrum = np.fft.rfft(rng.standard_normal(n)) / np.sqrt(k)
    return np.asarray(rms_an_octave * math.sqrt(n / (2.0 * math.log(2.0))) * np.fft.irfft(spectrum, n))


def chattering(part: Instrument, times: Floats, opens: Bools, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """The contact's edges, and up to three short openings after each landing, none later than the next take-off."""
    if not part.bounce_s or not times.size:
        return times, opens
    landing = np.flatnonzero(~opens)
    until = np.append(times[1:], np.inf)[landing]
    at = np.repeat(times[landing], 3) + part.bounce_s * rng.uniform(0.0, 0.8, 3 * landing.size)
    back = at + part.bounce_s * rng.uniform(0.02, 0.2, at.size)
    chosen = (rng.random(at.size) < 0.6) & (back < np.repeat(until, 3))
    every = np.concatenate([times, at[chosen], back[chosen]])
    kind = np.concatenate([opens, np.ones(chosen.sum(), bool), np.zeros(chosen.sum(), bool)])
    order = np.argsort(every, kind="stable")
    return every[order], kind[order]


@njit()
def _follow(times, opens, levels, at_s, rc_open_s, rc_close_s, low_v, high_v, out):
    """Voltage at each time: runs to the level of the present state; behind a comparator, one of two levels."""
    v = levels[0]
    level, rc_s, now, j, says_open = levels[0], rc_close_s, 0.0, 0, False
    for i in range(at_s.size):
        while True:
            until = min(times[j], at_s[i]) if j < times.size else at_s[i]
            v = level + (v - level) * math.exp(-max(until - now, 0.0) / rc_s) if rc_s > 0.0 else level
            now = max(until, now)
            says_open = v > (low_v if says_open else high_v)
            if j >= times.size or times[j] > at_s[i]:
                break
            level, rc_s = levels[j + 1], (rc_open_s if opens[j] else rc_close_s)
            j += 1
        out[i] = (4.96 if says_open else 0.03) if high_v > low_v else v


def contact_v(
    part: Instrument,
    times: Floats,
    opens: Bools,
    rate_hz: float,
    over: int,
    n: int,
    rng: np.random.Generator,
) -> Floats:
    """Volts of the contact circuit at each of ``n`` samples, noise apart.

    Parameters
    ----------
    times, opens : (k,)
        When the circuit changes, s, and whether it opens then.
    """
    times, opens = chattering(part, times, opens, rng)
    film = part.film_v * (1.0 + FILM_SCATTER * rng.standard_normal(times.size))
    levels = np.append(0.03 + part.film_v, np.where(opens, 4.96, 0.03 + film))
    fine = over if part.fir_samples and not part.fir_accelerometer_only else 1
    at_s = np.arange(n * fine) / (rate_hz * fine) + CONTINUITY * part.between_channels_s
    volts = np.empty(at_s.size)
    threshold = 2.5 - part.hysteresis_v / 2.0, 2.5 + part.hysteresis_v / 2.0
    _follow(times, opens, levels, at_s, part.rc_open_s, part.rc_close_s, *threshold, volts)
    volts = taken(part, volts, fine, CONTINUITY)
    if part.contact_flicker_v:
        volts = volts + flicker(n, part.contact_flicker_v, rng)
    return volts + part.mains(part.contact_mains_v, 0.0, at_s[::fine])
