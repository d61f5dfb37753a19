"""The plate's motion in each step as measured: tones with their covariance, windows, slow motion, phase.

Phases refer to sample 0 of the recording; positive is up. The ball's weight on the table changes the tones: a joint fit
has an extra amplitude of each forcing tone and an extra offset in contact, with harmonics common to contact and flight.
It is solved on request.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline, make_interp_spline

from analysis.linear_algebra import cholesky, inv
from analysis.plate.step_state import FitIntervals
from daq.instrument.channel_limits import STANDS
from daq.lock_in import LockIn, ToneFit
from kernels.arrays import Complexes, Floats, Integers
from model.tones import Plate


@dataclass(frozen=True)
class ContactFlightFit:
    """Normal equations of contact and of the whole step."""

    contact: LockIn  # volts
    total: LockIn  # volts
    rows: tuple[int, ...]  # rows of the forcing's tones among the fitted ones
    rms_v: float  # residual of the step's fit

    def log_gain(self) -> tuple[float, float] | None:
        """Logarithm of the first tone's amplitude in flight over that in contact, and its standard deviation.

        None where contact or flight has too few blocks, or they cannot be separated.
        """
        contact, total = self.contact, self.total
        # fewer blocks do not fix the tones of contact and of flight separately
        if min(contact.n, total.n - contact.n) < 60:
            return None
        extra = [0, *(c for r in self.rows for c in (2 * r + 1, 2 * r + 2))]
        coupling = contact.gram[:, extra]
        gram = np.block([[total.gram, coupling], [coupling.T, contact.gram[np.ix_(extra, extra)]]])
        scale = 1.0 / np.sqrt(np.diag(gram))
        unit_gram = gram * np.outer(scale, scale)
        # where contact and flight alternate with the forcing itself their tones cannot be separated
        if np.linalg.cond(unit_gram) > 1e6:
            return None
        inverse = inv(unit_gram) * np.outer(scale, scale)
        solution = inverse @ np.concatenate([total.rhs[:, 0], contact.rhs[extra, 0]])
        common = slice(2 * self.rows[0] + 1, 2 * self.rows[0] + 3)
        only_contact = slice(len(total.gram) + 1, len(total.gram) + 3)
        in_flight, in_contact = solution[common], solution[common] + solution[only_contact]
        slope = np.zeros(len(solution))  # d log|a| = a . da / |a|^2
        slope[only_contact] = -in_contact / (in_contact @ in_contact)
        slope[common] = slope[only_contact] + in_flight / (in_flight @ in_flight)
        log_gain = 0.5 * np.log((in_flight @ in_flight) / (in_contact @ in_contact))
        return float(log_gain), self.rms_v * float(np.sqrt(slope @ inverse @ slope))


def scaled(fit: ToneFit, factor: float, offset: float) -> ToneFit:
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


TWO_PI = 2.0 * np.pi
MOST_CUT_OFF = 0.35  # part of a step at the sensor's end, up to which the rest gives its tones
PADDING = 4  # zero padding of the spectrum
LINE_BINS = 12  # bins on either side of a line that belong to it


@dataclass(frozen=True)
class SpectralLine:
    """Line in the plate's motion below the forcing."""

    frequency_hz: float
    amplitude_mps2: float


@dataclass(frozen=True)
class SlowMotion:
    """Residual acceleration below the forcing at a low rate, ``mps2`` at ``time_s``; NaN: masked."""

    time_s: Floats
    mps2: Floats

    @cached_property
    def path(self) -> tuple[BSpline, BSpline, BSpline]:
        """Place, m, velocity, m/s, and acceleration by time; 0 before and after, place and velocity but for a drift."""
        known = np.isfinite(self.mps2)
        time_s = self.time_s[known] if known.any() else np.zeros(1)
        ends_s = time_s[0] + np.array([-2.0, -0.01]), time_s[-1] + np.array([0.01, 2.0])
        mps2 = np.pad(self.mps2[known] if known.any() else np.zeros(1), 2)
        bent = make_interp_spline(np.concatenate([ends_s[0], time_s, ends_s[1]]), mps2, k=1)
        return bent.antiderivative(2), bent.antiderivative(), bent


