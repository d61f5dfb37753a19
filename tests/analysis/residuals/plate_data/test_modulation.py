"""A swelling plate: what steps, windows and the ball see of it, against brute force; pitch and phase found again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis.plate.step_state import FitIntervals
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.uncertainty import uncertainty_at
from analysis.residuals.observations import Observations, observations_from
from analysis.residuals.plate_data.modulation import AmplitudeModulation
from analysis.residuals.plate_data.plate_observables import HUM, MODULATION, PlateData
from analysis.residuals.values import ParameterId
from analysis.thresholds import FROZEN
from kernels.arrays import Complexes, Floats
from model.effects.registry import row
from model.integrator.one_step import one_ahead
from model.integrator.problem import Measured, PlateSteps

G = 9.80665
FORCING_HZ = 25.37
DEPTH, HZ, PHASE = 0.06, 2.3, 0.7
CARRIERS = np.array([16.0 * np.exp(0.4j), 30.0 * np.exp(-1.1j)])
STEP_S = 20.0 / FORCING_HZ / 20_000  # of the fine grid
LINE_HZ = 50.0  # a fitted line near the second tone: the swell leaks into it
OTHERS_HZ = (*(FORCING_HZ * m for m in (3, 4, 5, 6)), LINE_HZ)
DEEP: tuple[ParameterId, ParameterId] = (("amplitude_modulation", "depth"), ("amplitude_modulation", "frequency_hz"))


def swelling(t: Floats, phase: float = PHASE) -> Floats:
    """Acceleration of the plate that swells, m/s^2."""
    w = 2.0 * np.pi * FORCING_HZ
    carrier = np.sum(CARRIERS[:, None] * np.exp(1j * w * np.outer([1, 2], t)), axis=0).real
    return np.asarray((1.0 + DEPTH * np.sin(2.0 * np.pi * HZ * t + phase)) * carrier)


def fitted(t: Floats, x: Floats, hz: Floats) -> Complexes:
    """Amplitudes of tones by least squares with a constant, on a fine grid."""
    turns = 2.0 * np.pi * np.outer(t, hz)
    design = np.column_stack([np.ones(len(t)), np.cos(turns), -np.sin(turns)])
    found = np.linalg.lstsq(design, x, rcond=None)[0][1:]
    return np.asarray(found[: len(hz)] + 1j * found[len(hz) :])


def swells_of(
    phases: tuple[float, ...], *, spans: int = 6, noise: float = 0.0, masked: float = 0.0
) -> tuple[AmplitudeModulation, PlateSteps]:
    """Steps and windows of recordings of a plate that swells with these phases, fitted as an analysis does.

    The part ``masked`` of each cycle of the first tone is left out.
    """
    rng = np.random.default_rng(5)
    every = np.array([FORCING_HZ, 2 * FORCING_HZ, *OTHERS_HZ])
    table: dict[str, list[object]] = {name: [] for name in ("z", "span", "recording", "step", "window", "value")}
    kept = []
    for recording, phase in enumerate(phases):
        for k in range(spans):
            start = 0.31 + 1.7 * k
            t = start + (np.arange(20_000) + 0.5) * STEP_S
            x = swelling(t, phase) + noise * rng.standard_normal(len(t))
            keep = np.mod(FORCING_HZ * t - 0.4, 1.0) >= masked
            z = fitted(t[keep], x[keep], every)
            left = x - np.real(np.exp(2j * np.pi * np.outer(t, every)) @ z)
            for part in range(9):
                own = np.flatnonzero(keep & (np.arange(20_000) // 2_100 == part))
                seen = z[:2] + fitted(t[own], left[own], every[:2])
                change = np.sum((np.conj(z[:2]) * (seen - z[:2])).real) / np.sum(np.abs(z[:2]) ** 2)
                table["step"].append(len(table["z"]))
                table["window"].append((start + part * 2_100 * STEP_S, start + (part + 1) * 2_100 * STEP_S))
                table["value"].append(change)
            within = 9 * len(kept) + np.arange(20_000) // 2_100
            within[9 * 2_100 :] = -1
            stretches = FitIntervals.of_blocks(0, keep, within, np.zeros(20_000, dtype=np.bool_), STEP_S)
            kept.append(replace(stretches, span_s=stretches.span_s + start))
            table["z"].append(z)
            table["span"].append((start, start + 20.0 / FORCING_HZ))
            table["recording"].append(recording)
    z, m = np.array(table["z"]), len(table["z"])
    value = np.array(table["value"], dtype=np.float64)
    none = np.zeros(m, dtype=np.int64)
    swells = AmplitudeModulation(
        np.array(table["recording"], dtype=np.int64),
        np.array(table["span"]),
        np.full(m, np.nan),
        np.full(m, np.inf),
        np.array(table["step"], dtype=np.int64),
        np.array(table["window"]),
        value,
        np.full(len(value), 1e-3),
        np.tile(2.0 * np.pi * every, (m, 1)),
        z,
        np.full(m, 2),
        FitIntervals.join(kept, np.arange(m), none),
    )
    tones = np.zeros((m, 8), dtype=np.complex128)
    tones[:, :2] = z[:, :2]
    omega = np.tile(2.0 * np.pi * FORCING_HZ * np.array([1, 2, 1, 1, 1, 1, 1, 1.0]), (m, 1))
    return swells, PlateSteps(omega, tones, np.full(m, 1.0 / FORCING_HZ))


def test_the_modulated_tones_are_the_plate_that_swells() -> None:
    """From tones fitted to steps of a swelling plate, its acceleration comes back at any time."""
    swells, plate = swells_of((PHASE,))
    modulated = swells.modulated(plate, np.full(6, DEPTH), HZ)
    t = np.linspace(0.5, 1.0, 400)
    turned = np.exp(1j * np.outer(t, modulated.omega_radps[0]))
    assert (turned @ modulated.acceleration_mps2[0]).real == pytest.approx(swelling(t), abs=2e-3)


@pytest.mark.parametrize("masked", [0.0, 0.35])
def test_windows_show_what_least_squares_finds_in_them(masked: float) -> None:
    """The deviation said of each window is the one fitted there, the line near the second tone and masks included."""
    swells, plate = swells_of((PHASE,), masked=masked)
    m, n = len(swells.tones), len(swells.value)
    kind, step = np.repeat([MODULATION, HUM], [n, m]), np.concatenate([swells.window_step, np.arange(m)])
    none, omega = np.zeros(n + m), np.repeat([0.0, 2.0 * np.pi * LINE_HZ], [n, m])
    data = PlateData(kind, step, none, none, omega, none, none, step, step[:, None], none[:, None] + 0j, none + 0j)
    expected, _ = swells.expected(data, plate, np.full(m, DEPTH), HZ)
    assert np.max(np.abs(swells.value)) > 0.8 * DEPTH
    assert expected[:n] == pytest.approx(swells.value, abs=3e-4)
    found = np.abs(swells.seen_mps2[:, -1])
    assert np.max(found) > 0.1
    assert np.sqrt(expected[n:]) == pytest.approx(found, abs=5e-3)  # the line is the modulation's


def test_each_recording_has_its_own_phase() -> None:
    """Two recordings of one rig, begun at different moments of the swell: pitch, depth and both phases are found."""
    phases = (PHASE, -2.0)
    swells, _ = swells_of(phases, noise=0.3)
    (hz, depth), *_ = swells.hints()
    assert hz == pytest.approx(HZ, abs=0.01)
    assert depth == pytest.approx(DEPTH, rel=0.03)
    assert swells.phases(HZ)[[0, -1]] == pytest.approx(phases, abs=0.03)


def test_recordings_of_one_step_each_are_scanned_no_finer_than_windows_show() -> None:
    """Ten files that all begin at the same time after their start, as those of one step do: the swell is found."""
    swells, _ = swells_of((PHASE,) * 10, spans=1)
    swells = replace(swells, gain=np.zeros(10), gain_sigma=np.full(10, 1e-3))
    assert any(hz == pytest.approx(HZ, rel=0.1) for hz, _ in swells.hints())


def test_a_swell_slower_than_a_step_is_found_in_the_gains() -> None:
    """With a period of many steps, the steps' gains against the drive hold what no window can show."""
    swells, _ = swells_of((PHASE,), spans=14)
    slow, middle = 0.11, swells.span_s.mean(axis=1)
    gain = np.log1p(0.01 * np.sin(2.0 * np.pi * slow * middle + 1.0)) + 0.05
    rng = np.random.default_rng(3)
    swells = replace(
        swells, gain=gain, gain_sigma=np.full(14, 2e-4), value=1e-3 * rng.standard_normal(len(swells.value))
    )
    assert any(hz == pytest.approx(slow, rel=0.1) for hz, _ in swells.hints())
    assert swells.phases(slow)[0] == pytest.approx(1.0, abs=0.1)


