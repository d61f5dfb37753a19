"""Amplitudes within windows, beats of mains lines, and the frequency of a step from the phase of its strongest tone."""

from types import SimpleNamespace

import numpy as np
import pytest

from analysis.plate.line_trials import LineTrials
from analysis.plate.step_state import N_BLOCK_CLASSES, N_MASK_LEVELS, Span, StepState
from analysis.plate.windows import MIN_DRIFT_RAD, fit_windows, refined_hz
from daq.lock_in import LockIn

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


RATE_HZ, WIDTH, TONES_HZ, LEVEL = 1000.0, 20, (25.0, 50.0, 50.9), 2


def _state(firsts: tuple[int, ...], blocks: int) -> StepState:
    """A step in noise, its second harmonic near a mains line, one block in three masked."""
    rng = np.random.default_rng(11)
    state = StepState(
        0, TONES_HZ[0], (1,), 0, 0, blocks / RATE_HZ, frequency_hz=TONES_HZ[0], multiples=(1, 2), mask_level=LEVEL
    )
    state.lock_in = LockIn(RATE_HZ, TONES_HZ, 2, WIDTH, sorts=N_BLOCK_CLASSES)
    for first in firsts:
        t = (first + np.arange(blocks)) / RATE_HZ
        motion = 2.0 * np.cos(2 * np.pi * TONES_HZ[0] * t) + 0.3 * np.cos(2 * np.pi * 50.93 * t + 1.0)
        values = np.column_stack([motion + rng.normal(0, 0.01, len(t)), motion + rng.normal(0, 0.02, len(t))])
        kinds = rng.integers(0, N_BLOCK_CLASSES, len(t)).astype(np.int8)
        state.spans.append(Span(first, values, kinds))
        state.lock_in.add(values, first, kinds)
    return state


def test_windows_hold_the_least_squares_amplitudes_of_their_clear_blocks() -> None:
    """In each window the amplitudes are those of a plain fit to the step's residual there, on both channels."""
    state = _state((100, 2000), 1503)
    chunk, level = fit_windows(state, RATE_HZ), state.mask_level
    assert chunk is not None
    length, found = round(2.0 * RATE_HZ / TONES_HZ[0]), 0
    assert state.lock_in is not None
    response = state.lock_in.response()
    for span in state.spans:
        n = span.first + np.arange(len(span.values))
        turns = response * np.exp(2j * np.pi * n[:, None] * np.array(TONES_HZ) / RATE_HZ)
        clear = span.block_class % N_MASK_LEVELS >= level
        for w in range(len(n) // length):
            own = np.flatnonzero(clear[w * length : (w + 1) * length]) + w * length
            columns = np.column_stack([np.ones(own.size), turns[own, 0].real, -turns[own, 0].imag])
            for c, fit in enumerate(chunk.fits):
                left = span.values[own, c] - fit.offset - (turns[own] @ fit.amplitudes).real
                x = np.linalg.lstsq(columns, left, rcond=None)[0]
                wanted = fit.amplitudes[0] + x[1] + 1j * x[2]
                assert chunk.amplitudes[found, 0, c] == pytest.approx(wanted, rel=1e-9)
            spread = np.linalg.inv(columns.T @ columns).diagonal()[1:]
            assert chunk.spread[found, 0] == pytest.approx(np.sqrt(spread.mean()), rel=1e-7)
            found += 1
    assert found == chunk.time_s.size


def test_beats_are_the_residual_demodulated_at_the_line() -> None:
    """Over all bins they add up to what is summed from the blocks themselves, in each span of the step."""
    state = _state((100, 2000), 1503)
    chunk = fit_windows(state, RATE_HZ)
    assert chunk is not None
    direct = LineTrials(state, RATE_HZ).demodulated(chunk.fits[0], 2)
    assert chunk.beats.shape == (-(-(2000 + 1503 - 100) // 200), 1)
    assert chunk.beats.sum() == pytest.approx(direct.sum(), rel=1e-9)
    assert np.abs(chunk.beats[:, 0] - direct[: len(chunk.beats)]).max() < 0.05 * np.abs(direct).max()
