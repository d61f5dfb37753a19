"""Trial frequencies of one tone of a step."""

from __future__ import annotations

import numpy as np

from analysis.plate.line_trials import LineTrials
from analysis.plate.step_state import N_BLOCK_CLASSES, N_MASK_LEVELS, Span, StepState
from daq.lock_in import LockIn

RATE_HZ, WIDTH = 1000.0, 20
TONES_HZ = np.array([25.37, 50.74, 50.0])


def _state() -> StepState:
    """Two spans of a step with a line at 50.05 Hz, a third of the blocks masked."""
    rng = np.random.default_rng(3)
    state = StepState(0, 25.37, (1,), 0, 0, 3.0, mask_level=2, multiples=(1, 2))
    state.lock_in = LockIn(RATE_HZ, TONES_HZ, 2, WIDTH, sorts=N_BLOCK_CLASSES)
    for first in (100, 2000):
        t = (first + np.arange(1500)) / RATE_HZ
        motion = 2.0 * np.cos(2 * np.pi * 25.37 * t) + 0.3 * np.cos(2 * np.pi * 50.05 * t + 1.0)
        values = np.column_stack([motion + rng.normal(0, 0.01, len(t)), motion])
        kinds = rng.integers(0, N_BLOCK_CLASSES, len(t)).astype(np.int8)
        state.spans.append(Span(first, values, kinds))
        state.lock_in.add(values, first, kinds)
    return state


def test_a_trial_is_the_fit_of_all_blocks_at_that_frequency() -> None:
    """A fit with one tone moved equals that of a lock-in accumulated at those frequencies, before and after a move."""
    state = _state()
    trials = LineTrials(state, RATE_HZ)
    for hz in (50.03, 50.06):
        whole = LockIn(RATE_HZ, [*TONES_HZ[:2], hz], 1, WIDTH)
        for span in state.spans:
            whole.add(span.values[:, :1], span.first, span.block_class % N_MASK_LEVELS >= 2)
        wanted, found = whole.solve(), trials.fit_at(2, hz)
        np.testing.assert_allclose(found.amplitudes, wanted.amplitudes, rtol=1e-10)
        np.testing.assert_allclose(found.covariance, wanted.covariance, rtol=1e-8, atol=1e-16)
        assert found.n == wanted.n
        trials.move(2, hz)


def test_the_residual_is_what_all_other_tones_leave() -> None:
    """What is left holds only the chosen tone and the noise."""
    trials = LineTrials(_state(), RATE_HZ)
    fit = trials.fit_at(2, 50.05)
    line = 0.3 * np.cos(2 * np.pi * 50.05 * trials.blocks / RATE_HZ + 1.0)
    trials.move(2, 50.05)
    assert np.std(trials.residual(fit, 2) - line) < 0.02
