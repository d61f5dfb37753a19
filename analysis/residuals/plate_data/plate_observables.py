"""Plate data: numbers of each step that compare the plate with its drive, and their expected values.

A datum is a number with its uncertainty and a kind. Its expected value is computed in one place (`expected`), from the
hooks of the effects' own files. Decision 450.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from analysis.plate.mains_lines import MAINS_HZ, MAX_OFFSET_HZ
from analysis.plate.motion import StepPlate
from analysis.residuals.noise.noise_model import PlateNoise
from analysis.residuals.plate_data.mains_on_tones import mains_on_tones, mains_rows, strongest_mains_hz
from daq.setup.setup import Setup
from kernels.arrays import Bools, Complexes, Floats, Integers
from model.effects.registry import effect
from model.tones import STANDARD_GRAVITY_MPS2

GAIN, PHASE, SECOND, THIRD, HUM, MODULATION, GATE, OFFSET, CLOCK = range(9)
KINDS = ("gain", "phase", "second harmonic", "third harmonic", "hum", "modulation", "flight/contact", "offset", "clock")
SQUARED = (SECOND, THIRD, HUM)  # stored as unbiased squares: an amplitude without its sign
WANDERS = {
    OFFSET: "the accelerometer's zero wanders by {:.2g} m/s^2 from step to step; no flight depends on it",
    CLOCK: "the forcing's frequency, which scatters by {:.2g} of itself from step to step, tells little of the clock",
}
REVERSED = 0.8 * np.pi  # phase beyond which leads are reversed
SYSTEMATIC = 2e-5  # relative error of the estimator itself
LEAST_WINDOWS = 4  # windows of a step that shows a modulation


@dataclass(frozen=True)
class PlateData:
    """Plate data of all steps, arrays of shape (r,)."""

    kind: Integers  # which number it is
    step: Integers  # row of the step it belongs to
    value: Floats  # gain is a natural logarithm, phase in rad; amplitudes without a sign are squares, less their noise
    sigma: Floats  # standard deviation of that
    omega_radps: Floats  # angular frequency of the tone
    accel_g: Floats  # what the drive asks of the first tone, in units of g (0 where unknown)
    scale: Floats  # amplitude of the first tone, m/s^2
    multiple: Integers  # which multiple of the first forcing tone the tone is
    others: Integers  # which multiples the further forcing tones are (up to 1: none), (r, t)
    # how large the drive asks for them, over the first, (r, t); complex, their phases counted from where the first is
    # a sine
    shares: Complexes
    mains: Complexes  # of gains and phases: what mains of 1 m/s^2 add to the ratio, over that ratio, (r,)

    def __len__(self) -> int:
        return len(self.kind)

    @cached_property
    def level_g(self) -> Floats:
        """Amplitude of one tone with the mean square of all that the drive asks for, in units of g, (r,)."""
        sizes = np.where(self.others > 1, np.abs(self.shares), 0.0)
        return np.asarray(self.accel_g * functools.reduce(np.hypot, sizes.T, np.ones(len(self))))

    @cached_property
    def own_share(self) -> Complexes:
        """How large the drive asks for the forcing tone that a datum is about, over the first, (r,); 1 for others."""
        out = np.ones(len(self), dtype=np.complex128)
        for other, share in zip(self.others.T, self.shares.T, strict=True):
            out = np.where((other > 1) & (self.multiple == other), share, out)
        return out

    def rows_of(self, *kinds: int) -> NDArray[np.intp]:
        """Rows of some kinds."""
        found = self._rows.get(kinds)
        if found is None:
            found = self._rows[kinds] = np.flatnonzero(np.isin(self.kind, kinds))
        return found

    @cached_property
    def _rows(self) -> dict[tuple[int, ...], NDArray[np.intp]]:
        return {}

    @cached_property
    def on_mains(self) -> NDArray[np.intp]:
        """Rows of undriven harmonics that show the mains in place of a line of their own."""
        rows = self.rows_of(SECOND, THIRD)
        off_hz = np.abs(self.omega_radps[rows, None] / (2.0 * np.pi) - MAINS_HZ).min(axis=1)
        return np.asarray(rows[(off_hz < MAX_OFFSET_HZ) & ~np.isin(self.step[rows], self.step[self.rows_of(HUM)])])

    @cached_property
    def quadrature_noise(self) -> Floats:
        """Noise of one quadrature of each squared amplitude, squared: `_square_sigma` undone; in their order."""
        rows = self.rows_of(*SQUARED)
        return np.asarray((np.sqrt(self.value[rows] ** 2 + 3.0 * self.sigma[rows] ** 2) - self.value[rows]) / 6.0)

    def among(self, rows: Bools | NDArray[np.intp]) -> Self:
        """Some of the data."""
        return type(self)(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    def noise(self, steps: Bools | None = None) -> PlateNoise:
        """Noise of all data, or of those of some ``steps`` (m,)."""
        return PlateNoise.of(self.kind, self.sigma, None if steps is None else steps[self.step])

    @classmethod
    def join(cls, parts: Sequence[Self], shift: Integers) -> Self:
        """All parts in one table, their steps' rows moved by ``shift``."""
        most = max(p.others.shape[1] for p in parts)
        parts = [p._widened(most) for p in parts]
        columns = [np.concatenate([getattr(p, name) for p in parts]) for name in cls.__dataclass_fields__]
        columns[1] = np.concatenate([p.step + s for p, s in zip(parts, shift, strict=True)])
        return cls(*columns)

    def _widened(self, count: int) -> Self:
        """The same with places for ``count`` further forcing tones."""
        more = ((0, 0), (0, count - self.others.shape[1]))
        return replace(self, others=np.pad(self.others, more), shares=np.pad(self.shares, more))