def test_a_ball_on_a_swelling_plate_lands_where_brute_force_says() -> None:
    """Take-off and landing one event ahead, against a fine march of the ball on the swelling acceleration itself."""
    swells, plate = swells_of((PHASE,))
    modulated = swells.modulated(plate, np.full(6, DEPTH), HZ)
    dt = 2e-6
    t = 0.4 + dt * np.arange(400_000)
    a = swelling(t)
    first = int(np.argmax(a < -G))
    h = np.cumsum(np.cumsum(-G - a[first:])) * dt * dt
    flies = int(np.argmax(h[100:] < 0.0)) + 100
    takeoff, landing = t[first], t[first + flies]
    start = takeoff - 2e-3
    measured = Measured(
        np.array([start - 0.01, takeoff]),
        np.array([start, landing]),
        np.array([False, False]),
        np.array([False, True]),
        np.zeros(2, dtype=np.int64),
        np.array([False, True]),
    )
    found = one_ahead(measured, modulated, row({}, G))
    assert found.takeoff_s[1] == pytest.approx(takeoff, abs=5e-6)
    assert found.landing_s[1] == pytest.approx(landing, abs=2e-5)
    steady = one_ahead(measured, plate, row({}, G))
    assert abs(steady.landing_s[1] - landing) > 1e-4


