"""From folded normal equations to a step's plate motion: gamma, phase, gated fits, slow lines, amplitude in time.

The rule kept here: volts become m/s^2 by the setup's signed sensitivity in one place, and gamma is stated from the
accelerometer; the drive's version stands beside it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from analysis.plate_motion import Line, SlowMotion, StepPlate, Windows
from daq.recording import Recording
from daq.setup import Setup
from daq.tones import LockIn, ToneFit
from model.tones import Plate

if TYPE_CHECKING:
    from analysis.folding import Span, StepFold

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]
LEAST_APART = 60  # block means on each side that contact and flight are told apart by
WINDOW_CYCLES = 2.0
CHANCE = 1e-5  # of a slow line in noise alone, below which it is reported
SLOW_PER_CYCLE = 4.0  # values of the slow series per period of the forcing


def residual_of(span: Span, fit: ToneFit, rate_hz: float, width: int) -> Floats:
    """Accelerometer means minus the fit (volts), NaN where masked."""
    index = span.first + np.arange(span.clear.size)
    phasors = _phasors(fit.frequencies_hz, index, rate_hz, width)
    residual = span.accelerometer - fit.offset - (fit.amplitudes[:, None] * phasors).real.sum(axis=0)
    return np.where(span.clear, residual, np.nan)


def _phasors(frequencies_hz: Floats, index: npt.NDArray[np.int64], rate_hz: float, width: int) -> Complexes:
    """``exp(i 2 pi f t)`` as block means see it, shape (tones, n)."""
    theta = np.pi * frequencies_hz / (rate_hz * width)
    response = np.sin(width * theta) / (width * np.sin(theta)) * np.exp(1j * theta * (width - 1))
    cycles = frequencies_hz[:, None] / rate_hz * index
    return np.asarray(response[:, None] * np.exp(2j * np.pi * (cycles % 1.0)))


def windows(
    spans: list[Span], fit: ToneFit, rows: list[int], rate_hz: float, width: int
) -> tuple[Floats, Complexes, Floats]:
    """The forcing tones' amplitudes a few cycles at a time (volts): the fit plus what the residual adds to it."""
    frequency = fit.frequencies_hz[0]
    times, amplitudes, sigmas = [], [], []
    for span in spans:
        residual = residual_of(span, fit, rate_hz, width)
        length = max(round(WINDOW_CYCLES * rate_hz / frequency), 1)
        for start in range(0, residual.size - length + 1, length):
            part = slice(start, start + length)
            use = np.isfinite(residual[part])
            index = span.first + np.arange(start, start + length)[use]
            if use.sum() < 0.4 * length or use.sum() < 4 * (2 * len(rows) + 1):
                continue
            phasor = _phasors(fit.frequencies_hz[rows], index, rate_hz, width)
            design = np.vstack([np.ones(index.size), *[q for p in phasor for q in (p.real, -p.imag)]]).T
            solution, *_ = np.linalg.lstsq(design, residual[part][use], rcond=None)
            spread = np.sqrt(np.diag(np.linalg.pinv(design.T @ design)))[1:].reshape(-1, 2).mean(axis=1)
            times.append((index.mean() + 0.5) / rate_hz)
            amplitudes.append(fit.amplitudes[rows] + solution[1::2] + 1j * solution[2::2])
            sigmas.append(fit.rms * spread)
    shape = (-1, len(rows))
    return np.array(times), np.array(amplitudes, dtype=complex).reshape(shape), np.array(sigmas).reshape(shape)