def slow_lines(slow: SlowMotion, frequency_hz: float) -> tuple[SpectralLine, ...]:
    """Significant spectral lines below the forcing, strongest first, at most three.

    The false-alarm probability is that of the largest of independent exponentially distributed powers.
    """
    known = np.isfinite(slow.mps2)
    # fewer than 16 values make no spectrum, fewer than 8 bins no background of it
    if known.sum() < 16:
        return ()
    step_s = float(np.median(np.diff(slow.time_s)))
    x = np.where(known, slow.mps2 - np.nanmean(slow.mps2), 0.0) * np.hanning(slow.mps2.size)
    # a tone under the window has half its amplitude times the window's sum
    gain = np.hanning(slow.mps2.size)[known].sum() / 2.0
    spectrum = np.abs(np.fft.rfft(x, PADDING * x.size)) / gain
    f = np.fft.rfftfreq(PADDING * x.size, step_s)
    # two periods in the step at least, and below the forcing, whose own tones are fitted
    band = (f > 2.0 / (x.size * step_s)) & (f < 0.9 * frequency_hz)
    if band.sum() < 8:
        return ()
    power = np.where(band, spectrum, 0.0) ** 2
    # powers of noise are exponential: their median is log 2 of their mean
    background = float(np.median(power[band])) / np.log(2.0)
    cells = max(band.sum() / 8.0, 1.0)
    found = []
    for _ in range(3):
        k = int(np.argmax(power))
        chance = 1.0 - (1.0 - np.exp(-power[k] / max(background, 1e-300))) ** cells
        # noise makes such a line once in 100000 spectra
        if chance > 1e-5:
            break
        found.append(SpectralLine(float(f[k]), float(np.sqrt(power[k]))))
        power[max(k - LINE_BINS, 0) : k + LINE_BINS + 1] = 0.0
    return tuple(found)


@dataclass(frozen=True)
class Windows:
    """Amplitudes of the forcing's tones within windows of a few cycles: the slow modulation of a step."""

    time_s: Floats  # middle of each window, (w,)
    length_s: float
    amplitudes: Complexes  # m/s^2, (w, tones), same phase reference as the step's fit; NaN where too much is masked
    uncertainty_mps2: Floats  # uncertainty of each quadrature, from the noise within windows, (w, tones)
    drive_v: Complexes  # amplitudes of the drive, (w, tones); zeros where it was not recorded
    drive_uncertainty_v: Floats  # of each quadrature, (w, tones)

    def relative_amplitude(self, tones: Complexes, drive: Complexes | None = None) -> tuple[Floats, Floats]:
        """Relative deviation of all tones together from ``tones`` (tones,) in each window, and its uncertainty, (w,).

        With the step's ``drive`` amplitudes (tones,), the deviation is that beyond the drive's own in the window.
        """
        powers, wanted = np.abs(tones) ** 2, tones
        variance = self.uncertainty_mps2**2 @ powers
        if drive is not None and np.all(np.abs(drive) > 0.0):
            wanted = tones * self.drive_v / drive
            variance = variance + (self.drive_uncertainty_v / np.abs(drive)) ** 2 @ powers**2
        power = float(np.add.reduce(powers))
        value = np.add.reduce((np.conj(wanted) * (self.amplitudes - wanted)).real, axis=1) / power
        return np.asarray(value), np.asarray(np.sqrt(variance) / power)


