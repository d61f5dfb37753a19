"""The plate's scale under a table's resonance: the drive is known for the plate that it was set with."""

from __future__ import annotations

import numpy as np
import pytest

from model.effects.table_resonance import transfer

MASS_KG, BALL_KG = 20.0, 0.25
OMEGA_RADPS = 2.0 * np.pi * np.array([5.0, 25.0, 75.0])


@pytest.mark.parametrize(("own_hz", "damping"), [(8.0, 0.7), (25.0, 0.02), (120.0, 0.0)])
def test_what_a_scale_set_under_the_ball_does_to_the_bare_plate(own_hz: float, damping: float) -> None:
    """Newton's law for table, spring and dashpot: a force that moves both as asked moves the bare table otherwise."""
    s, own = 1j * OMEGA_RADPS, 2.0 * np.pi * own_hz
    held = MASS_KG * own**2 + 2.0 * damping * own * MASS_KG * s
    moved = (held + (MASS_KG + BALL_KG) * s**2) / (held + MASS_KG * s**2)
    mode = {"mass_ratio": BALL_KG / MASS_KG, "frequency_hz": own_hz, "damping": damping}
    np.testing.assert_allclose(transfer({**mode, "loaded": 1.0}, OMEGA_RADPS, None), moved, rtol=1e-5)
    np.testing.assert_array_equal(transfer({**mode, "loaded": 0.0}, OMEGA_RADPS, None), 1.0)


def test_an_undamped_mode_at_the_forcing_has_a_number() -> None:
    """At its own frequency a mode without damping has no steady answer: what is returned is large, and finite."""
    mode = {"mass_ratio": 0.01, "frequency_hz": 25.0, "damping": 0.0, "loaded": 1.0}
    assert np.all(np.isfinite(transfer(mode, OMEGA_RADPS[1:2], None)))
