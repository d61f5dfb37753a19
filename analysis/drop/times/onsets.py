"""Impacts in a sound recording, to the sample; and in a contact channel with the plate at rest.

An onset is a change of the signal's statistics, not a crossing of a level. Candidates are short rises of log energy
over many frequency bands (a faint tap over a hum counts as much as a loud one); each is refined by the Akaike
information criterion of a two-part signal (Maeda 1985).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import linalg, signal

from analysis.drop.corrections import Progress
from analysis.drop.times.impact_chain import Onsets
from analysis.statistics import mad_sigma
from daq.files.wav import open_wav
from daq.recording import Recording, open_recording
from daq.setup.errors import InputError
from kernels.arrays import Floats

_WINDOW_S = 0.006
_HOP_S = 0.001
_BEFORE_S = 0.012  # of what is compared at a candidate
_LEAST_SPACING_S = 0.012
_LOWEST_HZ = 150.0  # below it hum and handling
_PREDICTOR = 64  # samples that are looked back
_BLOCK = 1 << 20  # samples of a contact channel read at once


def onsets_of_file(path: Path, progress: Progress | None = None) -> Onsets:
    """Onsets in a WAV file of any length; long files are read in overlapping pieces.

    Raises `InputError` for a file that is no WAV or too short, and where nothing stands out.
    """
    wav = open_wav(path)
    rate = wav.rate_hz
    if wav.n_samples < 0.05 * rate:  # of a sound that may hold a drop
        raise InputError(f"{path}: {wav.n_samples} samples at {rate:.0f} Hz hold no drop; the file may be cut off")
    if wav.n_samples <= 30.0 * rate:  # of a sound that is read at once
        return sound_onsets(wav.read(), rate, str(path))
    # a long sound is read in pieces of 20 s, with a second more on both sides
    core, margin = int(20.0 * rate), int(1.0 * rate)
    found: list[Onsets] = []
    refused: InputError | None = None
    for start in range(0, wav.n_samples, core):
        first = max(start - margin, 0)
        try:
            piece = sound_onsets(wav.read(first, start + core + margin), rate, str(path))
        except InputError as error:
            refused = error
            continue
        times = piece.times_s + first / rate
        own = (times >= start / rate) & (times < (start + core) / rate)
        found.append(piece._replace(times_s=times).part(own))
        if progress is not None:
            progress("listening", min(start + core, wav.n_samples) // int(rate), wav.n_samples // int(rate))
    if not found and refused is not None:
        raise refused
    return Onsets(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def sound_onsets(samples: Floats, rate_hz: float, where: str) -> Onsets:
    """Onsets in a sound that fits in memory; raises `InputError` where nothing stands out.

    ``samples`` are (n,) or (n, channels), channels judged together; ``where`` names the file in an error.
    """
    x = np.atleast_2d(np.asarray(samples, dtype=np.float64).T).T
    if not np.isfinite(x).all():
        bad = int((~np.isfinite(x)).any(axis=1).sum())
        raise InputError(f"{where}: damaged: {bad} samples are no numbers; export it again as 16-bit PCM WAV")
    x = x[:, np.ptp(x, axis=0) > 0.0]
    if x.shape[1] == 0:
        raise InputError(f"{where}: every sample is the same; the recording is silent")
    band = (_LOWEST_HZ, min(0.45 * rate_hz, 16_000.0))
    filtered = signal.sosfilt(signal.butter(2, band, "bandpass", fs=rate_hz, output="sos"), x, axis=0)
    rise, hop = _rise(filtered, rate_hz)
    centre, width = float(np.median(rise)), mad_sigma(rise - np.median(rise))
    spacing = max(int(_LEAST_SPACING_S * rate_hz / hop), 1)
    # five robust widths of the rise where nothing happens
    peaks, _ = signal.find_peaks(rise, height=centre + 5.0 * width, distance=spacing)
    if not len(peaks):
        raise InputError(f"{where}: no sound in it stands out as an impact would; record nearer to the plate")
    white = np.column_stack([_without_background(channel, rate_hz) for channel in filtered.T])
    near = [int(p) * hop for p in peaks]
    onsets = np.array([max(_refine(filtered, n, rate_hz), _refine(white, n, rate_hz))[1] for n in near])
    times, first = np.unique(onsets / rate_hz, return_index=True)
    strength = np.maximum(*(_strength(x, onsets[first], rate_hz) for x in (filtered, white)))  # dull; under a hum
    own = np.append(True, (np.diff(times) > _LEAST_SPACING_S) | (strength[1:] > strength[:-1]))
    first = first[own]  # what follows a stronger onset at once is its ring
    peak, top = (_peaks(np.abs(y).max(axis=1), onsets[first], rate_hz) for y in (filtered, x))
    loudness = np.where(top < 0.985, np.log(np.maximum(peak, 1e-12) + 1e-12), np.nan)  # of full scale
    return Onsets(times[own], strength[own], loudness)


def _peaks(loud: Floats, onsets: Floats, rate_hz: float) -> Floats:
    """Largest value of ``loud`` just after each onset."""
    reach = int(0.01 * rate_hz)
    return np.array([loud[int(n) : int(n) + reach].max(initial=0.0) for n in onsets])


def _without_background(x: Floats, rate_hz: float) -> Floats:
    """The sound less its linear prediction from the background: hum, fans and voices mostly go, onsets stay.

    The prediction comes from the median spectrum, which taps do not reach; it looks back only, so nothing is heard
    before it happens.
    """
    window = min(int(0.04 * rate_hz), len(x))
    _, power = signal.welch(x, rate_hz, nperseg=window, average="median")
    correlation = np.fft.irfft(power)[: _PREDICTOR + 1]
    correlation[0] *= 1.0 + 1e-7  # of the background's power: white noise that keeps the prediction stable
    ahead = linalg.solve_toeplitz(correlation[:-1], correlation[1:]) if correlation[0] > 0.0 else np.zeros(_PREDICTOR)
    return np.asarray(signal.lfilter(np.concatenate(([1.0], -ahead)), [1.0], x), dtype=np.float64)


def _strength(x: Floats, onsets: Floats, rate_hz: float) -> Floats:
    """Loudness (log peak) of each onset between the recording's floor (0) and the loudest within reach (1).

    An onset that is hardly louder than what is just before it counts for less.
    """
    loud = np.abs(x).max(axis=1)
    peaks = np.log(_peaks(loud, onsets, rate_hz) + 1e-12)
    floor = np.log(np.median(loud) * 4.0 + 1e-12)
    near = np.abs(onsets[:, None] - onsets[None]) < 0.5 * rate_hz
    top = np.where(near, peaks[None], -np.inf).max(axis=1)
    among = np.clip((peaks - floor) / np.maximum(top - floor, 1e-6), 0.02, 1.0)
    # for 6 ms before an onset the sound must be quieter than after it
    back, gap = int(0.006 * rate_hz), max(int(0.0005 * rate_hz), 1)
    before = [loud[max(int(n) - back, 0) : max(int(n) - gap, 1)].max(initial=0.0) for n in onsets]
    # less than a factor of e is a ring, or a clipped swing, of the impact before
    risen = peaks - np.log(np.array(before) + 1e-12)
    return np.asarray(among * np.clip(risen, 0.05, 1.0))


def _rise(x: Floats, rate_hz: float) -> tuple[Floats, int]:
    """Mean over bands of the rise of log energy from just before to just after each hop; and the hop in samples."""
    hop, window = max(int(_HOP_S * rate_hz), 1), max(int(_WINDOW_S * rate_hz), 16)
    padded = np.pad(x, ((window // 2, window), (0, 0)))
    taper = np.hanning(window)
    power: Any = 0.0
    for channel in padded.T:
        frames = sliding_window_view(channel, window)[::hop]
        power = power + np.abs(np.fft.rfft(frames * taper, axis=1)) ** 2
    bands = np.fft.rfftfreq(window, 1.0 / rate_hz)
    used = (bands > 0.5 * _LOWEST_HZ) & (bands < 12_000.0)
    power, share = power[:, used], bands[used] ** -0.5  # octaves count nearly alike: late taps are dull
    level = np.log(power + np.median(power, axis=0) * 0.1 + 1e-20)
    before = max(int(_BEFORE_S / _HOP_S), 1)
    half = max(int(_WINDOW_S / _HOP_S / 2), 1)
    past = np.stack([np.roll(level, half + lag, axis=0) for lag in range(before)]).mean(axis=0)
    rise = np.maximum(np.roll(level, -half, axis=0) - past, 0.0)
    rise[: before + half] = rise[-half - 1 :] = 0.0
    return np.asarray(rise @ (share / share.sum())), hop


def _refine(x: Floats, near: int, rate_hz: float) -> tuple[float, float]:
    """Sharpness and place (a sample) of a change of variance: depth and place of the minimum of Maeda's criterion."""
    start = max(near - int(_BEFORE_S * rate_hz), 0)
    part = x[start : near + int(2 * 0.004 * rate_hz)]
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
    undivided = len(part) * float(np.log(total[-1] / len(part) + tiny).sum())
    return undivided - float(criterion[at]), float(start + at + 1)


