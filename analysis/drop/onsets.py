"""Impacts in a sound recording, to the sample; and in a contact channel with the plate at rest.

The rule kept here: an onset is where the signal's statistics change, not where it crosses a level. Candidates are
short rises of log energy over many frequency bands (so a faint tap over a hum counts as much as a loud one); each is
refined by the Akaike information criterion of a two-part signal (Maeda 1985).
"""

from __future__ import annotations

import warnings
import wave
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy import linalg, signal

from analysis.statistics import mad_sigma
from daq.recording import open_recording
from daq.setup.errors import InputError

Array = NDArray[np.float64]

_WINDOW_S, _HOP_S = 0.006, 0.001
_BEFORE_S, _AFTER_S = 0.012, 0.004  # what is compared at a candidate
_LEAST_SPACING_S = 0.012
_MOST_CANDIDATES = 120
_LOUDNESS_S, _NEIGHBOUR_S = 0.01, 0.5
_LEAST_RISE = 5.0  # in robust widths of the rise where nothing happens
_SPECTRUM_S = 0.04
_PREDICTOR = 64  # samples that are looked back
_LOUDEST_NOTHING = 1e-7  # of the background's power: white noise that keeps the prediction stable
_LOWEST_HZ = 150.0  # below it hum and handling


def read_wav(path: Path) -> tuple[Array, float]:
    """Samples (n, channels), full scale 1, and the rate in Hz.

    Raises
    ------
    InputError
        Not a WAV file of 8, 16, 24 or 32 bit PCM samples, or hardly any sound in it.
    """
    try:
        with wave.open(str(path), "rb") as file:
            rate, width, channels = file.getframerate(), file.getsampwidth(), file.getnchannels()
            raw = file.readframes(file.getnframes())
    except (wave.Error, EOFError, RuntimeError) as error:  # RuntimeError: a chunk longer than the file
        return _read_other_wav(path, error)
    values = _pcm(raw, width)
    values = values[: len(values) // channels * channels].reshape(-1, channels)
    if len(values) < 0.05 * rate:
        raise InputError(f"{path}: {len(values)} samples at {rate} Hz hold no drop; the file may be cut off")
    return values, float(rate)


def _read_other_wav(path: Path, reason: Exception) -> tuple[Array, float]:
    """Float WAV, which the standard library does not read."""
    from scipy.io import wavfile

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", wavfile.WavFileWarning)  # extra chunks are none of our business
            rate, values = wavfile.read(path)
    except (ValueError, EOFError, UnboundLocalError) as error:  # the last: no format chunk at all
        raise InputError(f"{path}: not a readable WAV file ({reason}); export it as 16-bit PCM WAV") from error
    full = float(np.iinfo(values.dtype).max) + 1.0 if np.issubdtype(values.dtype, np.signedinteger) else 1.0
    return np.atleast_2d(np.asarray(values, dtype=np.float64).T).T / full, float(rate)


def _pcm(raw: bytes, width: int) -> Array:
    if width == 3:
        bytes3 = np.frombuffer(raw[: len(raw) // 3 * 3], dtype=np.uint8).reshape(-1, 3).astype(np.int32)
        word = bytes3[:, 0] | bytes3[:, 1] << 8 | bytes3[:, 2] << 16
        return np.where(word >= 1 << 23, word - (1 << 24), word) / float(1 << 23)
    raw = raw[: len(raw) // width * width]
    if width == 1:
        return (np.frombuffer(raw, dtype=np.uint8).astype(np.float64) - 128.0) / 128.0
    kinds: dict[int, Any] = {2: "<i2", 4: "<i4"}
    return np.frombuffer(raw, dtype=kinds[width]) / float(1 << (8 * width - 1))


def sound_onsets(samples: Array, rate_hz: float, where: str) -> tuple[Array, Array]:
    """Onset times in a sound, s, and how much each stands out among its neighbours (0 to 1).

    Parameters
    ----------
    samples : (n,) or (n, channels) float64
        The sound; channels are judged together.
    rate_hz : float
        Sampling rate.
    where : str
        File, for the error text.

    Raises
    ------
    InputError
        Silence, or nothing that stands out.
    """
    x = np.atleast_2d(np.asarray(samples, dtype=np.float64).T).T
    x = x[:, np.ptp(x, axis=0) > 0.0]
    if x.shape[1] == 0:
        raise InputError(f"{where}: every sample is the same; the recording is silent")
    top = min(0.45 * rate_hz, 16_000.0)
    filtered = signal.sosfilt(signal.butter(2, (_LOWEST_HZ, top), "bandpass", fs=rate_hz, output="sos"), x, axis=0)
    rise, hop = _rise(filtered, rate_hz)
    centre, width = float(np.median(rise)), mad_sigma(rise - np.median(rise))
    peaks, found = signal.find_peaks(
        rise, height=centre + _LEAST_RISE * width, distance=max(int(_LEAST_SPACING_S * rate_hz / hop), 1)
    )
    strongest = np.sort(peaks[np.argsort(found["peak_heights"])[::-1][:_MOST_CANDIDATES]])
    if not len(strongest):
        raise InputError(f"{where}: no sound in it stands out as an impact would; record nearer to the plate")
    white = np.column_stack([_without_background(channel, rate_hz) for channel in filtered.T])
    near = [int(p) * hop for p in strongest]
    onsets = np.array([max(_refine(filtered, n, rate_hz), _refine(white, n, rate_hz))[1] for n in near])
    times, first = np.unique(onsets / rate_hz, return_index=True)
    strength = [_strength(x, onsets[first], rate_hz) for x in (filtered, white)]  # dull taps; taps under a hum
    return times, np.maximum(*strength)


def _without_background(x: Array, rate_hz: float) -> Array:
    """What a linear prediction from the background does not foresee: hum, fans and voices mostly go, onsets stay.

    The prediction comes from the median spectrum, which taps do not reach; it looks back only, so nothing is heard
    before it happens.
    """
    window = min(int(_SPECTRUM_S * rate_hz), len(x))
    _, power = signal.welch(x, rate_hz, nperseg=window, average="median")
    correlation = np.fft.irfft(power)[: _PREDICTOR + 1]
    correlation[0] *= 1.0 + _LOUDEST_NOTHING
    ahead = linalg.solve_toeplitz(correlation[:-1], correlation[1:]) if correlation[0] > 0.0 else np.zeros(_PREDICTOR)
    return np.asarray(signal.lfilter(np.concatenate(([1.0], -ahead)), [1.0], x), dtype=np.float64)


def _strength(x: Array, onsets: Array, rate_hz: float) -> Array:
    """Loudness (log peak) of each onset between the recording's floor (0) and the loudest within reach (1)."""
    loud = np.abs(x).max(axis=1)
    reach = int(_LOUDNESS_S * rate_hz)
    peaks = np.log(np.array([loud[int(n) : int(n) + reach].max(initial=0.0) for n in onsets]) + 1e-12)
    floor = np.log(np.median(loud) * 4.0 + 1e-12)
    near = np.abs(onsets[:, None] - onsets[None]) < _NEIGHBOUR_S * rate_hz
    top = np.where(near, peaks[None], -np.inf).max(axis=1)
    return np.asarray(np.clip((peaks - floor) / np.maximum(top - floor, 1e-6), 0.02, 1.0))


def _rise(x: Array, rate_hz: float) -> tuple[Array, int]:
    """Mean over bands of the rise of log energy from just before to just after each hop; and the hop in samples."""
    hop, window = max(int(_HOP_S * rate_hz), 1), max(int(_WINDOW_S * rate_hz), 16)
    mono = np.pad(x, ((window // 2, window), (0, 0)))
    taper = np.hanning(window)
    power: Any = 0.0
    for channel in mono.T:
        frames = sliding_window_view(channel, window)[::hop]
        power = power + np.abs(np.fft.rfft(frames * taper, axis=1)) ** 2
    bands = np.fft.rfftfreq(window, 1.0 / rate_hz)
    keep = (bands > 0.5 * _LOWEST_HZ) & (bands < 12_000.0)
    power, share = power[:, keep], bands[keep] ** -0.5  # octaves count nearly alike: late taps are dull
    level = np.log(power + np.median(power, axis=0) * 0.1 + 1e-20)
    before = max(int(_BEFORE_S / _HOP_S), 1)
    half = max(int(_WINDOW_S / _HOP_S / 2), 1)
    past = np.stack([np.roll(level, half + lag, axis=0) for lag in range(before)]).mean(axis=0)
    rise = np.maximum(np.roll(level, -half, axis=0) - past, 0.0)
    rise[: before + half] = rise[-half - 1 :] = 0.0
    return np.asarray(rise @ (share / share.sum())), hop


def _refine(x: Array, near: int, rate_hz: float) -> tuple[float, float]:
    """How sharply the signal's variance changes, and where: the depth and place of the minimum of Maeda's criterion."""
    start = max(near - int(_BEFORE_S * rate_hz), 0)
    part = x[start : near + int(2 * _AFTER_S * rate_hz)]
    peak = int(np.abs(part).max(axis=1).argmax())
    part = part[: max(peak + 2, 16)]
    n = np.arange(1, len(part))[:, None]
    total = np.cumsum(part**2, axis=0)
    head = total[:-1] / n
    tail = (total[-1] - total[:-1]) / (len(part) - n)
    tiny = 1e-12 * float(total[-1].max()) / len(part) + 1e-300
    criterion = (n * np.log(head + tiny) + (len(part) - n) * np.log(tail + tiny)).sum(axis=1)
    edge = 4
    at = edge + int(criterion[edge:-1].argmin())
    alone = len(part) * float(np.log(total[-1] / len(part) + tiny).sum())
    return alone - float(criterion[at]), float(start + at + 1)


def contact_onsets(path: Path) -> tuple[Array, float]:
    """Times at which the contact circuit of a recording closes, s, and one sample as their uncertainty.

    Raises
    ------
    InputError
        No continuity channel, or a circuit that never opens and closes.
    """
    with open_recording(path) as recording:
        channel = recording.setup.channels.continuity
        if channel is None or "continuity" not in recording.channels:
            raise InputError(f"{path}: has no continuity channel; a drop test by contact needs one")
        level = channel.middle_v
        sign = 1.0 if channel.swing_v < 0.0 else -1.0
        times: list[Array] = []
        before, block = True, 1 << 20
        for start in range(0, recording.n_samples, block):
            volts = recording.read_v("continuity", start, min(start + block, recording.n_samples))
            closed = sign * (volts - level) > 0.0
            edges = np.flatnonzero(closed & ~np.concatenate(([before], closed[:-1])))
            times.append((edges + start) / recording.rate_hz)
            before = bool(closed[-1])
        rate = recording.rate_hz
    events = np.concatenate(times)
    if len(events) < 3:
        raise InputError(f"{path}: the contact circuit closes {len(events)} times; a drop test needs three impacts")
    apart = np.concatenate(([True], np.diff(events) > _LEAST_SPACING_S))
    return events[apart], 1.0 / rate
