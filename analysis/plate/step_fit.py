"""From folded normal equations to a step's plate motion: gamma, phase, gated fits, slow lines, amplitude in time.

The rule kept here: volts become m/s^2 by the setup's signed sensitivity in one place, and gamma is stated from the
accelerometer; the drive's version stands beside it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from analysis.plate.contact_flight_fit import ContactFlightFit, scaled
from analysis.plate.fit_mask import FitIntervals
from analysis.plate.mains_lines import doubted
from analysis.plate.motion import SlowMotion, StepPlate, Windows
from analysis.plate.windows import second_look as fit_windows
from daq.lock_in import LockIn, ToneFit
from daq.recording import Recording
from daq.setup.setup import Setup
from model.tones import Plate

if TYPE_CHECKING:
    from analysis.plate.accumulator import StepState

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]
WINDOW_CYCLES = 2.0
LEAST_DRIFT = 1e-4  # radians over the step that a wrong frequency must make to be corrected
LEAST_WINDOWS = 4
SWELL_KNOWN = 0.5  # relative: windows need not cover a step
SLOW_PER_CYCLE = 4.0  # values of the slow series per period of the forcing


@dataclass(frozen=True)
class ChunkFit:
    """What a second look at a chapter gave, in volts.

    ``slow`` at ``slow_s``; per window of a few cycles its middle ``time_s``, amplitudes (w, tones, channels) and the
    relative spread (w, tones) that times a channel's ``noise`` (channels,) is an amplitude's uncertainty; the fit of
    each channel, and what was kept for it. The noise is the rms about the tones within windows: what swells slowly is
    none.
    """

    slow_s: Floats
    slow: Floats
    time_s: Floats
    amplitudes: Complexes
    spread: Floats
    noise: Floats
    fits: tuple[ToneFit, ToneFit]
    kept: FitIntervals


def second_look(fold: StepState, rate_hz: float) -> ChunkFit | None:
    """Slow motion, and the forcing's tones a few cycles at a time; None where the tones cannot be fitted."""
    folded = fold.folded
    if folded is None:
        return None
    clear = folded.part(fold.clear_sorts())
    try:
        fits = clear.solve(0), clear.solve(1)
    except ValueError:
        return None
    amplitudes, offsets = np.array([f.amplitudes for f in fits]), np.array([f.offset for f in fits])
    rows = np.array(fold.rows)
    group = max(int(rate_hz / (SLOW_PER_CYCLE * fold.frequency_hz)), 1)
    length = max(round(WINDOW_CYCLES * rate_hz / fold.frequency_hz), 1)
    q = 2 * rows.size + 1
    bands = folding_bands(folded)
    parts, kept, counted = [], [], 0
    for span in fold.spans:
        n, keep = span.sort.size, span.sort % bands >= fold.mask_level
        slow, seen = np.zeros(n // group), np.zeros(n // group, dtype=np.int64)
        windows = n // length
        gram, side, power = np.zeros((windows, q, q)), np.zeros((windows, q, 2)), np.zeros((windows, 2))
        used = np.zeros(windows, dtype=np.int64)
        fit_windows(
            span.values,
            keep,
            span.first,
            folded.frequencies_hz / rate_hz,
            folded.response(),
            amplitudes,
            offsets,
            rows,
            group,
            slow,
            seen,
            length,
            gram,
            side,
            power,
            used,
        )
        slow_s = (span.first + (np.arange(slow.size) + 0.5) * group) / rate_hz
        time_s = (span.first + (np.arange(windows) + 0.5) * length) / rate_hz
        enough = used >= max(0.4 * length, 2 * q)
        of = np.append(np.where(enough, counted + np.cumsum(enough) - 1, -1), -1)
        within = of[np.minimum(np.arange(n) // length, windows)]
        kept.append(FitIntervals.of_blocks(span.first, keep, within, span.sort // bands == 0, 1.0 / rate_hz))
        counted += int(enough.sum())
        slow = np.where(seen > 0, slow / np.maximum(seen, 1), np.nan)
        parts.append((slow_s, slow, *(column[enough] for column in (time_s, gram, side, power, used))))
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    slow_s, slow, time_s, gram, side, power, count = (np.asarray(column, dtype=np.float64) for column in columns)
    inverse = np.linalg.inv(gram + 1e-9 * np.eye(q))  # every window holds enough; the ridge is for the odd one
    solution = inverse @ side
    z = amplitudes[:, rows].T[None] + solution[:, 1::2] + 1j * solution[:, 2::2]
    spread = np.sqrt(np.diagonal(inverse, axis1=1, axis2=2)[:, 1:].reshape(-1, rows.size, 2).mean(axis=2))
    left = np.maximum(power.sum(axis=0) - np.sum(side * solution, axis=(0, 1)), 0.0)
    freedom = float(count.sum()) - q * count.size
    noise = np.sqrt(left / freedom) if freedom > 0.0 else np.array([f.rms for f in fits])
    none = np.zeros(len(kept), dtype=np.int64)
    return ChunkFit(slow_s, slow, time_s, z, spread, noise, fits, FitIntervals.join(kept, none, none))


def folding_bands(folded: LockIn) -> int:
    """Bands of each place in the sorts of a fold."""
    return folded.counts.size // 3


def refined_hz(fold: StepState, look: ChunkFit, has_drive: bool) -> tuple[float, float, bool] | None:
    """Frequency, its uncertainty, and whether it differs from the step table's by more than chance.

    The phase of the strongest forcing tone is followed from window to window, in the drive where it was recorded (it
    carries neither impacts nor the ball), else in the accelerometer. None where there are too few windows.
    """
    if look.time_s.size < 4:
        return None
    channel = 1 if has_drive else 0
    multiples = np.array([fold.multiples[r] for r in fold.rows])
    strongest = int(np.argmax(np.abs(look.amplitudes[:, :, channel]).mean(axis=0) * multiples))
    z = look.amplitudes[:, strongest, channel]
    sigma = look.fits[channel].rms * look.spread[:, strongest] / np.maximum(np.abs(z), 1e-300)
    if np.median(sigma) > 0.3:
        return None
    weight = 1.0 / np.maximum(sigma, 1e-9) ** 2
    time_s = look.time_s - np.average(look.time_s, weights=weight)
    bend = float(np.sum(weight * time_s**2))
    scale = 2.0 * np.pi * float(multiples[strongest])
    away = float(np.sum(weight * time_s * np.unwrap(np.angle(z)))) / bend / scale
    error = 1.0 / np.sqrt(bend) / scale
    changed = abs(away) > 4.0 * error and abs(away) * 2.0 * np.pi * fold.hold_s > LEAST_DRIFT
    return (fold.nominal_hz + away, error, True) if changed else (fold.nominal_hz, error, False)


def gamma_of(amplitudes: Complexes, multiples: tuple[int, ...], setup: Setup, ratio: int) -> float:
    """``A w^2 / g`` of tones in m/s^2: from the first tone, or the second where the first has no amplitude."""
    g = setup.g_mps2.value
    tones = dict(setup.forcing.displacement_tones())
    if setup.forcing.ratio != ratio:
        tones = {1: 1.0 + 0j, ratio: 1.0 + 0j} if ratio > 1 else {1: 2.0 + 0j}
    for multiple in sorted(tones):
        if abs(tones[multiple]) > 1e-9 and multiple in multiples:
            return float(abs(amplitudes[multiples.index(multiple)])) / (g * abs(tones[multiple]) * multiple**2)
    return float("nan")


def gamma_peak_of(plate: Plate, frequency_hz: float, g_mps2: float) -> float:
    """``max(-a_p) / g`` over one period of the forcing."""
    t = np.linspace(0.0, 1.0 / frequency_hz, 361)
    return float(np.max(-plate.acceleration_at(t))) / g_mps2


def step_plate(recording: Recording, fold: StepState) -> StepPlate | None:
    """Everything about one step, in SI; None where the step is too short for its tones."""
    if fold.folded is None:
        return None
    total = fold.folded.part(fold.clear_sorts())
    fits = fold.looks[0].fits if len(fold.looks) == 1 else None
    try:
        volts = fits[0] if fits is not None else total.solve(0)
        drive = None if "drive" not in recording.channels else fits[1] if fits is not None else total.solve(1)
    except ValueError:
        return None
    setup = recording.setup
    channel = setup.channels.accelerometer
    factor = 1.0 / channel.volts_per_mps2
    zero_v = channel.offset_v.value if channel.offset_v is not None else 0.0
    acceleration = scaled(volts, factor, zero_v)
    rows, multiples = fold.rows, fold.multiples
    windows = _windows(fold, factor, len(rows))
    quiet = min((float(k.noise[0]) for k in fold.looks), default=volts.rms) * abs(factor)
    acceleration = _without_swell(acceleration, windows, acceleration.amplitudes[rows], quiet)
    acceleration = doubted(acceleration, fold.mains, factor)
    sides = ContactFlightFit(fold.folded.part(fold.clear_sorts((0,))), total, tuple(rows), volts.rms, factor, zero_v)
    gamma = gamma_of(acceleration.amplitudes, multiples, setup, fold.ratio)
    relative = float(acceleration.amplitude_sigma()[0]) / max(float(np.abs(acceleration.amplitudes[0])), 1e-300)
    forcing = Plate(2 * np.pi * volts.frequencies_hz[rows], acceleration.amplitudes[rows])
    return StepPlate(
        step=fold.step,
        first_sample=fold.first_sample,
        last_sample=fold.last_sample,
        frequency_hz=fold.frequency_hz,
        frequency_uncertainty_hz=fold.frequency_uncertainty_hz,
        nominal_hz=fold.nominal_hz,
        ratio=fold.ratio,
        multiples=multiples,
        acceleration=acceleration,
        drive=drive,
        sides=sides,
        gamma=gamma,
        gamma_uncertainty=gamma * relative,
        gamma_peak=gamma_peak_of(forcing, fold.frequency_hz, setup.g_mps2.value),
        gamma_drive=_drive_gamma(drive, multiples, setup, fold.ratio),
        phase0_rad=float(np.mod(np.angle(acceleration.amplitudes[0]) - 0.5 * np.pi, 2 * np.pi)),
        masked=1.0 - total.n / max(fold.folded.n, 1),
        windows=windows,
        slow=_slow(fold, factor),
        kept=_kept(fold),
    )


def _drive_gamma(drive: ToneFit | None, multiples: tuple[int, ...], setup: Setup, ratio: int) -> float:
    """Gamma by drive volts and the declared ``g_per_volt``; NaN where nobody measured that."""
    if drive is None or setup.drive.g_per_volt is None:
        return float("nan")
    scale = setup.drive.g_per_volt.value * setup.g_mps2.value
    return gamma_of(drive.amplitudes * scale, multiples, setup, ratio)


def _without_swell(fit: ToneFit, windows: Windows, tones: Complexes, quiet: float) -> ToneFit:
    """The fit with the tones' own swelling, which is no noise, taken out of its residual; ``quiet`` is all noise."""
    if windows.time_s.size < LEAST_WINDOWS or not np.all(np.abs(tones) > 0.0):
        return fit
    value, sigma = windows.swell(tones)
    swelling = 0.5 * float(np.sum(np.abs(tones) ** 2)) * max(float(np.mean(value**2) - np.mean(sigma**2)), 0.0)
    rms = float(np.sqrt(quiet**2 + max(fit.rms**2 - quiet**2 - (1.0 + SWELL_KNOWN) * swelling, 0.0)))
    if fit.rms == 0.0:  # nothing is left over, and nothing to share out
        return fit
    return replace(fit, rms=rms, covariance=fit.covariance * (rms / fit.rms) ** 2)


def _windows(fold: StepState, factor: float, tones: int) -> Windows:
    """All chapters' windows in one, in m/s^2."""
    if not fold.looks:
        none, nothing = np.zeros((0, tones), np.complex128), np.zeros((0, tones))
        return Windows(np.zeros(0), 0.0, none, nothing, none, nothing)
    both: Complexes = np.concatenate([k.amplitudes for k in fold.looks])
    sigma = np.concatenate([k.noise * k.spread[:, :, None] for k in fold.looks])
    return Windows(
        np.concatenate([k.time_s for k in fold.looks]),
        WINDOW_CYCLES / fold.frequency_hz,
        np.asarray(both[:, :, 0] * factor, dtype=np.complex128),
        sigma[:, :, 0] * abs(factor),
        both[:, :, 1],
        sigma[:, :, 1],
    )


def _kept(fold: StepState) -> FitIntervals:
    """All chapters' stretches in one, their windows counted on."""
    windows = np.cumsum([0] + [k.time_s.size for k in fold.looks[:-1]])
    return FitIntervals.join([k.kept for k in fold.looks], np.zeros(len(fold.looks), dtype=np.int64), windows)


def _slow(fold: StepState, factor: float) -> SlowMotion:
    """All chapters' slow motion in one, in m/s^2."""
    if not fold.looks:
        return SlowMotion(np.zeros(0), np.zeros(0))
    return SlowMotion(
        np.concatenate([k.slow_s for k in fold.looks]), np.concatenate([k.slow for k in fold.looks]) * factor
    )
