"""How long an impact keeps the circuit closed, from the contacts that the circuit shows."""

from __future__ import annotations

import numpy as np

from analysis.residuals.observations import FEW_CONTACTS, closure_s
from model.integrator.problem import Measured

N = 3 * FEW_CONTACTS


def bounces(contact_s: float) -> Measured:
    """Flights of 30 ms that leave ``contact_s`` after the landing before."""
    opening = np.arange(N) * (0.03 + contact_s)
    yes = np.ones(N, dtype=np.bool_)
    return Measured(opening, opening + 0.03, yes, yes, np.zeros(N, dtype=np.int64), yes)


def test_a_contact_of_bounces_is_as_long_as_the_circuit_shows_it() -> None:
    """Contacts of .2 ms with an edge at each end last .2 ms."""
    assert abs(closure_s(bounces(2e-4), np.zeros(N, dtype=np.bool_)) - 2e-4) < 1e-12


def test_a_contact_between_two_samples_keeps_the_circuit_closed_for_no_time() -> None:
    """The half of an undetectable contact after a landing that only the accelerometer shows is no closed time."""
    assert closure_s(bounces(3e-6), np.ones(N, dtype=np.bool_)) == 0.0