def plate_data(fitted: Sequence[StepPlate], setup: Setup) -> tuple[PlateData, tuple[str, ...]]:
    """Plate data of the fitted steps, and notes for the person who reads the report."""
    rows: list[tuple[float, ...]] = []
    notes: list[str] = []
    scale, on_tones = _drive_scale(fitted, setup, notes), mains_on_tones(fitted, setup.sampling.rate_hz)
    # there is one mains: where a driven tone shows it, a line at the other frequency is none
    mains_hz = next((hz for _, hz in on_tones), strongest_mains_hz(fitted))
    power = _drive_form(fitted, notes)
    for i, s in enumerate(fitted):
        first = abs(s.tone(1)[0])
        asked = 0.0
        if s.drive is not None and scale is not None:
            volts = {m: s.drive.amplitudes[k] for k, m in enumerate(s.multiples) if k < len(s.drive.amplitudes)}
            asked = abs(volts[1] * scale) / setup.g_mps2.value
            scales = [scale * _relative(setup, m) * m**power for m in s.forcing_multiples]
            rows += _gain_rows(i, s, scales, asked, first)
        rows += _tone_rows(i, s, asked, first, mains_hz)
        rows += _instrument_rows(i, s, setup, asked, first)
    table = np.array(rows, dtype=np.float64).reshape(-1, 7)
    kind, step = table[:, 0].astype(np.int64), table[:, 1].astype(np.int64)
    first_radps = np.array([s.omega_radps for s in fitted])
    multiple = np.rint(table[:, 4] / first_radps[step]).astype(np.int64)
    most = max((len(s.forcing_multiples) - 1 for s in fitted), default=0)
    others = np.zeros((len(fitted), most), dtype=np.int64)
    shares = np.zeros((len(fitted), most), dtype=np.complex128)
    for i, s in enumerate(fitted):
        for j, m in enumerate(s.forcing_multiples[1:]):
            others[i, j], shares[i, j] = m, _share_of(s, m, power)
    value, sigma, omega_radps, accel_g, first = table[:, 2:].T
    mains = np.zeros(len(kind), dtype=np.complex128)
    for (driven, _), added in on_tones.items():
        mains += np.where(multiple == driven, added[step], 0.0)
    data = PlateData(kind, step, value, sigma, omega_radps, accel_g, first, multiple, others[step], shares[step], mains)
    data, wanders = with_wander(data, np.array([s.first_sample for s in fitted], dtype=np.int64))
    return data, (*notes, *wanders)


def with_wander(data: PlateData, since: Integers) -> tuple[PlateData, tuple[str, ...]]:
    """The same with the wandering of the sensor's zero and of the clock in its uncertainty, and a note on each.

    ``since`` (m,) is the first sample of each step, or its place among the steps of several recordings.
    """
    notes: tuple[str, ...] = ()
    for kind, note in WANDERS.items():
        rows = data.kind == kind
        wander = _wander(since[data.step[rows]], data.value[rows], data.sigma[rows])
        if wander:
            wider = np.where(rows, np.hypot(data.sigma, wander * np.sqrt(np.sum(rows))), data.sigma)
            data, notes = replace(data, sigma=wider), (*notes, note.format(wander))
    return data, notes


