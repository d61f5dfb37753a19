"""The rig built from its parts is itself right: published flight times, Newton's law for what rides on the table."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.plants import shaker
from benchmarks.plants.command import G
from benchmarks.plants.shaker import BALL_KG, Shaker


def marched(rig: Shaker) -> tuple[np.ndarray, np.ndarray]:
    """The plate's mean acceleration (m/s^2) and the part in contact, in the time before each sample, (n,) each."""
    gammas, w, step_s = np.array(rig.gammas), 2.0 * math.pi * rig.frequency_hz, rig.cycles / rig.frequency_hz
    n = int(len(gammas) * step_s * rig.rate_hz)
    plate, touching = np.zeros(n), np.ones(n)
    dt = 1.0 / (rig.rate_hz * shaker.STEPS_PER_SAMPLE)
    shaker._march(
        rig.parts(), shaker.COIL, rig.voltage_driven, rig.drive(), gammas, step_s, w, float(rig.c), dt, plate, touching
    )
    return plate, touching


@pytest.mark.parametrize(("gamma_peak", "tau"), [(1.5, 3.566217), (3.0, 5.967608)])
def test_flights_over_a_heavy_table_have_the_published_lengths(gamma_peak: float, tau: float) -> None:
    """One sine, a table of 100 t: a ball that a stiff contact stops at once flies as the ideal one does."""
    rig = Shaker(gammas=(gamma_peak / 2.0,), cycles=16)
    _, touching = marched(rig)
    away = 1.0 - touching[len(touching) // 2 :]
    begins = np.flatnonzero((away[1:] > 0.0) & (away[:-1] == 0.0)) + 1
    whole_s = np.add.reduceat(away, begins)[:-1] / rig.rate_hz
    assert 2.0 * math.pi * rig.frequency_hz * whole_s == pytest.approx(tau, abs=0.01)


@pytest.mark.parametrize("voltage_driven", [False, True])
def test_a_ball_at_rest_moves_the_table_by_its_mass(*, voltage_driven: bool) -> None:
    """Below take-off a drive set with the ball moves it as asked; one set without it moves it less, by Newton's law."""
    held = Shaker(table_kg=5.0, voltage_driven=voltage_driven, gammas=(0.3,), cycles=24)
    s = 2j * math.pi * held.frequency_hz
    mass, spring, dashpot, *_ = held.parts()
    per_newton = 1.0 / (mass * s * s + dashpot * s + spring), 1.0 / ((mass + BALL_KG) * s * s + dashpot * s + spring)
    if voltage_driven:  # the coil's own resistance and inductance, and what its motion induces
        force, ohm, henry = shaker.COIL
        per_newton = tuple(y * force / (ohm + henry * s + force * force * s * y) for y in per_newton)
    sizes = []
    for rig in (held, replace(held, level_set_bare=True)):
        plate, touching = marched(rig)
        assert np.all(touching[1:] == 1.0)
        last = plate[-round(8 * rig.rate_hz / rig.frequency_hz) :]
        turn = np.exp(-s * np.arange(len(last)) / rig.rate_hz)
        sizes.append(2.0 * abs(np.mean(last * turn)))
    assert sizes[0] == pytest.approx(2.0 * 0.3 * G, rel=2e-3)
    assert sizes[1] / sizes[0] == pytest.approx(abs(per_newton[1] / per_newton[0]), rel=2e-3)
