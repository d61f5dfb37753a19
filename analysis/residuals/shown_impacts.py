"""Which impacts the accelerometer shows, and how long one keeps the circuit closed."""

from __future__ import annotations

import numpy as np

from analysis.events.impact_detection import ECHO_MARGIN
from analysis.events.impact_template import THRESHOLD
from analysis.flights.assemble import Flights
from analysis.residuals.held import RINGING_S
from kernels.arrays import Bools, Floats
from model.integrator.problem import Measured, PlateSteps
from model.tones import STANDARD_GRAVITY_MPS2

FEW_CONTACTS = 8
WEAK_MPS = 0.03  # least speed of impacts that the accelerometer shows reliably
DETECTED = 1.5  # strength over the threshold of the scan above which an impact is detected whatever the noise


def weak_mps(measured: Measured, plate: PlateSteps, flights: Flights, keep: Bools) -> Floats:
    """Impact speed below which the accelerometer may have missed the impact that ends each flight, (n,).

    The strength at a speed is calibrated by free flights from rest; friction makes it too low by its own size at most.
    While an impact rings, impacts of less than a part of its size are masked.
    """
    rest, turns = ~measured.relaunched, 1j * plate.omega_radps[measured.step]
    velocity = plate.acceleration_mps2[measured.step] / turns
    at = [np.sum((velocity * np.exp(turns * t[:, None])).real, 1) for t in (measured.opening_s, measured.landing_s)]
    strength, duration_s = np.nan_to_num(flights.impact[keep]), measured.landing_s - measured.opening_s
    # a ball that leaves with the plate's velocity v(0) meets the plate at v(T) with v(T) - v(0) + g T
    impact = at[1] - at[0] + STANDARD_GRAVITY_MPS2 * duration_s
    shown = rest & (impact > WEAK_MPS) & (strength > 0.0)
    if shown.sum() < FEW_CONTACTS:
        return np.full(len(rest), WEAK_MPS)
    speed = float(np.median(impact[shown] / strength[shown]))
    before = np.concatenate([[0.0], strength[:-1]])
    rings = measured.relaunched & (duration_s < RINGING_S)
    usual = max(WEAK_MPS, DETECTED * THRESHOLD * speed)
    return np.where(rings, np.maximum(usual, DETECTED * ECHO_MARGIN * speed * before), usual)


def closure_s(measured: Measured, heard: Bools) -> float:
    """Middle of the contacts from which the ball left at once; 0 where there are few.

    A contact that only the accelerometer shows (``heard`` at the landing, (n,)) counts as no closed time.
    """
    brief = np.where(heard[:-1], 0.0, measured.opening_s[1:] - measured.landing_s[:-1])
    brief = brief[measured.relaunched[1:] & measured.linked[1:]]
    return float(np.median(brief)) if len(brief) >= FEW_CONTACTS else 0.0
