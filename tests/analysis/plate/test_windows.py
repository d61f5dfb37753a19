"""The frequency of a step from the phase of its strongest tone, window by window."""

from types import SimpleNamespace

import numpy as np
import pytest

from analysis.plate.windows import MIN_DRIFT_RAD, refined_hz

NOMINAL_HZ, HOLD_S, PHASE_SIGMA_RAD = 25.0, 1.0, 1e-6


@pytest.mark.parametrize(
    ("away_hz", "changed"),
    [(0.3 * MIN_DRIFT_RAD / (2.0 * np.pi * HOLD_S), False), (30.0 * MIN_DRIFT_RAD / (2.0 * np.pi * HOLD_S), True)],
)
def test_a_frequency_that_is_left_alone_is_known_no_better_than_it_was_found_wrong(
    away_hz: float, changed: bool
) -> None:
    """Wrong by too little to fit anew, the table's frequency keeps that error as its uncertainty; else it is mended."""
    time_s = np.linspace(0.05, 0.95, 10)
    turned = np.exp(2j * np.pi * away_hz * time_s)[:, None, None] * np.ones((1, 1, 2))
    chunk = SimpleNamespace(
        time_s=time_s,
        amplitudes=turned,
        spread=np.ones((10, 1)),
        fits=(SimpleNamespace(rms=PHASE_SIGMA_RAD), SimpleNamespace(rms=PHASE_SIGMA_RAD)),
    )
    state = SimpleNamespace(multiples=(1,), rows=[0], nominal_hz=NOMINAL_HZ, hold_s=HOLD_S)
    found = refined_hz(state, chunk, has_drive=True)  # type: ignore[arg-type]
    assert found is not None
    frequency_hz, uncertainty_hz, differs = found
    assert differs is changed
    assert abs(frequency_hz - NOMINAL_HZ - away_hz) <= 1.01 * uncertainty_hz
