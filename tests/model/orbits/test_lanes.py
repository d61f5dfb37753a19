"""Orbits flown side by side: every flight is the one that the kernel of one flight gives from the same take-off."""

from __future__ import annotations

import math

import numpy as np
import pytest

from kernels.lanes import WIDTH
from model.flight import windows
from model.flight.friction import MOST_SEGMENTS, edge_tables, land_with_friction, rebound_or_rest
from model.flight.lanes.edge_table import FOUND, TABLE, fill_tables
from model.flight.numerics import FrictionRestitution
from model.orbits import friction_lanes, ideal_lanes
from model.orbits import lane_state as at
from model.tones import Forcing

FLIGHTS = 60


def _begun(kernel, forcing: Forcing, gammas: np.ndarray, law: FrictionRestitution):
    """An orbit begun in each lane that is lifted."""
    tones, turning = forcing.tones, windows.turning_points(forcing)
    size = turning.size + 2
    lanes, found = at.room_for_lanes(size, FLIGHTS), np.zeros(FOUND * size * WIDTH)
    both = lanes.both
    n_up, n_down = np.zeros((2, WIDTH), dtype=np.int64)
    fill_tables(tones, turning, gammas / (1 + law.mu_up), both[: both.size // 2], n_up, found)
    fill_tables(tones, turning, gammas / (1 - law.mu_down), both[both.size // 2 :], n_down, found)
    work, whole = lanes.work, lanes.whole
    rows = np.arange(WIDTH)
    work[at.GAMMA], work[at.MU_UP], work[at.MU_DOWN] = gammas, law.mu_up, law.mu_down
    work[at.E0], work[at.E1] = law.e0, law.e1
    work[at.UP], work[at.UP_LAST] = rows * TABLE * size, 2 * n_up
    work[at.DOWN], work[at.DOWN_LAST] = (WIDTH + rows) * TABLE * size, 2 * n_down
    work[at.LAST_PHI] = both[rows * TABLE * size]
    whole[at.LIMIT] = FLIGHTS
    for lane in np.flatnonzero(n_up):
        at.keep_branches(both, work, lane)
        kernel.leave(tones, lanes, False, lane)
    return lanes


def _flown(kernel, forcing: Forcing, gammas: np.ndarray, law: FrictionRestitution):
    """`FLIGHTS` flights of an orbit in each lane: ``flights`` and ``marks``, and which lanes are lifted."""
    lanes = _begun(kernel, forcing, gammas, law)
    while np.any(lanes.whole[at.STATUS] == at.FLIES):
        kernel.advance(forcing.tones, float(forcing.tones[:, 1].sum()), lanes, False)
    return lanes.flights, lanes.marks, lanes.work[at.UP_LAST] > 0.0


FORCINGS = (*(Forcing.superposition(c) for c in (1, 2, 3)), Forcing((1.0, 2.0, 5.0), (0.8, 0.5, 0.1), (0.3, -1.0, 2.0)))


@pytest.mark.parametrize("forcing", FORCINGS, ids=["c = 1", "c = 2", "c = 3", "three tones with phases"])
@pytest.mark.parametrize(
    ("mu", "e"), [(0.0, 0.0), (0.3, 0.0), (0.3, 0.3), (0.2, 0.514), (0.0, 0.8), (0.9, 0.0), (0.7, 0.6)]
)
def test_every_flight_in_lanes_is_the_one_of_the_kernel_of_one_flight(forcing, mu, e):
    """Time, impact speed and the next take-off agree with one flight at a time, wherever the impact is not a graze."""
    law = FrictionRestitution(mu, mu, e, 0.0)
    kernel = ideal_lanes if mu == e == 0.0 else friction_lanes
    for low, high in ((0.2, 1.5), (1.5, 6.0)):
        assert _checked(kernel, forcing, np.linspace(low, high, WIDTH), law) > 0


def test_a_flight_of_too_many_segments_ends_as_one_that_stays_on_the_rod():
    """Where a flight's last segment but two is under way, its lane is given up; one that lands before is flown on."""
    forcing = Forcing.superposition(3)
    lanes = _begun(friction_lanes, forcing, np.linspace(0.5, 6.0, WIDTH), FrictionRestitution(0.3, 0.3, 0.0, 0.0))
    lanes.work[at.SEGMENTS, ::2] = MOST_SEGMENTS - 2
    friction_lanes.advance(forcing.tones, 2.0, lanes, False)
    stuck = lanes.whole[at.STATUS] == at.STUCK
    assert stuck.any()
    assert not stuck[1::2].any()
    assert np.all(lanes.work[at.MOTION, stuck] == at.RESTS)
    assert np.all(stuck[::2] | (lanes.flights[at.TAUS, ::2, 0] > 0.0))


@pytest.mark.slow
def test_flights_in_lanes_of_any_law_and_plate_are_those_of_the_kernel_of_one_flight():
    """10^5 flights, with friction, restitution, tones, their phases and gammas drawn at random, agree as closely."""
    random, flown = np.random.default_rng(4), 0
    while flown < 100_000:
        k = random.integers(1, 5)
        harmonic = tuple(float(n) for n in random.choice(np.arange(1, 9), k, replace=False))
        forcing = Forcing(harmonic, tuple(random.uniform(0.1, 1.0, k)), tuple(random.uniform(-3.0, 3.0, k)))
        up, down, e0 = random.uniform(0.0, 0.95, 3)
        law = FrictionRestitution(up, down, e0, random.choice([0.0, 0.1]))
        least = 1.0 / sum(n * n * b for n, b in zip(forcing.harmonic, forcing.amplitude, strict=True))
        flown += _checked(friction_lanes, forcing, least * np.geomspace(1.0, 30.0, WIDTH), law)


def _checked(kernel, forcing: Forcing, gammas: np.ndarray, law: FrictionRestitution) -> int:
    """Flights of which each was compared with the kernel of one flight."""
    compared = 0
    flights, marks, lifted = _flown(kernel, forcing, gammas, law)
    for lane in np.flatnonzero(lifted):
        tables = edge_tables(forcing.tones, windows.turning_points(forcing), gammas[lane], law)
        v = 0.0
        for k in range(FLIGHTS):
            phi0, reset = flights[at.PHASES, lane, k], marks[at.THRESHOLDS, lane, k] >= 0
            tau, phi, speed, flag = land_with_friction(forcing.tones, gammas[lane], tables, law, phi0, v, bool(reset))
            if flag or speed < 1e-4:
                v = rebound_or_rest(forcing.tones, gammas[lane], law, phi, flights[at.SPEEDS, lane, k])[0]
                continue
            compared += 1
            assert flights[at.TAUS, lane, k] == pytest.approx(tau, abs=1e-11 / min(speed, 1.0))
            assert flights[at.SPEEDS, lane, k] == pytest.approx(speed, abs=1e-10 / min(speed, 1.0))
            landing = phi0 + flights[at.TAUS, lane, k]
            v = rebound_or_rest(forcing.tones, gammas[lane], law, landing, flights[at.SPEEDS, lane, k])[0]
            if k + 1 < FLIGHTS and v > 0.0:
                off = flights[at.PHASES, lane, k + 1] - phi0 - flights[at.TAUS, lane, k]
                assert abs(math.remainder(off, 2 * math.pi)) < 1e-11
    return compared
