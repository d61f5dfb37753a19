"""The continuity channel lags the others, both edges alike.

The events happened earlier than they were seen. Where the circuit seems early, the accelerometer is late:
`accelerometer_lag`.
"""

from __future__ import annotations

from model.effects.base import ORDINARY_LAG, Effect, Parameter

EFFECT = Effect(
    name="contact_latency",
    summary="the contact circuit reports both edges late",
    parameters=(
        Parameter(
            "delay_s", "s", -1e-5, 5e-3, 1e-5, calibration=2e-6, start_grid=(1e-4, 1e-3), hook="contact_delay_s",
            meaning="event to edge",
        ),
    ),
    confused_with={"phase_lag": "drive -> plate", "contact_gap": "landing times"},
    hides=ORDINARY_LAG,
    reference="filter of the contact circuit, multiplexed sampling",
)  # fmt: skip