def _share_of(s: StepPlate, multiple: int, power: int) -> complex:
    """What the drive asks for as a further forcing tone, over the first, as accelerations; see `PlateData.shares`."""
    if s.drive is None or abs(s.drive.amplitudes[0]) == 0.0:
        return 1.0 + 0j
    first, own = s.drive.amplitudes[0], s.drive.amplitudes[s.multiples.index(multiple)]
    return complex(share_of_first(first, own, multiple) * multiple**power)


def share_of_first(first: Any, other: Any, multiple: Any) -> Any:
    """A further tone's complex amplitude over the first's, its phase counted from where the first is a sine."""
    sine = 1j * first / np.abs(first)  # of the first tone's phase where a sine is 1
    return 1j * other / np.abs(first) / sine**multiple


def _drive_scale(fitted: Sequence[StepPlate], setup: Setup, notes: list[str]) -> complex | None:
    """Plate acceleration in m/s^2 for a volt of drive at the first tone; None without a drive."""
    driven = [s for s in fitted if s.drive is not None and abs(s.drive.amplitudes[0]) > 0]
    ratios = np.array([s.tone(1)[0] / s.drive.amplitudes[0] for s in driven if s.drive is not None])
    if not len(ratios):
        return None
    if setup.drive.g_per_volt is None:
        notes.append("the profile declares no [drive] g_per_volt: a wrong drive gain or lag cannot be seen on this rig")
        return complex(np.median(np.abs(ratios)) * np.exp(1j * np.angle(np.sum(ratios))))
    phase = np.exp(1j * np.radians(setup.drive.phase_deg.value))
    scale = complex(setup.drive.g_per_volt.value * setup.g_mps2.value * phase)
    if abs(np.angle(np.sum(ratios / scale))) > REVERSED:
        notes.append("the plate moves against the declared sense of the drive: taken for reversed leads, not for a lag")
        return -scale
    return scale


def _drive_form(fitted: Sequence[StepPlate], notes: list[str]) -> int:
    """Power of a tone's multiple by which its scale exceeds the first's: 2 where the drive draws the displacement."""
    powers = [
        np.log(
            abs(
                s.tone(s.ratio)[0]
                / s.drive.amplitudes[s.multiples.index(s.ratio)]
                / s.tone(1)[0]
                * s.drive.amplitudes[0]
            )
        )
        / np.log(s.ratio)
        for s in fitted
        if s.drive is not None and s.ratio > 1 and np.all(np.abs(s.drive.amplitudes[: s.ratio]) > 0)
    ]
    if powers and abs(float(np.median(powers)) - 2.0) < 0.3:
        notes.append("the drive draws the plate's displacement, not its acceleration: the second tone is scaled by c^2")
        return 2
    return 0


def _relative(setup: Setup, multiple: int) -> complex:
    """Declared scale of a forcing tone over the first one's."""
    own, first = setup.drive.response(multiple), setup.drive.response(1)
    return 1.0 + 0j if own is None or first is None else own / first


def _gain_rows(i: int, s: StepPlate, scales: list[complex], asked: float, first: float) -> list[tuple[float, ...]]:
    """Gain and phase of each forcing tone against what the drive asks for, in m/s^2 a volt."""
    if s.drive is None:
        return []
    rows: list[tuple[float, ...]] = []
    for m, scale in zip(s.forcing_multiples, scales, strict=True):
        k = s.multiples.index(m)
        z, v = s.acceleration.amplitudes[k], s.drive.amplitudes[k]
        if abs(v) < 20 * s.drive.amplitude_sigma()[k] or abs(z) < 20 * s.acceleration.amplitude_sigma()[k]:
            continue
        ratio, omega = z / (v * scale), m * s.omega_radps
        gain, phase = np.hypot(np.hypot(s.acceleration.polar_sigma(k), s.drive.polar_sigma(k)), SYSTEMATIC)
        rows.append((GAIN, i, float(np.log(abs(ratio))), float(gain), omega, asked, first))
        rows.append((PHASE, i, float(np.angle(ratio)), float(phase), omega, asked, first))
    return rows


