"""The motion of a plate mode under what a ball does to the plate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from analysis.plate.ringing.ball_push import Push, ball_push
from analysis.plate.ringing.mode_motion import (
    KICK_MPS,
    KICK_PART,
    ModeMotion,
    PushedPlate,
    answer,
    ringing_after_changes,
    turn_of,
)
from analysis.residuals.plate_data.plate_mode import BlockIntegrals

HZ, DAMPING, RATIO, BLOCK_S = 6.0, 0.05, 0.1, 1e-3
IMPACT_S, IMPULSE_MPS = np.array([0.1234, 0.2005, 0.3141]), np.array([-0.3, -0.2, -0.25])


def _pushed(impulse_mps: np.ndarray = IMPULSE_MPS, answer_mps2: np.ndarray | None = None) -> PushedPlate:
    """A push of a sine's block means, and three impacts; with an answer, known but about the impacts."""
    time_s = (np.arange(400) + 0.5) * BLOCK_S
    push = Push(-9.8 - 5.0 * np.sin(150.0 * time_s), IMPACT_S, impulse_mps, BLOCK_S)
    known = np.full(400, answer_mps2 is not None)
    for hit_s in IMPACT_S:
        known[int(hit_s / BLOCK_S) - 1 : int(hit_s / BLOCK_S) + 3] = False
    return PushedPlate(push, np.zeros(400) if answer_mps2 is None else answer_mps2, known, 0.05 * RATIO)


def _marched(pushed: PushedPlate, until_s: np.ndarray) -> np.ndarray:
    """Displacement and speed at times, by a march of the differential equation from block to block and kick to kick."""
    w, push = 2.0 * np.pi * HZ, pushed.push.contact_mps2
    state, out, now = np.array([RATIO * push[0] / w**2, 0.0]), list[np.ndarray](), 0.0
    stops = np.unique(np.concatenate([np.arange(1, 401) * BLOCK_S, IMPACT_S, until_s]))
    for stop in stops:
        force = RATIO * push[min(int((0.5 * (now + stop)) / BLOCK_S), 399)]
        found = solve_ivp(
            lambda _, y, f=force: [y[1], f - 2.0 * DAMPING * w * y[1] - w**2 * y[0]],
            (now, stop),
            state,
            rtol=1e-10,
            atol=1e-13,
        )
        state, now = found.y[:, -1].copy(), stop
        hit = np.flatnonzero(stop == IMPACT_S)
        if len(hit):
            state[1] += RATIO * IMPULSE_MPS[hit[0]]
        if stop in until_s:
            out.append(state)
    return np.array(out)


@pytest.fixture(scope="module")
def motion() -> ModeMotion:
    """Of the mode under that push."""
    return _pushed().moved(HZ, DAMPING, RATIO)


def test_a_mode_moves_as_its_differential_equation_says(motion: ModeMotion) -> None:
    """Displacement and speed at times within blocks, and just after an impact."""
    at_s = np.array([0.0507, 0.1234, 0.2503, 0.3992])
    np.testing.assert_allclose(motion.state(at_s), _marched(_pushed(), at_s), rtol=1e-6, atol=1e-9)


def test_at_a_landing_the_contact_of_its_block_has_only_begun() -> None:
    """A ball that stays where it lands presses for the rest of the block: just after the landing there is the kick."""
    contact, lands_s = np.zeros(400), 0.1006
    contact[100], contact[101:] = 0.4 * -30.0, -30.0
    plate = PushedPlate(
        Push(contact, np.array([lands_s]), np.array([-0.3]), BLOCK_S), np.zeros(400), contact > 0.0, 1.0
    )
    state = plate.moved(HZ, DAMPING, RATIO).state(np.array([lands_s]), landings=True)
    np.testing.assert_allclose(state, [[0.0, -0.3 * RATIO]], atol=1e-12)


def test_what_the_speed_gains_in_blocks_leaves_out_the_jumps_of_impacts(motion: ModeMotion) -> None:
    """All gains and all jumps together are the change of the speed."""
    ends = motion.state(np.array([0.0, 0.4]))[:, 1]
    assert np.sum(motion.gained_mps) == pytest.approx(ends[1] - ends[0] - RATIO * np.sum(IMPULSE_MPS), rel=1e-9)


def test_kicks_are_corrected_by_the_acceleration_between_impacts(motion: ModeMotion) -> None:
    """Kicks wrong by three hundredths: the speed's error falls to a third, although the acceleration is noisy."""
    noise = 0.05 * RATIO * np.random.default_rng(3).standard_normal(400)
    wrong = 1.03 * IMPULSE_MPS
    at_s = np.linspace(0.33, 0.39, 50)
    errors = [
        np.sqrt(np.mean((plate.moved(HZ, DAMPING, RATIO).state(at_s) - motion.state(at_s))[:, 1] ** 2))
        for plate in (_pushed(wrong), _pushed(wrong, motion.gained_mps / BLOCK_S + noise))
    ]
    assert errors[1] < errors[0] / 3.0


def test_kicks_are_unknown_where_flights_were_missed(motion: ModeMotion) -> None:
    """An impact of which nothing is known: the motion is found again from the acceleration after it."""
    missed = np.array([-0.3, 0.0, -0.25])
    plate = replace(_pushed(missed, motion.gained_mps / BLOCK_S), torn_s=(0.15,))
    at_s = np.array([0.25, 0.35])
    np.testing.assert_allclose(plate.moved(HZ, DAMPING, RATIO).state(at_s), motion.state(at_s), atol=3e-4)
    assert np.abs(_pushed(missed).moved(HZ, DAMPING, RATIO).state(at_s) - motion.state(at_s)).max() > 5e-3