def slow_motion(
    spans: list[Span], fit: ToneFit, rate_hz: float, width: int, frequency_hz: float
) -> tuple[Floats, Floats]:
    """Residual means (volts) at about `SLOW_PER_CYCLE` values a period of the forcing; NaN where all is masked."""
    group = max(int(rate_hz / (SLOW_PER_CYCLE * frequency_hz)), 1)
    times, values = [], []
    for span in spans:
        residual = residual_of(span, fit, rate_hz, width)
        count = residual.size // group
        folded = residual[: count * group].reshape(count, group)
        known = np.isfinite(folded)
        total = np.where(known, folded, 0.0).sum(axis=1)
        values.append(np.where(known.any(axis=1), total / np.maximum(known.sum(axis=1), 1), np.nan))
        times.append((span.first + (np.arange(count) + 0.5) * group) / rate_hz)
    return np.concatenate(times), np.concatenate(values)


def slow_lines(slow: SlowMotion, frequency_hz: float) -> tuple[Line, ...]:
    """Lines below 0.9 of the forcing that stand out of the residual's background, strongest first, at most three."""
    known = np.isfinite(slow.mps2)
    if known.sum() < 16:
        return ()
    step_s = float(np.median(np.diff(slow.time_s)))
    x = np.where(known, slow.mps2 - np.nanmean(slow.mps2), 0.0) * np.hanning(slow.mps2.size)
    gain = np.hanning(slow.mps2.size)[known].sum() / 2.0
    spectrum = np.abs(np.fft.rfft(x, 4 * x.size)) / gain
    f = np.fft.rfftfreq(4 * x.size, step_s)
    band = (f > 2.0 / (x.size * step_s)) & (f < 0.9 * frequency_hz)
    if band.sum() < 8:
        return ()
    power = np.where(band, spectrum, 0.0) ** 2
    background = float(np.median(power[band])) / np.log(2.0)
    cells = max(band.sum() / 8.0, 1.0)
    found = []
    for _ in range(3):
        k = int(np.argmax(power))
        chance = 1.0 - (1.0 - np.exp(-power[k] / max(background, 1e-300))) ** cells
        if chance > CHANCE:
            break
        found.append(Line(float(f[k]), float(np.sqrt(power[k])), float(chance)))
        power[max(k - 12, 0) : k + 13] = 0.0
    return tuple(found)


def _scaled(fit: ToneFit, factor: float, offset: float) -> ToneFit:
    """The fit times ``factor`` (volts to m/s^2), its offset first shifted by ``-offset`` volts."""
    return ToneFit(
        fit.frequencies_hz,
        fit.amplitudes * factor,
        fit.covariance * factor**2,
        fit.rms * abs(factor),
        (fit.offset - offset) * factor,
        fit.offset_uncertainty * abs(factor),
        fit.n,
    )


def _apart(contact: LockIn | None, total: LockIn, rms: float, rows: list[int]) -> tuple[ToneFit | None, ToneFit | None]:
    """The tones ``rows`` and the offset in contact and in flight: one joint fit in which contact has an extra of each.

    The harmonics are common to both, so what the ball's weight on the table changes is not put into them.
    """
    if contact is None or min(contact.n, total.n - contact.n) < LEAST_APART:
        return None, None
    columns = [0, *(c for r in rows for c in (2 * r + 1, 2 * r + 2))]
    beside = contact.gram[:, columns]
    gram = np.block([[total.gram, beside], [beside.T, contact.gram[np.ix_(columns, columns)]]])
    scale = 1.0 / np.sqrt(np.diag(gram))
    scaled = gram * np.outer(scale, scale)
    if np.linalg.cond(scaled) > 1e6:
        return None, None
    inverse = np.asarray(np.linalg.inv(scaled) * np.outer(scale, scale), dtype=np.float64)
    solution = inverse @ np.concatenate([total.rhs[:, 0], contact.rhs[columns, 0]])
    p = total.gram.shape[0]
    pick = np.zeros((2, len(columns), gram.shape[0]))
    for k, c in enumerate(columns):
        pick[:, k, c] = 1.0
        pick[0, k, p + k] = 1.0
    fits = []
    for part, n in zip(pick, (contact.n, total.n - contact.n), strict=True):
        own, covariance = part @ solution, part @ inverse @ part.T * rms**2
        fits.append(
            ToneFit(
                total.frequencies_hz[rows], own[1::2] + 1j * own[2::2], covariance[1:, 1:], rms,
                float(own[0]), float(np.sqrt(covariance[0, 0])), n,
            )
        )
    return fits[0], fits[1]


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
    t = np.linspace(0.0, 1.0 / frequency_hz, 721)
    return float(np.max(-plate.acceleration_at(t))) / g_mps2