def _tone_rows(i: int, s: StepPlate, asked: float, first: float, mains_hz: float) -> list[tuple[float, ...]]:
    """Harmonics and mains, as squares less the noise's share; the amplitude in each window."""
    rows: list[tuple[float, ...]] = []
    fit, sigmas = s.acceleration, s.acceleration.amplitude_sigma()
    for kind, m in ((SECOND, 2), (THIRD, 3)):
        if m in s.multiples and m not in s.forcing_multiples:
            k = s.multiples.index(m)
            noise = float(np.hypot(sigmas[k] / first, SYSTEMATIC))
            square = (abs(fit.amplitudes[k]) / first) ** 2
            rows.append((kind, i, square - 2 * noise**2, _square_sigma(square, noise), m * s.omega_radps, asked, first))
    for k in mains_rows(s, mains_hz):
        square, noise = abs(fit.amplitudes[k]) ** 2, float(np.hypot(sigmas[k], SYSTEMATIC * first))
        power, omega = square - 2 * noise**2, 2 * np.pi * fit.frequencies_hz[k]
        rows.append((HUM, i, power, _square_sigma(square, noise), omega, asked, first))
    if len(s.windows.time_s) >= LEAST_WINDOWS:
        for value, sigma in zip(*s.relative_amplitude(), strict=True):
            rows.append((MODULATION, i, value, float(np.hypot(sigma, SYSTEMATIC)), 0.0, asked, first))
    return rows


def _square_sigma(square: float, noise: float) -> float:
    """Standard deviation of a squared amplitude measured with ``noise`` in each quadrature."""
    return float(np.sqrt(4.0 * square * noise**2 + 4.0 * noise**4))


def power_uncertainty(data: PlateData, predicted: Floats) -> Floats:
    """Additional uncertainty of a squared amplitude whose expected value exceeds the measured one, (r,).

    The error of a square is noise times the amplitude, and chance may have made the measured amplitude small.
    """
    rows, noise, out = data.rows_of(*SQUARED), data.quadrature_noise, np.zeros(len(data))
    out[rows] = 2.0 * np.sqrt(noise * np.maximum(predicted[rows] - data.value[rows] - 2.0 * noise, 0.0))
    return out


def _wander(sample: Integers, offset: Floats, sigma: Floats) -> float:
    """Standard deviation of a sensor's zero about its trend, (m,), beyond its uncertainty; 0 where chance may do it.

    What wanders slowly errs for all steps together: no more is known of the mean of ``m`` steps than of one.
    """
    freedom = len(offset) - 2
    if freedom < 1:
        return 0.0
    left = offset - np.polynomial.Polynomial.fit(sample, offset, 1, w=1.0 / sigma)(sample)
    excess = float(np.sum((left / sigma) ** 2)) / freedom
    # chi square over its freedom scatters by sqrt(2 / freedom): a zero wanders from four of these on
    if excess < 1.0 + 4.0 * np.sqrt(2.0 / freedom):
        return 0.0
    return float(np.sqrt((excess - 1.0) / np.mean(1.0 / sigma**2)))


def _instrument_rows(i: int, s: StepPlate, setup: Setup, asked: float, first: float) -> list[tuple[float, ...]]:
    """Contact against flight, offset, clock."""
    rows: list[tuple[float, ...]] = []
    # a change between contact and flight known worse than to 5 % says nothing
    if s.flight_log_gain is not None and s.flight_log_gain[1] < 0.05:
        log_gain, sigma = s.flight_log_gain
        rows.append((GATE, i, log_gain, float(np.hypot(sigma, SYSTEMATIC)), s.omega_radps, asked, first))
    channel = setup.channels.accelerometer
    if channel.coupling == "dc" and channel.offset_v is not None:
        known = channel.offset_v.uncertainty / abs(channel.volts_per_mps2)
        sigma = float(np.hypot(s.acceleration.offset_uncertainty, known))
        weight = setup.g_mps2.value if channel.reads_gravity else 0.0
        rows.append((OFFSET, i, s.acceleration.offset - weight, max(sigma, 1e-4), 0.0, asked, first))
    error = s.frequency_hz / setup.forcing.frequency_hz - 1.0
    # beyond half a per cent it is another frequency, no error of a clock
    if abs(error) < 5e-3 and 0 < s.frequency_uncertainty_hz < np.inf:
        sigma = max(s.frequency_uncertainty_hz / s.frequency_hz, 1e-8)
        rows.append((CLOCK, i, error, sigma, s.omega_radps, asked, first))
    return rows