@dataclass(frozen=True)
class StepPlate:
    """The plate in the hold part of one step."""

    step: int
    first_sample: int  # of the part that was fitted
    last_sample: int  # one past its last one
    # first tone on the recording's clock, measured where the drive or the accelerometer shows a difference
    frequency_hz: float
    frequency_uncertainty_hz: float
    nominal_hz: float  # frequency of the step table
    forcing_multiples: tuple[int, ...]  # multiples of the first tone at which the plate is driven
    multiples: tuple[int, ...]  # multiple of the frequency of each fitted tone; mains lines follow after them
    acceleration: ToneFit  # m/s^2, masked after impacts
    drive: ToneFit | None  # V, looped back; None where it was not recorded, or its reading is cut off
    contact_flight: ContactFlightFit  # separate amplitudes in contact and in flight, see `flight_log_gain`
    gamma: float  # ``A w^2 / g`` from the accelerometer
    gamma_uncertainty: float  # its statistical standard deviation; the sensitivity's comes on top
    gamma_peak: float  # ``max(-a_p) / g`` of the fitted motion
    gamma_drive: float  # the same gamma from drive volts and ``g_per_volt``; NaN where that is unknown
    # ``phi(t) = 2 pi f t + phase0`` is zero where the first tone's displacement crosses zero going up
    phase0_rad: float
    masked: float  # fraction of the hold left out after impacts
    cut_off: float  # fraction of its first samples at which the accelerometer stands at its largest or smallest value
    ends_masked: bool  # whether the fit leaves such samples out
    windows: Windows
    slow: SlowMotion
    intervals: FitIntervals  # unmasked times of the hold

    @cached_property
    def flight_log_gain(self) -> tuple[float, float] | None:
        """Logarithm of the first tone's amplitude in flight over that in contact, and its standard deviation."""
        return self.contact_flight.log_gain()

    @cached_property
    def lines(self) -> tuple[SpectralLine, ...]:
        """Significant spectral lines below the forcing, strongest first."""
        return slow_lines(self.slow, self.frequency_hz)

    @property
    def saturated(self) -> bool:
        """Whether the accelerometer cuts off part of the motion, not only the peaks of impacts."""
        return self.cut_off > STANDS

    @property
    def usable(self) -> bool:
        """Whether the tones are those of the motion: nothing of it is cut off, or little, which the fit leaves out."""
        return not self.saturated or (self.ends_masked and self.cut_off < MOST_CUT_OFF)

    @property
    def omega_radps(self) -> float:
        """Angular frequency of the first tone, on the recording's clock."""
        return TWO_PI * self.frequency_hz

    def tone(self, multiple: int) -> tuple[complex, Floats]:
        """Amplitude of a multiple of the forcing (m/s^2) and its 2 x 2 covariance of (Re, Im)."""
        i = self.multiples.index(multiple)
        fit, own = self.acceleration, slice(2 * i, 2 * i + 2)
        return complex(fit.amplitudes[i]), fit.covariance[own, own]

    @property
    def ratio(self) -> int:
        """c, the second tone's multiple; 1 where there is none."""
        return self.forcing_multiples[min(1, len(self.forcing_multiples) - 1)]

    def relative_amplitude(self) -> tuple[Floats, Floats]:
        """Relative deviation of the forcing's amplitude in each window beyond the drive's own; its uncertainty."""
        rows = [self.multiples.index(m) for m in self.forcing_multiples]
        drive = None if self.drive is None else self.drive.amplitudes[rows]
        return self.windows.relative_amplitude(self.acceleration.amplitudes[rows], drive)

    def plate(self, significance: float = 4.0) -> Plate:
        """Fitted motion: the forcing's tones, and harmonics and mains lines above ``significance`` sigma."""
        fit = self.acceleration
        strong = np.abs(fit.amplitudes) > significance * fit.amplitude_sigma()
        strong[[i for i, m in enumerate(self.multiples) if m in self.forcing_multiples]] = True
        return Plate(TWO_PI * fit.frequencies_hz[strong], fit.amplitudes[strong])

    def forcing(self) -> Plate:
        """Fitted motion at the forcing's tones only."""
        rows = [self.multiples.index(m) for m in self.forcing_multiples]
        fit = self.acceleration
        return Plate(TWO_PI * fit.frequencies_hz[rows], fit.amplitudes[rows])

    def tones_factor(self, omega_radps: Floats) -> Complexes:
        """Factor of the covariance of the fitted tones at ``omega_radps`` (k,), those of the forcing first: (2 k, k).

        A mains line or a harmonic is known no better than a forcing tone; next to one, their errors cancel in what they
        do to the plate. So all err together here.
        """
        fit = self.acceleration
        every = TWO_PI * fit.frequencies_hz
        rows = np.array([int(np.argmin(np.abs(every - w))) for w in omega_radps])
        own = (rows[:, None] * 2 + np.arange(2)).ravel()
        scale = np.sqrt(np.diag(fit.covariance)[own])
        correlation = fit.covariance[np.ix_(own, own)] / np.outer(scale, scale)
        # of unit diagonal: amplitudes differ by orders, and a line next to a tone makes it nearly singular
        factor = cholesky(correlation + 1e-9 * np.eye(len(own))) * scale[:, None]
        return np.asarray((factor[::2] + 1j * factor[1::2]).T)


