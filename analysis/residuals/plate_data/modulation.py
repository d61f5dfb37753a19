"""Slow modulation of the plate's amplitude: its frequency and phase, and its contribution to the data.

Depth and frequency are those of the rig; each recording has a phase of its own, found from its windows. A tone measured
in a step contains the modulation's mean and leakage from other tones; closed least squares over its span remove both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from analysis.computing import Memory
from analysis.linear_algebra import solve
from analysis.plate.motion import StepPlate
from analysis.plate.step_state import (
    FitIntervals,
    in_both_senses,
    mean_phasor,
    modulated_projection,
    shifted_down,
    signed_frequencies,
    two_sided,
)
from analysis.residuals.plate_data.plate_observables import (
    GAIN,
    HUM,
    LEAST_WINDOWS,
    MODULATION,
    PHASE,
    SECOND,
    THIRD,
    PlateData,
)
from analysis.residuals.plate_data.slow_motion import LEAST, PARTS, RIDGE, TINY, Amplitudes
from kernels.arrays import Bools, Complexes, Floats, Integers
from model.integrator.problem import PlateSteps


def tones_of(fitted: Sequence[StepPlate]) -> tuple[Floats, Complexes]:
    """Fitted tones of each step and their amplitudes, (m, k); places that are free hold multiples beyond them."""
    k = max((len(s.acceleration.amplitudes) for s in fitted), default=2)
    omega, z = np.zeros((len(fitted), k)), np.zeros((len(fitted), k), dtype=np.complex128)
    for i, s in enumerate(fitted):
        leading = s.forcing_multiples if len(s.forcing_multiples) > 1 else (1, 2)
        first = [s.multiples.index(m) for m in leading if m in s.multiples]
        order = [*first, *(j for j in range(len(s.acceleration.amplitudes)) if j not in first)]
        omega[i] = s.omega_radps * (max(s.multiples) + 1.0 + np.arange(k))
        omega[i, : len(order)] = 2.0 * np.pi * s.acceleration.frequencies_hz[order]
        z[i, : len(order)] = s.acceleration.amplitudes[order]
    return omega, z


def intervals_of(fitted: Sequence[StepPlate]) -> FitIntervals:
    """What the fits of all steps have seen; windows of steps that have too few of them are none."""
    count = [len(s.windows.time_s) if len(s.windows.time_s) >= LEAST_WINDOWS else 0 for s in fitted]
    parts = [
        replace(s.intervals, window=np.where(n > 0, s.intervals.window, -1)) for s, n in zip(fitted, count, strict=True)
    ]
    return FitIntervals.join(parts, np.arange(len(parts)), np.cumsum([0, *count])[:-1])


DEEPEST = 0.5  # depths to begin with
SMALL = 1e-3  # depth from which slopes are taken
LEAKING = 0.05  # relative uncertainty of the leakage between tones, from averaging over blocks


@dataclass(frozen=True)
class AmplitudeModulation(Amplitudes):
    """Amplitude modulation as windows within steps and the steps' gains show it, and the tones that they belong to."""

    omega_radps: Floats  # every fitted tone, the forcing's (or its only one and the second harmonic) first, (m, k)
    seen_mps2: Complexes  # its amplitude, (m, k)
    tones: Integers  # number of tones of the forcing, (m,)
    intervals: FitIntervals  # unmasked intervals of the fits of steps and windows

    @classmethod
    def of(cls, fitted: Sequence[StepPlate], spans_s: Floats, data: PlateData) -> Self:
        """From the fitted steps of a recording, their spans (m, 2) and its plate data."""
        m, rows = len(fitted), data.kind == MODULATION
        weight, total = np.zeros(m), np.zeros(m)
        of_gain = data.kind == GAIN
        np.add.at(weight, data.step[of_gain], data.sigma[of_gain] ** -2.0)
        np.add.at(total, data.step[of_gain], data.value[of_gain] * data.sigma[of_gain] ** -2.0)
        known = weight > 0.0
        gain = np.where(known, total / np.where(known, weight, 1.0), np.nan)
        shown = [s.windows for s in fitted if len(s.windows.time_s) >= LEAST_WINDOWS]
        spans = [w.time_s[:, None] + 0.5 * w.length_s * np.array([-1.0, 1.0]) for w in shown]
        return cls(
            np.zeros(m, dtype=np.int64), spans_s,
            gain, np.where(known, np.where(known, weight, 1.0) ** -0.5, np.inf),
            data.step[rows], np.concatenate([np.zeros((0, 2)), *spans]), data.value[rows], data.sigma[rows],
            *tones_of(fitted), np.array([len(s.forcing_multiples) for s in fitted], dtype=np.int64),
            intervals_of(fitted),
        )  # fmt: skip

    @classmethod
    def join(cls, parts: Sequence[Self]) -> Self:
        """Those of several recordings, steps and recordings counted on."""
        k = max(p.omega_radps.shape[1] for p in parts)
        parts = [p._widened(k) for p in parts]
        names = [name for name in cls.__dataclass_fields__ if name != "intervals"]
        columns: dict[str, Any] = {name: np.concatenate([getattr(p, name) for p in parts]) for name in names}
        steps = np.cumsum([0] + [len(p.recording) for p in parts[:-1]])
        runs = np.cumsum([0] + [int(p.recording.max(initial=-1)) + 1 for p in parts[:-1]])
        columns["window_step"] = np.concatenate([p.window_step + s for p, s in zip(parts, steps, strict=True)])
        windows = np.cumsum([0] + [len(p.value) for p in parts[:-1]])
        columns["intervals"] = FitIntervals.join([p.intervals for p in parts], steps, windows)
        columns["recording"] = np.concatenate([p.recording + r for p, r in zip(parts, runs, strict=True)])
        return cls(**columns)

    def _widened(self, k: int) -> Self:
        """The same with ``k`` places for tones."""
        more = k - self.omega_radps.shape[1]
        free = self.omega_radps.max(axis=1, initial=1.0)[:, None] + self.omega_radps[:, :1] * (1.0 + np.arange(more))
        omega = np.concatenate([self.omega_radps, free], axis=1)
        return replace(self, omega_radps=omega, seen_mps2=np.pad(self.seen_mps2, ((0, 0), (0, more))))

    # -- frequency and phase -------------------------------------------------------------------------------------------
    def phases(self, hz: float) -> Floats:
        """Phase of the modulation ``sin(2 pi hz t + phase)`` in each step's recording, (m,)."""
        return np.asarray(np.angle(self._fit_at(hz).phasor)[self.recording])

    def hints(self) -> tuple[tuple[float, float], ...]:
        """Strongest modulations of windows and gains, by both and by each: frequency (Hz) and depth."""
        if len(self.value) < LEAST:
            return ()
        found: list[float] = []
        with_gains = np.isfinite(self.gain).sum() > LEAST
        for hz in [self.strongest_hz(source) for source in PARTS if with_gains or source == "windows"]:
            # less than a fifth of a period per recording is one frequency
            if all(abs(hz - other) * float(self.since_s[1].max()) > 0.2 for other in found):
                found.append(round(hz, 9))
        depths = [float(np.median(np.abs(self._fit_at(hz).phasor))) for hz in found]
        return tuple((hz, min(max(d, 1e-5), DEEPEST)) for hz, d in zip(found, depths, strict=True))

    @cached_property
    def _fits(self) -> Memory:
        return Memory(4)

    @cached_property
    def _signed(self) -> tuple[Floats, Floats]:
        """Both signs of every fitted tone, (m, 1 + 2 k), and of the leading ones, (m, 1 + 2 l)."""
        return signed_frequencies(self.omega_radps), signed_frequencies(self.omega_radps[:, : self._leading])

    @cached_property
    def _gram(self) -> Complexes:
        """Normal equations of the steps' fits, (m, 1 + 2 k, 1 + 2 k)."""
        return self.intervals.gram(self._signed[0], in_both_senses(self.seen_mps2 != 0.0))

    @cached_property
    def _window_gram(self) -> Complexes:
        """Normal equations of the windows' fits, (w, 1 + 2 l, 1 + 2 l)."""
        of = self.window_step
        return self.intervals.in_windows.gram(self._signed[1][of], in_both_senses(self._forced)[of])

    def _fit_at(self, hz: float) -> ModulationFit:
        """Projections at a frequency and the modulation of each recording that fits windows and gains best."""

        def made() -> ModulationFit:
            w, of = 2.0 * np.pi * hz, self.window_step
            every, own = self._signed
            up = self.intervals.projected(self._gram, every, own[:, 1:] + w)[:, 1:]
            in_up = self.intervals.in_windows.projected(self._window_gram, own[of], own[of, 1:] + w)[:, 1:]
            down, in_down = shifted_down(up), shifted_down(in_up)
            fit = ModulationFit(up, down, in_up, in_down, np.zeros(len(self.runs), dtype=np.complex128))
            return replace(fit, phasor=self._fitted(fit))

        return self._fits.recall(hz, made)

    def _fitted(self, fit: ModulationFit) -> Complexes:
        """Depth and phase, ``depth exp(i phase)``, of each recording's modulation, by least squares, (recordings,)."""
        phasor = fit.phasor
        slopes = [
            tuple(x / SMALL for x in self._model(fit, np.full(len(phasor), SMALL * turn))) for turn in (1.0 + 0j, 1j)
        ]
        windows, gains = (np.stack(x)[None] for x in zip(*slopes, strict=True))
        # three rounds: the scatter of the steps' gains weights the fit that gives it
        for _ in range(3):
            seen = self._model(fit, phasor)
            value, gain = self.value - seen[0], self.gain - seen[1]
            step = np.zeros(len(phasor), dtype=np.complex128)
            for r in self.runs:
                normal, side = self.normal(r, windows, gains, value, gain, np.inf)
                step[r] = complex(*solve(normal.sum(axis=0)[0] + RIDGE * np.eye(2), side.sum(axis=0)[0]))
            phasor = phasor + step
            phasor = phasor * np.minimum(1.0, DEEPEST / np.maximum(np.abs(phasor), DEEPEST))
        return phasor

    def _model(self, fit: ModulationFit, phasor: Complexes) -> tuple[Floats, Floats]:
        """Contribution of each recording's modulation to the windows, (w,), and to the steps' gains, (m,)."""
        depth, phase = np.abs(phasor)[self.recording], np.angle(phasor)[self.recording]
        true = self._true(self.seen_mps2, fit, depth, phase)
        seen, true_own = self.seen_mps2[:, : self._leading], true[:, : self._leading]
        power = np.where(self._forced, np.abs(seen) ** 2, 0.0)
        logs = np.log(np.abs(seen / np.where(true_own == 0.0, 1.0, true_own)) + TINY)
        gain = np.sum(power * logs, axis=1) / np.maximum(power.sum(axis=1), TINY)
        return self._in_windows(self.seen_mps2, true, fit, depth, phase), gain

    # -- its contribution ----------------------------------------------------------------------------------------------
    def modulated(self, plate: PlateSteps, depth: Floats, hz: float) -> PlateSteps:
        """The plate whose forcing swells by ``depth`` (m,), each tone with its sidebands behind the other tones."""
        fit, w, leading = self._fit_at(hz), 2.0 * np.pi * hz, self._leading
        phase, forced = self.phases(hz), self._forced
        seen = self._seen(plate)
        true = self._true(seen, fit, depth, phase)
        z = np.where(forced, true[:, :leading], 0.0)
        distance = np.abs(plate.omega_radps[:, :, None] - self.omega_radps[:, None, :])
        false = np.take_along_axis(seen - true, np.argmin(distance, axis=2), axis=1)  # lines that it mimics, too
        steady = np.where(plate.acceleration_mps2 == 0.0, 0.0, plate.acceleration_mps2 - false)
        turn = (depth * np.exp(1j * phase) / 2j)[:, None]
        tones = np.concatenate([steady, z * turn, z * np.conj(turn)], axis=1)
        own = self.omega_radps[:, :leading]
        below = own - w
        tones[:, -leading:] = np.where(below < 0.0, np.conj(tones[:, -leading:]), tones[:, -leading:])
        omega = np.concatenate([plate.omega_radps, own + w, np.abs(below) + (below == 0.0)], axis=1)
        return PlateSteps(omega, tones, plate.period_s, derived=2 * leading)

    def expected(self, data: PlateData, plate: PlateSteps, depth: Floats, hz: float) -> tuple[Floats, Floats]:
        """Contribution of the modulation to each plate datum and its standard deviation, (r,) each.

        Leakage between tones is known less well than the modulation's mean over a step.
        """
        out, sigma = np.zeros((2, len(data)))
        fit, phase, seen = self._fit_at(hz), self.phases(hz), self._seen(plate)
        true = self._true(seen, fit, depth, phase)
        k = np.argmin(np.abs(self.omega_radps[data.step] - data.omega_radps[:, None]), axis=1)
        rows = np.flatnonzero((data.kind == GAIN) | (data.kind == PHASE))
        factor = seen[data.step[rows], k[rows]] / true[data.step[rows], k[rows]]
        out[rows] = np.where(data.kind[rows] == GAIN, np.log(np.abs(factor)), np.angle(factor))
        sigma[rows] = LEAKING * np.abs(factor - 1.0 - (depth * self._means(hz))[data.step[rows]])
        rows = np.flatnonzero(np.isin(data.kind, (SECOND, THIRD, HUM)))
        false = np.abs(seen - true)[data.step[rows], k[rows]]  # lines that a modulation mimics
        out[rows] = (false / np.where(data.kind[rows] == HUM, 1.0, data.scale[rows])) ** 2
        sigma[rows] = 2.0 * LEAKING * out[rows]
        mains = data.kind == HUM  # what a cable picks up there adds to a sideband at any phase
        # an ordinary accelerometer's cable picks up 0.3 mV of mains, which at 0.1 V/g are 0.03 m/s^2
        sigma[mains] = np.hypot(sigma[mains], 0.03 * np.sqrt(2.0 * out[mains]))
        out[data.kind == MODULATION] = self._in_windows(seen, true, fit, depth, phase)
        return out, sigma

    def leaking(self, plate: PlateSteps, depth: Floats, hz: float) -> Floats:
        """Standard deviation of the forcing's tones from the leakage between them, m/s^2."""
        out = np.zeros(plate.acceleration_mps2.shape)
        seen = self._seen(plate)
        true = self._true(seen, self._fit_at(hz), depth, self.phases(hz))
        leak = LEAKING * np.abs(seen - true * (1.0 + depth * self._means(hz))[:, None])
        own = slice(self._leading)
        out[:, own] = np.where(self._forced, leak[:, own], 0.0)
        return out

    def _means(self, hz: float) -> Floats:
        """Mean of the modulation of depth 1 over each step, (m,)."""
        turned = mean_phasor(self.span_s, np.array([2.0 * np.pi * hz]))[0]
        return np.asarray((np.exp(1j * self.phases(hz)) * turned).imag)

    def _in_windows(self, seen: Complexes, true: Complexes, fit: ModulationFit, depth: Floats, phase: Floats) -> Floats:
        """Relative deviation of the forcing's amplitude in each window, (w,)."""
        of, forced, leading = self.window_step, self._forced, self._leading
        z = two_sided(np.where(forced, true[:, :leading], 0.0))[of]
        false = two_sided((seen - true)[:, leading:])[of]  # other lines in the step's fit
        projection = modulated_projection(fit.window_up, fit.window_down, phase[of])
        found = z + depth[of, None] * (projection @ z[..., None])[..., 0] - (self._others @ false[..., None])[..., 0]
        own = np.where(forced, seen[:, :leading], 0.0)[of]
        power = np.sum(np.abs(own) ** 2, axis=1)
        change = np.sum((np.conj(own) * (2.0 * found[:, :leading] - own)).real, axis=1)
        return np.asarray(change / np.where(power > 0.0, power, 1.0))

    @cached_property
    def _others(self) -> Complexes:
        """Projection of the tones beyond the leading ones on windows, (w, 2 l, b)."""
        leading = self._leading
        own, others = (
            signed_frequencies(self.omega_radps[self.window_step, part])
            for part in (slice(leading), slice(leading, None))
        )
        return self.intervals.in_windows.projected(self._window_gram, own, others[:, 1:])[:, 1:]

    @cached_property
    def _leading(self) -> int:
        """Number l of the tones that stand first in each step: those of the forcing, two at least."""
        return max(2, int(self.tones.max(initial=0)))

    @property
    def _forced(self) -> Bools:
        """Which of the leading tones are the forcing's, (m, l)."""
        return np.asarray(self.tones[:, None] > np.arange(self._leading))

    def _seen(self, plate: PlateSteps) -> Complexes:
        """Every tone as the steps' fits have it, (m, k)."""
        out = self.seen_mps2.copy()
        own = slice(self._leading)
        out[:, own] = np.where(self._forced, plate.acceleration_mps2[:, own], out[:, own])
        return out

    def _true(self, seen: Complexes, fit: ModulationFit, depth: Floats, phase: Floats) -> Complexes:
        """The tones without the contribution of the modulation to the fits ``seen``, (m, k)."""
        k, leading = self.omega_radps.shape[1], self._leading
        projection = modulated_projection(fit.step_up, fit.step_down, phase) * np.tile(self._forced, 2)[:, None, :]
        change = np.tile(np.eye(2 * k, dtype=np.complex128), (len(depth), 1, 1))
        change[:, :, [*range(leading), *range(k, k + leading)]] += depth[:, None, None] * projection
        return np.asarray(2.0 * solve(change, two_sided(seen)[..., None])[:, :k, 0])


@dataclass(frozen=True)
class ModulationFit:
    """Projections at one frequency: of the l leading tones in both senses, shifted up and down by it, on the tones
    of the steps' fits (m, 2 k, 2 l) and of the windows' (w, 2 l, 2 l); and the modulation of each recording."""

    step_up: Complexes
    step_down: Complexes
    window_up: Complexes
    window_down: Complexes
    phasor: Complexes
