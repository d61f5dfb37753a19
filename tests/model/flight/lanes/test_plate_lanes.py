"""The plate's motion in lanes."""

from __future__ import annotations

import mpmath as mp
import numpy as np

from kernels.lanes import WIDTH, load, store
from model.flight.lanes.plate_lanes import NEAR, plate, turned
from model.flight.numerics import compiled, sincos

TONES = np.array([[1.0, 0.7, 0.0], [2.0, 1.0, 0.4], [7.0, 0.5, -2.0], [100.0, 0.01, 3.0]])


@compiled
def _in_lanes(tones, phases, out):
    values = plate(tones, load(phases, 0))
    store(out, 0, values[0])
    store(out, WIDTH, values[1])
    store(out, 2 * WIDTH, values[2])
    store(out, 3 * WIDTH, values[3])
    store(out, 4 * WIDTH, values[4])


@compiled
def _turned(phases, turns, out):
    sine, cosine = turned(sincos(load(phases, 0)), load(turns, 0))
    store(out, 0, sine)
    store(out, WIDTH, cosine)


def test_sine_and_cosine_turned_by_a_little_are_exact_to_rounding():
    """Turned by at most `NEAR` they agree with 40 digits to ``4e-16``."""
    random, out = np.random.default_rng(2), np.empty(2 * WIDTH)
    for _ in range(50):
        phases, turns = random.uniform(-7.0, 13.0, WIDTH), random.uniform(-NEAR, NEAR, WIDTH)
        _turned(phases, turns, out)
        with mp.workdps(40):
            for lane in range(WIDTH):
                phi = mp.mpf(float(phases[lane])) + mp.mpf(float(turns[lane]))
                assert abs(float(out[lane] - mp.sin(phi))) < 4e-16
                assert abs(float(out[WIDTH + lane] - mp.cos(phi))) < 4e-16


def test_the_plate_in_lanes_is_that_of_the_tones():
    """s and its derivatives agree with 40 digits to ``4e-16 n`` of each tone, whatever its phase, for two turns."""
    phases, out = np.random.default_rng(1).uniform(-1.0, 13.0, WIDTH), np.empty(5 * WIDTH)
    _in_lanes(TONES, phases, out)
    tones = [tuple(map(mp.mpf, map(float, tone))) for tone in TONES]
    with mp.workdps(40):
        for lane, phi in enumerate(phases):
            turns = [mp.mpf(float(phi)) * n + p for n, _, p in tones]
            sines = [(n, b, mp.sin(x), mp.cos(x)) for (n, b, _), x in zip(tones, turns, strict=True)]
            wanted = (
                sum(b * s for _, b, s, _ in sines),
                sum(b * n * c for n, b, _, c in sines),
                sum(b * n**2 * s for n, b, s, _ in sines),
                sum(b * n**3 * c for n, b, _, c in sines),
                sum(b * n**4 * s for n, b, s, _ in sines),
            )
            for k, value in enumerate(wanted):
                bound = 4e-16 * sum(float(b * n ** (k + 1)) for n, b, _ in tones)
                assert abs(float(value - mp.mpf(float(out[k * WIDTH + lane])))) < bound