def recorded(make, effects: dict[str, dict[str, float]]) -> Observations:  # type: ignore[no-untyped-def]
    """Evidence of a short ramp on the simulated rig."""
    gammas = np.linspace(0.7, 2.0, 10)[[3, 7, 0, 5, 9, 1, 8, 4, 2, 6]]
    path: Path = make(gammas, settle=8, hold=20, effects=effects).path
    return observations_from([path])


@pytest.mark.parametrize("hz", [0.2, 4.6])
def test_a_hidden_modulation_explains_plate_and_landings(make, hz: float) -> None:  # type: ignore[no-untyped-def]
    """Slower and faster than a step: what the plate shows of it brings plate data and landings to their noise."""
    observations = recorded(make, {"amplitude_modulation": {"depth": 0.03, "frequency_hz": hz}})
    hints = observations.modulation.hints() if observations.modulation is not None else ()
    model, rows = ForwardModel(observations, {}), observations.plate.kind == MODULATION
    found = min(hints, key=lambda hint: abs(hint[0] - hz))
    assert found[0] == pytest.approx(hz, abs=0.02)
    assert found[1] == pytest.approx(0.03, rel=0.05)
    values = dict(zip(DEEP, (found[1], hz), strict=True))
    before, after, sigma = model.residuals({}), model.residuals(values), uncertainty_at(model, values).landing_total_s
    assert np.sqrt(np.mean((after.plate[rows] / observations.plate.sigma[rows]) ** 2)) < 1.25
    judged = observations.scored & np.isfinite(after.landing_s) & np.isfinite(before.landing_s)
    miss = [np.median(np.abs(r.landing_s[judged] / sigma[judged])) for r in (before, after)]
    assert miss[0] > 3.0 * miss[1]
    assert miss[1] < 1.2


def test_a_steady_plate_swells_by_no_more_than_its_noise(make) -> None:  # type: ignore[no-untyped-def]
    """With impacts that ring in the accelerometer, a steady plate's windows scatter as stated, and swell by nothing."""
    observations = recorded(make, {})
    rows = observations.plate.kind == MODULATION
    z = observations.plate.value[rows] / observations.plate.sigma[rows]
    assert rows.sum() > 60
    assert 0.8 < np.sqrt(np.mean(z**2)) < 1.2
    assert observations.modulation is not None
    model = ForwardModel(observations, {})
    for hz, depth in observations.modulation.hints():
        squares = [
            np.sum((model.residuals(values).plate / observations.plate.sigma) ** 2)
            for values in ({}, dict(zip(DEEP, (depth, hz), strict=True)))
        ]
        assert 0.5 * (squares[0] - squares[1]) < FROZEN.gain_nats  # of hundreds of frequencies the best one


def test_a_sideband_at_the_mains_meets_what_an_ordinary_cable_picks_up(make) -> None:  # type: ignore[no-untyped-def]
    """The two add at another phase in each step: 0.3 mV of mains is no motion that the modulation fails to explain."""
    hidden = {"depth": 0.03, "frequency_hz": 1.6}
    observations = recorded(make, {"amplitude_modulation": hidden, "mains_pickup": {"amplitude_g": 0.003}})
    assert observations.modulation is not None
    model, rows = ForwardModel(observations, {}), observations.plate.kind == HUM
    found = min(observations.modulation.hints(), key=lambda hint: abs(hint[0] - 1.6))
    left = model.residuals(dict(zip(DEEP, found[::-1], strict=True))).plate[rows] / observations.plate.sigma[rows]
    assert np.sqrt(np.mean(left**2)) < FROZEN.plate_rms_z
