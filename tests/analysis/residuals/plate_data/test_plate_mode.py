"""A ringing plate in masked fits: tones, offset, swell and mass loading against brute force on a fine grid."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.plate.step_state import FitIntervals
from analysis.residuals.plate_data.plate_mode import IntervalSums, Ringing, driven
from analysis.residuals.plate_data.plate_observables import GAIN, GATE, MODULATION, OFFSET, PHASE, SECOND, PlateData
from kernels.arrays import Floats
from model.integrator.one_step import Predicted
from model.integrator.problem import PlateSteps

FORCING_HZ, RING_HZ, DECAY_PER_S = 25.37, 9.1, 6.0
CYCLES, POINTS, WINDOWS = 20, 20_000, 9
STEP_S = CYCLES / FORCING_HZ / POINTS
FORCED = 16.0 * np.exp(0.4j)
TONES_HZ = FORCING_HZ * np.array([1.0, 2.0, 3.0])

t = (np.arange(POINTS) + 0.5) * STEP_S
turn = np.mod(FORCING_HZ * t, 1.0)
keep, contact = (turn < 0.55) | (turn >= 0.75), turn < 0.2
window = np.where(np.arange(POINTS) < WINDOWS * 2_100, np.arange(POINTS) // 2_100, -1)
ring = np.exp(-DECAY_PER_S * t) * np.cos(2.0 * np.pi * RING_HZ * t + 0.3) + 0.4 * contact * (1.0 + np.sin(9.0 * t))


def fitted(columns: Floats, x: Floats) -> Floats:
    """Least squares on the grid."""
    return np.asarray(np.linalg.lstsq(columns, x, rcond=None)[0])


def waves(hz: Floats) -> Floats:
    """Constant, then cosine and minus sine of each tone, on the grid."""
    turns = 2.0 * np.pi * np.outer(t, hz)
    pairs = np.stack([np.cos(turns), -np.sin(turns)], axis=2).reshape(len(t), -1)
    return np.column_stack([np.ones(len(t)), pairs])


def said_of(rows: list[tuple[int, float]], *, part: float = 1.0, second: complex = 0.0) -> Floats:
    """What the mode is said to add to data of (kind, multiple of the forcing); ``part`` of it has been followed.

    The plate has a ``second`` harmonic besides.
    """
    turns = np.exp(2j * np.pi * FORCING_HZ * t)
    x = np.real(FORCED * turns + second * turns**2) + ring
    z = fitted(waves(TONES_HZ)[keep], x[keep])
    seen = (z[1::2] + 1j * z[2::2])[None]
    in_windows = window if rows[0][0] == MODULATION else np.full(POINTS, -1)
    kept = FitIntervals.of_blocks(0, keep, in_windows, contact, STEP_S)
    omega = 2.0 * np.pi * np.concatenate([[0.0], TONES_HZ])
    ear = Ringing(kept, omega[None], seen, np.array([1]), np.array([[0]]))
    block = np.searchsorted(kept.span_s[:, 0], t, side="right") - 1
    heard = np.zeros((len(kept.step), 4), dtype=np.complex128)
    known = keep & ((t < part * t[-1]) | (part == 1.0))
    np.add.at(heard, block[known], (ring[:, None] * np.exp(-1j * np.outer(t, omega)) * STEP_S)[known])
    heard_s = np.asarray(np.bincount(block[known], minlength=len(kept.step)) * STEP_S, dtype=np.float64)
    n, kinds = len(rows), np.array([kind for kind, _ in rows])
    omegas = 2.0 * np.pi * FORCING_HZ * np.array([multiple for _, multiple in rows])
    zero, one = np.zeros(n, dtype=np.int64), np.ones(n)
    data = PlateData(
        kinds, zero, one, one, omegas, one, np.full(n, 16.0), zero, zero[:, None], one[:, None] + 0j, 0j * one
    )
    plate = PlateSteps(omega[None, 1:2], seen[:, :1], np.array([1.0 / FORCING_HZ]))
    n0 = np.zeros(1)  # of the flights: not used
    predicted = Predicted(n0, n0, n0, n0, n0, n0, n0, n0, ear.of_tones(heard, heard_s), heard, heard_s)
    return ear.added(data, plate, predicted)[0]


def test_masked_tones_and_offset_hold_what_least_squares_puts_there() -> None:
    """Gain, phase, offset and second harmonic are those of a masked fit of the ring, not of its mean over all time."""
    z = fitted(waves(TONES_HZ)[keep], ring[keep])
    ratio = (FORCED + z[1] + 1j * z[2]) / FORCED
    wanted = [np.log(abs(ratio)), np.angle(ratio), z[0], (z[3] ** 2 + z[4] ** 2) / 16.0**2]
    said = said_of([(GAIN, 1.0), (PHASE, 1.0), (OFFSET, 0.0), (SECOND, 2.0)])
    assert said == pytest.approx(wanted, rel=2e-3, abs=1e-7)
    everywhere = fitted(waves(TONES_HZ), ring)
    assert abs(everywhere[0] - z[0]) > 0.1 * abs(z[0])  # the mask matters


def test_a_ring_interferes_with_a_harmonic_that_is_there() -> None:
    """What the ring adds to the harmonic's power is what is measured less what the harmonic has without the ring."""
    second = 0.5 * np.exp(2.5j)
    z = fitted(waves(TONES_HZ)[keep], ring[keep])
    wanted = (abs(second + complex(z[3], z[4])) ** 2 - abs(second) ** 2) / 16.0**2
    assert wanted < 0.0
    assert said_of([(SECOND, 2.0)], second=second) == pytest.approx([wanted], rel=5e-3)


