"""Delays of a contact circuit whose edges are not equally late."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from analysis.events.sensor_offset import SensorOffset
from analysis.residuals.contact_delays import ContactDelays, contact_delays
from kernels.arrays import Floats
from model.integrator.problem import Measured, PlateSteps

G, OMEGA, SIGMA_S = 9.81, 2.0 * np.pi * 25.37, 1.5e-5
PEAKS = np.linspace(1.3, 4.0, 8)  # of each step's plate, g
PERIOD_S = 2.0 * np.pi / OMEGA
CYCLES = 15


def flown(pull_mps2: float, opens_s: Floats | float, closes_s: float) -> tuple[Measured, PlateSteps]:
    """Flights that begin as the plate falls away faster than gravity and a pull, and what the circuit shows of them.

    ``opens_s``: how late it opens, one number or (n,).
    """
    peak = PEAKS * G
    before = np.arccos((G + pull_mps2) / peak) / OMEGA  # the plate's acceleration is lowest at whole cycles
    start = np.tile(np.arange(1, CYCLES + 1), len(PEAKS)) * PERIOD_S - np.repeat(before, CYCLES)
    noise = SIGMA_S * np.random.default_rng(3).standard_normal((2, len(start)))
    step, yes = np.repeat(np.arange(len(PEAKS)), CYCLES), np.ones(len(start), dtype=bool)
    measured = Measured(start + opens_s + noise[0], start + 0.02 + closes_s + noise[1], ~yes, yes, step, yes)
    tones = -peak[:, None].astype(complex)
    return measured, PlateSteps(np.full(tones.shape, OMEGA), tones, np.full(len(PEAKS), PERIOD_S))


def found(
    pull_mps2: float, opens_s: Floats | float, closes_s: float, offset: SensorOffset | None = None, sharp: bool = True
) -> ContactDelays | None:
    """The delays of such flights; the accelerometer is as far from the closings as they are late, or by ``offset``."""
    measured, plate = flown(pull_mps2, opens_s, closes_s)
    sigma_s = np.full(len(measured.step), SIGMA_S)
    shown = offset or SensorOffset(-closes_s, 1e-6, 100)
    return contact_delays(measured, measured.linked, sigma_s, plate, G, shown, sharp)


@pytest.mark.parametrize("friction_g", [0.0, 0.15])
def test_a_circuit_that_opens_later_than_it_closes_is_measured_whatever_holds_the_ball(friction_g: float) -> None:
    """Openings 120 us late and closings 37 us late are measured to 10 us, with and without a friction."""
    delays = found(friction_g * G, 1.2e-4, 3.7e-5)
    assert delays is not None
    assert delays.opening_s == pytest.approx(1.2e-4, abs=1e-5)
    assert delays.closing_s == pytest.approx(3.7e-5)
    assert "closes 37 us late" in delays.in_words()


def test_a_circuit_whose_edges_are_equally_late_is_left_to_the_latency() -> None:
    """A delay of both edges alike is a cause of its own."""
    assert found(0.1 * G, 1.2e-4, 1.2e-4) is None


def test_a_circuit_that_opens_at_a_height_has_not_one_delay() -> None:
    """A contact that lasts over 1 um of height opens late by a time that goes with the plate's jerk."""
    jerk = OMEGA * G * np.sqrt(PEAKS**2 - 1.0)
    assert found(0.0, np.repeat(np.cbrt(6.0 * 1e-6 / jerk), CYCLES), 3.7e-5) is None


def test_an_accelerometer_that_is_late_itself_tells_no_delay() -> None:
    """Impacts that come after the closings are those of a filtered accelerometer."""
    assert found(0.0, 1.2e-4, 3.7e-5, SensorOffset(5e-5, 1e-6, 100)) is None


def test_impacts_that_are_rounded_to_samples_do_not_make_an_exact_circuit_late() -> None:
    """Marks that all come at the sample before the landing say nothing of the circuit, nor do others that are early."""
    assert found(0.0, 0.0, 0.0, SensorOffset(-2.2e-5, 1e-6, 100, rounding_s=1.44e-5)) is None
    assert found(0.0, 0.0, 0.0, SensorOffset(-2.2e-5, 1e-6, 100)) is None


@pytest.mark.parametrize("sharp", [True, False])
def test_where_landings_are_heard_only_edges_without_an_rc_alone_may_be_late(sharp: bool) -> None:
    """An RC that is seen is dated where it begins; one before a comparator is not seen."""
    delays = found(0.0, 1.2e-4, 0.0, SensorOffset(0.0, np.inf, 0), sharp)
    assert (delays is not None) == sharp
    assert delays is None or delays.closing_s == 0.0


def test_delays_taken_off_leave_no_opening_before_its_landing() -> None:
    """A contact shorter than the difference of the delays lasts no time."""
    measured, _ = flown(0.0, 0.0, 0.0)
    soon = replace(measured, opening_s=np.append(measured.opening_s[0], measured.landing_s[:-1] + 2e-5))
    out = ContactDelays(4e-5, 1.2e-4).taken_off(soon, np.zeros(len(measured.step), dtype=bool))
    assert out.landing_s == pytest.approx(soon.landing_s - 4e-5)
    assert np.all(out.opening_s[1:] >= out.landing_s[:-1])