def expected(data: PlateData, values: Mapping[str, Mapping[str, Floats]]) -> Floats:
    """Expected value of each datum, (r,), under ``values`` by effect and parameter, arrays (m,) over the steps."""
    out = np.zeros(len(data))
    for name, table in values.items():
        if not table or not effect(name).hooks.keys() & PLATE_HOOKS:
            continue
        points = np.array(list(table.values()))
        for point in np.unique(points, axis=1).T:
            rows = np.flatnonzero(np.all(points == point[:, None], axis=0)[data.step])
            out[rows] += share(data.among(rows), name, dict(zip(table, map(float, point), strict=True)))
    return out


def share(data: PlateData, name: str, p: Mapping[str, float]) -> Floats:
    """Contribution of one effect, its parameters the same in all steps, to the expected value of each datum, (r,)."""
    out, hooks = np.zeros(len(data)), effect(name).hooks
    if p == effect(name).effect.null_values:
        return out
    for hook in hooks.keys() & PLAIN_HOOKS_OF_KIND.keys():
        kind, of_value = PLAIN_HOOKS_OF_KIND[hook]
        out[data.rows_of(kind)] += of_value(hooks[hook](p))
    for hook in hooks.keys() & {"hum_mps2", "pickup_mps2"}:
        out[data.on_mains] += (hooks[hook](p) / data.scale[data.on_mains]) ** 2
        picked_up = hooks[hook](p) * data.mains
        _add_transfer(out, data, (1.0 + picked_up).__getitem__)
    if "transfer" in hooks:
        _add_transfer(out, data, lambda rows: hooks["transfer"](p, data.omega_radps[rows], data.level_g[rows]))
    # without bound where the plate is still, which a driven tone's is not
    if "accelerometer_response" in hooks and "pickup_mps2" not in hooks:
        _add_transfer(out, data, lambda rows: hooks["accelerometer_response"](p, data.omega_radps[rows]))
    if "harmonics" in hooks:
        _add_harmonics(out, data, functools.partial(hooks["harmonics"], p))
    return out


def _add_transfer(out: Floats, data: PlateData, factor: Callable[[NDArray[np.intp]], Any]) -> None:
    """Add the logarithm of a complex ``factor`` of the tones in some rows to gains and phases."""
    for kind, part in ((GAIN, np.abs), (PHASE, np.angle)):
        rows = data.rows_of(kind)
        found = part(np.asarray(factor(rows), dtype=np.complex128))
        out[rows] += np.log(found) if kind == GAIN else found


# hooks with one number for one kind of datum
PLAIN_HOOKS_OF_KIND: dict[str, tuple[int, Callable[[Any], float]]] = {
    "hum_mps2": (HUM, lambda size: size**2),
    "pickup_mps2": (HUM, lambda size: size**2),
    "flight_gain": (GATE, lambda change: float(np.log1p(change))),
    "offset_mps2": (OFFSET, float),
    "time_scale": (CLOCK, lambda factor: 1.0 / factor - 1.0),
}
# all that change the expected value of plate data
PLATE_HOOKS = frozenset({"harmonics", "transfer", "accelerometer_response", *PLAIN_HOOKS_OF_KIND})


def _add_harmonics(out: Floats, data: PlateData, hook: Callable[..., Any]) -> None:
    """Harmonics on a forcing tone change its gain and phase; the others are squares relative to the first tone."""

    def added(rows: NDArray[np.intp], multiple: Integers) -> Complexes:
        accel_g = np.where(data.accel_g[rows] > 0.0, data.accel_g[rows], data.scale[rows] / STANDARD_GRAVITY_MPS2)
        return np.asarray(hook(multiple, data.others[rows], data.shares[rows], accel_g))

    def on_forcing(rows: NDArray[np.intp]) -> Complexes:
        return np.asarray(1.0 + added(rows, data.multiple[rows]) / data.own_share[rows])

    _add_transfer(out, data, on_forcing)
    rows = data.rows_of(SECOND, THIRD)
    first = 1.0 + added(rows, np.ones_like(data.multiple[rows]))  # the datum is a part of the tone as it is, bent
    out[rows] += np.abs(added(rows, data.multiple[rows]) / first) ** 2