def test_windows_swell_by_what_rings_in_them() -> None:
    """A few cycles at a time, a ring that decays looks like a swell: what each window's own fit finds of it."""
    every = waves(TONES_HZ)
    left = ring - every @ fitted(every[keep], ring[keep])
    z = FORCED + complex(*fitted(every[keep], ring[keep])[1:3])
    wanted = []
    for k in range(WINDOWS):
        own = keep & (window == k)
        change = fitted(every[own, :3], left[own])
        wanted.append((np.conj(z) * complex(change[1], change[2])).real / abs(z) ** 2)
    said = said_of([(MODULATION, 0.0)] * WINDOWS)
    assert np.max(np.abs(wanted)) > 5e-3
    assert said == pytest.approx(wanted, abs=2e-5)


def test_contact_and_flight_differ_by_what_the_ball_presses() -> None:
    """Mass loading as the joint fit of contact and flight sees it."""
    every = waves(TONES_HZ)
    joint = np.column_stack([every, every[:, :3] * contact[:, None]])
    z = fitted(joint[keep], ring[keep])
    flight, touching = complex(z[1], z[2]), complex(z[1] + z[8], z[2] + z[9])
    wanted = np.log(abs(FORCED + flight) / abs(FORCED + touching))
    assert abs(wanted) > 1e-3
    assert said_of([(GATE, 1.0)]) == pytest.approx([wanted], rel=5e-3)


def test_windows_in_which_the_mode_was_lost_say_nothing() -> None:
    """Where the flights do not tell how the plate rang, no swell is promised."""
    said = said_of([(MODULATION, 0.0)] * WINDOWS, part=0.5)
    assert np.all(said[5:] == 0.0)
    assert np.all(said[:4] != 0.0)


def test_a_fit_without_intervals_sums_to_nothing() -> None:
    """Sums over each fit's intervals, against a loop: without any they are zero, also of the last fit."""
    rng = np.random.default_rng(5)
    rows, fit, n = np.array([4, 0, 2, 7]), np.array([1, 1, 3, 3]), 5
    seconds, projection = rng.uniform(0.1, 1.0, 8), rng.standard_normal((8, 3)) + 1j
    sums = IntervalSums.of(rows, fit, n, seconds)
    wanted = [sum((projection[r] for r, f in zip(rows, fit, strict=True) if f == k), np.zeros(3)) for k in range(n)]
    np.testing.assert_allclose(sums.total(projection), wanted)
    side, part = sums.sides(projection, 0.5 * seconds)
    assert part == pytest.approx([0.0, 0.5, 0.0, 0.5, 0.0])
    np.testing.assert_allclose(side[:, :3], np.array(wanted) / np.where(part > 0.0, part, 1.0)[:, None])
    assert not IntervalSums.of(rows[:0], fit[:0], n, seconds).sides(projection, seconds)[0].any()