@pytest.mark.parametrize("noise_mps2", [0.01, 0.1])
def test_a_modes_motion_errs_by_as_much_as_it_says(noise_mps2: float) -> None:
    """Kicks that err by what is taken for granted, and noise of the acceleration: the speed errs as stated."""
    rng, n = np.random.default_rng(4), 40000
    impact_s = np.arange(0.02, n * BLOCK_S, 0.04)
    impulse = -rng.uniform(0.2, 0.4, len(impact_s))
    push = Push(np.zeros(n), impact_s, impulse, BLOCK_S)
    wrong = np.hypot(KICK_MPS, KICK_PART * impulse) * rng.standard_normal(len(impact_s))
    blind = PushedPlate(push, np.zeros(n), np.zeros(n, dtype=bool), noise_mps2)
    true = replace(blind, push=replace(push, impulse_mps=impulse + wrong)).moved(HZ, DAMPING, RATIO)
    answer = true.gained_mps / BLOCK_S + noise_mps2 * rng.standard_normal(n)
    seen = replace(blind, answer_mps2=answer, known=np.ones(n, dtype=bool))
    at_s = np.arange(2.0, 38.0, 0.0137)
    error = (seen.moved(HZ, DAMPING, RATIO).state(at_s) - true.state(at_s)) * [2.0 * np.pi * HZ, 1.0]
    assert np.std(error) == pytest.approx(seen.error(HZ, DAMPING, RATIO)[0], rel=0.15)


def test_a_modes_part_of_a_tone_is_right_though_the_contacts_push_changes_within_blocks() -> None:
    """Over one and two blocks of a contact, as in blocks a twentieth as long."""
    w = 2.0 * np.pi * 25.0
    takeoff_s = np.arange(0.05, 0.35, 0.04) + 0.0003
    landing_s = takeoff_s + 0.0335
    ends_s = BLOCK_S * np.floor(takeoff_s[1:] / BLOCK_S)
    spans_s = np.array([(b - k * BLOCK_S, b) for b in ends_s for k in (1, 2)])
    found = []
    for block_s in (BLOCK_S, BLOCK_S / 20.0):
        edges_s = np.arange(0.0, 0.4 + 0.5 * block_s, block_s)
        acceleration = np.diff(15.0 / w * np.sin(w * edges_s)) / block_s
        push = ball_push(acceleration, block_s, takeoff_s, landing_s, 9.80665)
        n = len(acceleration)
        motion = PushedPlate(push, np.zeros(n), np.zeros(n, dtype=np.bool_), 0.1).moved(2.0, DAMPING, 0.2)
        parts = BlockIntegrals.of(spans_s, block_s, np.array([0.0, w, 3.0 * w]), n).of_motion(motion)
        found.append(parts / parts[:, :1])
    np.testing.assert_allclose(found[0], found[1], atol=1e-3)


def test_where_the_drives_level_changes_a_mode_rings_on_by_itself() -> None:
    """In steady tones nothing is left but its own decay, to the end of the recording."""
    time_s = (np.arange(4001) + 0.5) * BLOCK_S
    level = 0.8 + 0.5 * np.tanh((time_s - 0.2) / 0.02) + 0.3 * np.tanh((time_s - 1.5) / 0.02)
    force = (level * np.exp(160.0j * time_s))[None]
    ringing = ringing_after_changes(force, np.array([80.0 / np.pi]), BLOCK_S, HZ, DAMPING)
    after = ringing[1650:]
    free = after[0] * np.exp(turn_of(HZ, DAMPING) * BLOCK_S * np.arange(len(after)))
    assert np.max(np.abs(after - free)) < 0.02 * abs(after[0])
    assert abs(after[0]) > 10.0 * np.max(np.abs(ringing[-200:]))


def test_what_does_not_ring_on_of_an_answer_is_steady_from_the_beginning_on() -> None:
    """A recording that begins under a force rang with what neither tones nor mode had: flights were .3 mm off."""
    time_s = (np.arange(4001) + 0.5) * BLOCK_S
    signal, turn = np.exp(160.0j * time_s + 1.0j)[None], turn_of(HZ, DAMPING)
    force, time_s = signal[0].real[:-1], time_s[:-1]
    z = ringing_after_changes(signal, np.array([80.0 / np.pi]), BLOCK_S, HZ, DAMPING)
    lagging = np.diff(z.real + turn.real / turn.imag * z.imag) / BLOCK_S
    steady = (answer(force, BLOCK_S, HZ, DAMPING) - lagging)[:3500]
    tone = np.column_stack([np.cos(160.0 * time_s), np.sin(160.0 * time_s)])[:3500]
    left = steady - tone @ np.linalg.lstsq(tone, steady)[0]
    assert np.std(left[100:500]) < 0.05 * np.std(lagging[100:500])  # the tone itself begins with a jump


def test_a_second_mode_beside_the_first_is_that_of_its_own_push() -> None:
    """States and speeds add, and each answers in its phase."""
    one, other = (HZ, DAMPING, RATIO), (9.0, 0.1, 0.05 + 0.02j)
    pushed, at = replace(_pushed(), phase=1.0 - 0.1j, others=(other,)), np.linspace(0.01, 0.39, 77)
    both, alone = pushed.moved(*one), replace(pushed, others=()).moved(*one)
    beside = replace(_pushed(), phase=other[2] / other[2].real).moved(other[0], other[1], other[2].real)
    np.testing.assert_allclose(both.state(at), alone.state(at) + beside.state(at), atol=1e-12)
    np.testing.assert_allclose(both.gained_mps, alone.gained_mps + beside.gained_mps, atol=1e-12)