def contact_onsets(path: Path) -> Floats:
    """Times at which the contact circuit of a recording closes, s.

    Raises `InputError` without a continuity channel, or for a circuit that never opens and closes.
    """
    with open_recording(path) as recording:
        _refuse_driven(recording)
        channel = recording.setup.channels.continuity
        if channel is None or "continuity" not in recording.channels:
            raise InputError(f"{path}: has no continuity channel; a drop test by contact needs one")
        sign = 1.0 if channel.swing_v < 0.0 else -1.0
        times = [np.empty(0)]
        before = True  # closed, so that a ball at rest at the beginning is no impact
        for start in range(0, recording.n_samples, _BLOCK):
            volts = recording.read_v("continuity", start, min(start + _BLOCK, recording.n_samples))
            closed = sign * (volts - channel.middle_v) > 0.0
            edges = np.flatnonzero(closed & ~np.concatenate(([before], closed[:-1])))
            times.append((edges + start) / recording.rate_hz)
            before = bool(closed[-1])
    events = np.concatenate(times)
    if len(events) < 3:
        raise InputError(f"{path}: the contact circuit closes {len(events)} times; a drop test needs three impacts")
    return events[np.diff(events, prepend=-np.inf) > _LEAST_SPACING_S]


def _refuse_driven(recording: Recording) -> None:
    """Refuse a plate that is driven: it makes impacts of its own."""
    path, steps = recording.path, recording.steps
    top = float(steps["gamma"].max(initial=0.0)) if len(steps) else 0.0
    if top > 0.0 or len(recording.drive_changes):
        raise InputError(
            f"{path}: the plate is driven in this recording (gamma up to {top:.3g}); a drop test needs the plate at "
            "rest. To find what a ramp's flights lack, use: bench close-loop"
        )
    if "accelerometer" in recording.channels:
        stop = min(recording.n_samples, int(20.0 * recording.rate_hz))  # how long a plate is looked at
        volts = recording.read_v("accelerometer", 0, stop)
        shaken = mad_sigma(volts - np.median(volts)) / abs(recording.setup.channels.accelerometer.volts_per_mps2)
        if shaken > 1.0:  # what a plate at rest reads at most
            raise InputError(
                f"{path}: the plate shakes by {shaken:.2g} m/s^2 (median); a drop test needs the plate at rest"
            )
