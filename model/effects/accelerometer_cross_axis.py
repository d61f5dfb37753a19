"""The accelerometer also feels a sideways mode of the table, which the vertical motion drives.

Below the mode's resonance what it adds is early by a quarter of a period, and grows with the square of the frequency:
one tone alone does not tell it from the lead of a coupling.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from kernels.arrays import Complexes, Floats
from model.effects.base import ORDINARY_LAG, Effect, Parameter

EFFECT = Effect(
    name="accelerometer_cross_axis",
    summary="the accelerometer feels a sideways mode of the table",
    parameters=(
        Parameter(
            "lead_s", "s", -1e-3, 1e-3, 1e-5, start_grid=(-3e-5, 3e-5),
            meaning="lead of slow motion; negative where the mode is felt upside down",
        ),
        Parameter(
            "frequency_hz", "Hz", 20.0, 500.0, 20.0, null_value=90.0, start_grid=(70.0, 150.0), is_shape=True,
            meaning="of the sideways mode",
        ),
    ),
    confused_with=dict.fromkeys(("accelerometer_high_pass", "contact_latency"), "runs at several frequencies"),
    hides=ORDINARY_LAG,
    last_resort=True,  # a mode between two tones leads one and lags the other as a coupling and a filter do
    reference="transverse sensitivity of accelerometers (some per cent), rocking modes of tables",
)  # fmt: skip


def accelerometer_response(p: Mapping[str, float], omega_radps: Floats) -> Complexes:
    """Reading over truth; the mode's damping is 5 % of critical."""
    part = omega_radps / (2.0 * np.pi * p["frequency_hz"])
    return np.asarray(1.0 + 1j * omega_radps * p["lead_s"] / (1.0 - part**2 + 0.1j * part))