def step_plate(recording: Recording, fold: StepFold, total: LockIn) -> StepPlate | None:
    """Everything about one step, in SI; None where the step is too short for its tones."""
    try:
        volts = total.solve(0)
        drive = total.solve(1) if "drive" in recording.channels else None
    except ValueError:
        return None
    setup = recording.setup
    channel = setup.channels.accelerometer
    factor = 1.0 / channel.volts_per_mps2
    zero_v = channel.offset_v.value if channel.offset_v is not None else 0.0
    acceleration = _scaled(volts, factor, zero_v)
    multiples = fold.multiples
    rows = [multiples.index(m) for m in sorted({1, fold.ratio}) if m in multiples]
    apart = _apart(fold.contact, total, volts.rms, rows)
    contact, flight = (None if part is None else _scaled(part, factor, zero_v) for part in apart)
    slow = SlowMotion(
        np.concatenate([s[0] for s in fold.slow]) if fold.slow else np.zeros(0),
        np.concatenate([s[1] for s in fold.slow]) * factor if fold.slow else np.zeros(0),
    )
    gamma = gamma_of(acceleration.amplitudes, multiples, setup, fold.ratio)
    relative = float(acceleration.amplitude_sigma()[0]) / max(float(np.abs(acceleration.amplitudes[0])), 1e-300)
    forcing = Plate(2 * np.pi * volts.frequencies_hz[rows], acceleration.amplitudes[rows])
    return StepPlate(
        step=fold.step, first_sample=fold.first_sample, last_sample=fold.last_sample,
        frequency_hz=fold.frequency_hz, frequency_uncertainty_hz=fold.frequency_uncertainty_hz,
        nominal_hz=fold.nominal_hz, ratio=fold.ratio, multiples=multiples,
        acceleration=acceleration, drive=drive, contact=contact, flight=flight,
        gamma=gamma, gamma_uncertainty=gamma * relative,
        gamma_peak=gamma_peak_of(forcing, fold.frequency_hz, setup.g_mps2.value),
        gamma_drive=_drive_gamma(drive, multiples, setup, fold.ratio),
        phase0_rad=float(np.mod(np.angle(acceleration.amplitudes[0]) - 0.5 * np.pi, 2 * np.pi)),
        masked=1.0 - fold.clear / max(fold.blocks, 1), lines=slow_lines(slow, fold.frequency_hz),
        windows=_windows(fold, factor, len(rows)), slow=slow,
    )


def _drive_gamma(drive: ToneFit | None, multiples: tuple[int, ...], setup: Setup, ratio: int) -> float:
    """Gamma by drive volts and the declared ``g_per_volt``; NaN where nobody measured that."""
    if drive is None or setup.drive.g_per_volt is None:
        return float("nan")
    scale = setup.drive.g_per_volt.value * setup.g_mps2.value
    return gamma_of(drive.amplitudes * scale, multiples, setup, ratio)


def _windows(fold: StepFold, factor: float, tones: int) -> Windows:
    """All chapters' windows in one, in m/s^2."""
    if not fold.windows:
        return Windows(np.zeros(0), np.zeros((0, tones), np.complex128), np.zeros((0, tones)))
    time_s = np.concatenate([w[0] for w in fold.windows])
    amplitudes = np.concatenate([w[1] for w in fold.windows])
    scaled = np.asarray(amplitudes * factor, dtype=np.complex128)
    return Windows(time_s, scaled, np.concatenate([w[2] for w in fold.windows]) * abs(factor))