@dataclass(frozen=True)
class PlateMotion:
    """Plate motion over a whole recording."""

    steps: tuple[StepPlate | None, ...]  # None where a step is too short to be fitted
    noise_mps2: float  # white noise of the accelerometer
    rate_hz: float
    # sample before which samples were lost, and how many, (k, 2)
    gaps: Integers = field(default_factory=lambda: np.zeros((0, 2), np.int64))
    leak: float = 0.0  # part of the contact's volts that was taken out of the accelerometer

    def warnings(self) -> tuple[str, ...]:
        """What a person ought to know of the accelerometer: the steps in which it saturates, and what leaks into it."""
        found = []
        if self.leak:
            found.append(
                f"{self.leak:.2g} of the contact's volts leak into the accelerometer, and were taken out; give the two "
                "circuits no wire in common, or leave a grounded channel between them"
            )
        for usable in (True, False):
            those = [s for s in self.steps if s is not None and s.saturated and s.usable is usable]
            if those:
                numbers = ", ".join(str(s.step) for s in those)
                most, least_g = max(s.cut_off for s in those), min(s.gamma_peak for s in those)
                what = (
                    "gamma comes from the rest" if usable
                    else "gamma comes out too small; closed loops leave these steps out"
                )  # fmt: skip
                found.append(
                    f"the accelerometer saturates in step {numbers}: up to {most:.0%} of the samples stand at its "
                    f"largest or smallest value, and {what}. Take a sensor or a range for more than {least_g:.2g} g"
                )
        return tuple(found)

    @property
    def ratio(self) -> int:
        """The forcing's c in the last fitted step (1 where none was)."""
        return next((p.ratio for p in reversed(self.steps) if p is not None), 1)

    def true_time_s(self, time_s: npt.ArrayLike) -> Floats:
        """Recording time with the lost samples counted: the clock on which tones keep their phase through gaps."""
        t = np.asarray(time_s, dtype=np.float64)
        if not len(self.gaps):
            return t
        lost = np.concatenate([[0], np.cumsum(self.gaps[:, 1])])
        return np.asarray(t + lost[np.searchsorted(self.gaps[:, 0] / self.rate_hz, t, side="right")] / self.rate_hz)

    def phase(self, time_s: npt.ArrayLike, step: npt.ArrayLike) -> Floats:
        """Phase of the plate's displacement at times within steps, in [0, 2 pi); NaN where the step was not fitted."""
        omega, phase0 = self._table()
        k = np.asarray(step, dtype=np.int64)
        inside = (k >= 0) & (k < len(self.steps))
        k = np.where(inside, k, 0)
        if not len(self.steps):
            return np.full(k.shape, np.nan)
        phase = np.where(inside, omega[k] * self.true_time_s(time_s) + phase0[k], np.nan)
        return np.asarray(np.mod(phase, TWO_PI))

    def frequency_hz(self, step: npt.ArrayLike) -> Floats:
        """Frequency of the first tone in each of the given steps; NaN where the step was not fitted."""
        k = np.asarray(step, dtype=np.int64)
        omega = np.append(self._table()[0], np.nan)
        return np.asarray(omega[np.where((k >= 0) & (k < len(self.steps)), k, -1)] / TWO_PI)

    def acceleration_mps2(self, time_s: Floats, step: Integers) -> Floats:
        """Plate acceleration at times within steps (the forcing's tones), m/s^2; NaN where the step was not fitted."""
        omega, z = self.forcing_tones(step)
        return np.asarray((z * np.exp(1j * omega * self.true_time_s(time_s))).real.sum(axis=0))

    def forcing_tones(self, step: Integers) -> tuple[Floats, Complexes]:
        """Angular frequencies in rad/s and amplitudes in m/s^2 of the forcing's tones in steps (n,), both (k, n).

        There are two at least; a tone that a forcing does not have is 0 at 0 rad/s; NaN where the step was not fitted.
        """
        omega, z = self._forcing
        row_of = np.where((step >= 0) & (step < len(self.steps)), step, len(self.steps))
        return omega[:, row_of], z[:, row_of]

    @cached_property
    def _forcing(self) -> tuple[Floats, Complexes]:
        """The forcing's tones of every step, and of none."""
        count = max((len(s.forcing_multiples) for s in self.steps if s is not None), default=1)
        shape = max(count, 2), len(self.steps) + 1
        omega, z = np.full(shape, np.nan), np.zeros(shape, dtype=np.complex128)
        for k, fitted in enumerate(self.steps):
            if fitted is not None:
                for row, multiple in enumerate(fitted.forcing_multiples):
                    at = fitted.multiples.index(multiple)
                    omega[row, k] = TWO_PI * fitted.acceleration.frequencies_hz[at]
                    z[row, k] = fitted.acceleration.amplitudes[at]
                omega[len(fitted.forcing_multiples) :, k] = 0.0
        return omega, z

    def _table(self) -> tuple[Floats, Floats]:
        omega = np.array([np.nan if s is None else s.omega_radps for s in self.steps])
        phase0 = np.array([np.nan if s is None else s.phase0_rad for s in self.steps])
        return omega, phase0