def test_a_load_is_heard_as_a_masked_fit_of_what_the_plate_does_without_it() -> None:
    """A plate that accelerates by 1 % of a_p + g more in flight: offset, gain, phase and tone against least squares."""
    change, g = 0.01, 9.80665
    a_p = np.real(FORCED * np.exp(2j * np.pi * FORCING_HZ * t))
    every = waves(TONES_HZ)
    z = fitted(every[keep], (a_p + change * np.where(contact, 0.0, a_p + g))[keep])
    tone = complex(z[1], z[2])
    kept = FitIntervals.of_blocks(0, keep, np.full(POINTS, -1), contact, STEP_S)
    omega = 2.0 * np.pi * np.concatenate([[0.0], TONES_HZ])
    ear = Ringing(kept, omega[None], np.array([[FORCED, 1e-9, 1e-9]]), np.array([1]), np.array([[0]]))
    zero, one = np.zeros(3, dtype=np.int64), np.ones(3)
    omegas = 2.0 * np.pi * FORCING_HZ * np.array([0.0, 1.0, 1.0])
    kinds = np.array([OFFSET, GAIN, PHASE])
    data = PlateData(kinds, zero, one, one, omegas, one, one, zero, zero[:, None], one[:, None] + 0j, 0j * one)
    plate = PlateSteps(omega[None, 1:2], np.array([[FORCED]]), np.array([1.0 / FORCING_HZ]))
    load = ear.loading(data, plate, g)
    assert change * load.tones_mps2[0, 0] == pytest.approx(tone - FORCED, abs=2e-4)
    ratio = tone / FORCED
    wanted = [z[0], np.log(abs(ratio)), np.angle(ratio)]
    assert load.added(np.full(3, change)) == pytest.approx(wanted, rel=0.03, abs=1e-5)


def test_a_tone_that_is_not_there_is_not_loaded() -> None:
    """Columns without a tone stay empty, whatever tone lies nearest."""
    kept = FitIntervals.of_blocks(0, keep, np.full(POINTS, -1), contact, STEP_S)
    omega = 2.0 * np.pi * np.concatenate([[0.0], TONES_HZ])
    ear = Ringing(kept, omega[None], np.array([[FORCED, 0.0, 0.0]]), np.array([1]), np.array([[0, 0]]))
    plate = PlateSteps(np.array([[omega[1], 1.0]]), np.array([[FORCED, 0.0]]), np.array([1.0 / FORCING_HZ]))
    none, nothing = np.zeros(0, dtype=np.int64), np.zeros(0)
    data = PlateData(
        none,
        none,
        nothing,
        nothing,
        nothing,
        nothing,
        nothing,
        none,
        none[:, None],
        nothing[:, None] + 0j,
        nothing + 0j,
    )
    load = ear.loading(data, plate, 9.80665)
    assert load.tones_mps2[0, 0] != 0.0 and load.tones_mps2[0, 1] == 0.0


def test_a_mode_that_leaves_nothing_of_a_tone_is_wrong_by_a_finite_amount() -> None:
    """A search passes points at which the mode would be the whole measured tone: a large number there, not none."""
    z = np.array([3.0 + 1.0j, 2.0 + 0.0j])
    left = driven(z, np.array([3.0 + 1.0j, 1.0 + 0.0j]))
    assert np.all(np.isfinite(np.log(np.abs(z / left)))) and left[1] == 1.0


def test_a_mode_that_is_the_whole_tone_leaves_numbers_and_no_exception() -> None:
    """With the mode as large as the measured tone, and with nothing unmasked at all, plate data stay finite."""
    omega = 2.0 * np.pi * np.array([[0.0, FORCING_HZ]])
    z = np.array([[3.0 + 1.0j]])
    plate = PlateSteps(omega[:, 1:], z, np.array([1.0 / FORCING_HZ]))
    n0, one, zero = np.zeros(1), np.ones(3), np.zeros(3, dtype=np.int64)
    kinds = np.array([GAIN, PHASE, GATE])
    data = PlateData(
        kinds, zero, one, one, np.full(3, omega[0, 1]), one, one, zero, zero[:, None], one[:, None] + 0j, 0j * one
    )
    for kept in (FitIntervals.whole(np.array([[0.0, 1.0]])), FitIntervals.whole(np.zeros((0, 2)))):
        ear = Ringing(kept, omega, z, np.array([1]), np.array([[0]]))
        projection = np.tile(0.5 * z, (len(kept.step), 2))
        predicted = Predicted(n0, n0, n0, n0, n0, n0, n0, n0, z, projection, kept.seconds)
        added, sigma = ear.added(data, plate, predicted)
        assert np.all(np.isfinite(added)) and np.all(np.isfinite(sigma))
