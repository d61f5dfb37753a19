"""Plate motion of one step from its accumulated state: gamma, phase, contact and flight fits, slow motion, windows.

Volts become m/s^2 by the setup's signed sensitivity, here only. Gamma is that of the accelerometer; the drive's own
version stands next to it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np

from analysis.plate.mains_lines import with_line_uncertainty
from analysis.plate.motion import ContactFlightFit, SlowMotion, StepPlate, Windows, scaled
from analysis.plate.step_state import CONTACT, N_MASK_LEVELS, FitIntervals, StepState
from analysis.plate.tone_noise import converter_step, with_rounding
from analysis.plate.windows import WINDOW_CYCLES
from daq.instrument.channel_limits import share_at_an_end
from daq.loaded_tones import LoadedTones
from daq.lock_in import LockIn, ToneFit
from daq.recording import Recording
from daq.setup.setup import Setup
from kernels.arrays import Complexes

STEP_SAMPLES = 4096  # in which a converter's step is looked for


def gamma_of(amplitudes: Complexes, multiples: tuple[int, ...], setup: Setup, forcing: tuple[int, ...]) -> float:
    """``A w^2 / g`` of tones in m/s^2: from the first tone, or the second where the first has no amplitude."""
    g = setup.g_mps2.value
    tones = dict(setup.forcing.displacement_tones())
    if setup.forcing.multiples != forcing:  # a step with another c than the profile: the paper's superposition
        tones = dict.fromkeys(forcing, 1.0 + 0j) if len(forcing) > 1 else {1: 2.0 + 0j}
    for multiple in sorted(tones):
        if abs(tones[multiple]) > 1e-9 and multiple in multiples:
            return float(abs(amplitudes[multiples.index(multiple)])) / (g * abs(tones[multiple]) * multiple**2)
    return float("nan")


@cache
def _period(multiples: tuple[int, ...]) -> Complexes:
    """Tones of unit amplitude over a period, (361, k)."""
    return np.asarray(np.exp(2j * np.pi * np.linspace(0.0, 1.0, 361)[:, None] * multiples))


def step_plate(recording: Recording, state: StepState) -> StepPlate | None:
    """Plate motion of a step in SI units; None where it is too short for its tones, or they are not there."""
    if state.lock_in is None:
        return None
    total = state.lock_in.part(state.clear_classes())
    fits = state.chunks[0].fits if len(state.chunks) == 1 else None
    try:
        volts = fits[0] if fits is not None else total.solve(0)
        drive = None if "drive" not in recording.channels else fits[1] if fits is not None else total.solve(1)
    except ValueError:
        return None
    if drive and drive.shows and not volts.shows:  # a loose plug: nothing is known of the plate's motion
        return None
    # the tones of a drive that is cut off are smaller than what moves the plate
    setup, drive = recording.setup, None if state.drive_reads.cut_off else drive
    if drive is not None:
        noise_v = min((float(c.noise[1]) for c in state.chunks), default=drive.rms)
        drive = with_rounding(drive, state.drive_reads.step_v, noise_v)
    channel, gravity_mps2 = setup.channels.accelerometer, setup.g_mps2.value
    factor = 1.0 / channel.volts_per_mps2
    zero_v = channel.offset_v.value if channel.offset_v is not None else 0.0
    rows, multiples = state.rows, state.multiples
    windows = _windows(state, factor, len(rows))
    noise_mps2 = min((float(c.noise[0]) for c in state.chunks), default=volts.rms) * abs(factor)
    steady = _without_modulation(scaled(volts, factor, zero_v), windows, rows, noise_mps2)
    acceleration = with_line_uncertainty(steady, state.mains, factor)
    if (some := state.first_codes) is None:
        some = recording.codes("accelerometer", state.first_sample, state.first_sample + STEP_SAMPLES)
    step_v = converter_step(some) * abs(recording.scale("accelerometer")[0])
    rounded = with_rounding(acceleration, step_v * abs(factor), noise_mps2)
    # contact and flight each hold one of the signal's turning points, where rounding leaves most of its error
    wider = float(rounded.amplitude_sigma()[0] / max(acceleration.amplitude_sigma()[0], 1e-300))
    acceleration = rounded
    contact = state.lock_in.part(state.clear_classes((CONTACT,)))
    unmasked = _unmasked(state.lock_in, total, contact, gravity_mps2 / factor) * factor
    gamma, period = gamma_of(unmasked, multiples, setup, state.forcing), _period(tuple(multiples[r] for r in rows))
    relative = float(acceleration.amplitude_sigma()[0]) / max(float(np.abs(unmasked[0])), 1e-300)
    total.forget()  # its sums stay with the step until the recording is read to its end
    return StepPlate(
        step=state.step,
        first_sample=state.first_sample,
        last_sample=state.last_sample,
        frequency_hz=state.frequency_hz,
        frequency_uncertainty_hz=state.frequency_uncertainty_hz,
        nominal_hz=state.nominal_hz,
        forcing_multiples=state.forcing,
        multiples=multiples, acceleration=acceleration, drive=drive,
        contact_flight=ContactFlightFit(contact, total, tuple(rows), volts.rms * wider),
        gamma=gamma,
        gamma_uncertainty=gamma * relative,
        gamma_peak=-float(np.minimum.reduce((period @ unmasked[rows]).real)) / gravity_mps2,
        gamma_drive=_drive_gamma(drive, multiples, setup, state.forcing),
        phase0_rad=float(np.mod(np.angle(unmasked[0]) - 0.5 * np.pi, 2 * np.pi)),
        masked=1.0 - total.n / max(state.lock_in.n, 1),
        cut_off=share_at_an_end(some, recording.rate_hz, state.ends),
        ends_masked=state.ends is not None,
        windows=windows,
        slow=_slow(state, factor),
        intervals=_intervals(state),
    )  # fmt: skip


def _unmasked(every: LockIn, total: LockIn, contact: LockIn, gravity_v: float) -> Complexes:
    """Amplitudes of all tones as if nothing had been masked, in volts."""
    touching = np.arange(CONTACT * N_MASK_LEVELS, (CONTACT + 1) * N_MASK_LEVELS)
    whole = every.part(np.arange(every.counts.size))
    values, _ = LoadedTones(total, whole, contact, every.part(touching), gravity_v).solve()
    return values


def _drive_gamma(drive: ToneFit | None, multiples: tuple[int, ...], setup: Setup, forcing: tuple[int, ...]) -> float:
    """Gamma from drive volts and the declared ``g_per_volt``; NaN where that is not known."""
    if drive is None or setup.drive.g_per_volt is None:
        return float("nan")
    scale = setup.drive.g_per_volt.value * setup.g_mps2.value
    return gamma_of(drive.amplitudes * scale, multiples, setup, forcing)


def _without_modulation(fit: ToneFit, windows: Windows, rows: list[int], noise_mps2: float) -> ToneFit:
    """The fit with the power of a slow amplitude modulation, which is no noise, taken out of its residual rms."""
    tones = fit.amplitudes[rows]
    count = windows.time_s.size
    # a slow modulation needs four windows
    if count < 4 or fit.rms == 0.0 or not np.all(tones):
        return fit
    value, sigma = windows.relative_amplitude(tones)
    power = 0.5 * float(np.vdot(tones, tones).real) * max(float(value @ value - sigma @ sigma) / count, 0.0)
    # windows need not cover a step: the modulation's power is known to a half
    excess = max(fit.rms**2 - noise_mps2**2 - 1.5 * power, 0.0)
    rms = math.sqrt(noise_mps2**2 + excess)
    return replace(fit, rms=rms, covariance=fit.covariance * (rms / fit.rms) ** 2)


def _windows(state: StepState, factor: float, tones: int) -> Windows:
    """Windows of all chunks, in m/s^2."""
    if not state.chunks:
        none, nothing = np.zeros((0, tones), np.complex128), np.zeros((0, tones))
        return Windows(np.zeros(0), 0.0, none, nothing, none, nothing)
    both: Complexes = np.concatenate([c.amplitudes for c in state.chunks])
    sigma = np.concatenate([c.noise * c.spread[:, :, None] for c in state.chunks])
    return Windows(
        np.concatenate([c.time_s for c in state.chunks]),
        WINDOW_CYCLES / state.frequency_hz,
        np.asarray(both[:, :, 0] * factor, dtype=np.complex128),
        sigma[:, :, 0] * abs(factor),
        both[:, :, 1],
        sigma[:, :, 1],
    )


def _intervals(state: StepState) -> FitIntervals:
    """Unmasked intervals of all chunks, their windows counted on."""
    if len(state.chunks) == 1:
        return state.chunks[0].intervals
    windows = np.cumsum([0] + [c.time_s.size for c in state.chunks[:-1]])
    return FitIntervals.join([c.intervals for c in state.chunks], np.zeros(len(state.chunks), dtype=np.int64), windows)


def _slow(state: StepState, factor: float) -> SlowMotion:
    """Slow residual of all chunks, in m/s^2."""
    if not state.chunks:
        return SlowMotion(np.zeros(0), np.zeros(0))
    slow = np.concatenate([c.slow for c in state.chunks]) * factor
    return SlowMotion(np.concatenate([c.slow_s for c in state.chunks]), slow)
