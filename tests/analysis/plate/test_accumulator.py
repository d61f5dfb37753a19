"""Tone fits over lost samples, and block means on the grid that counts them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from analysis.flights.scan import plate_of
from analysis.plate.accumulator import PlatePiece, StepAccumulator, _classify, block_width
from analysis.plate.step_state import CONTACT, FLIGHT, N_MASK_LEVELS, NEITHER, Span, StepState
from daq.files.tables import Block
from daq.instrument.channel_limits import NO_ENDS
from daq.recording import open_recording
from daq.recording.writer import RecordingWriter

RATE_HZ, FREQUENCY_HZ = 20000.0, 25.37


def test_blocks_begin_on_a_grid_that_counts_lost_samples() -> None:
    """A piece whose first sample is number 7 of the run has its first block of four at sample 8."""
    piece = PlatePiece(4, np.arange(12, dtype=np.float32), None, None)
    acceleration, drive, fraction, cut_off = piece.means(4, 3, NO_ENDS)
    np.testing.assert_array_equal(acceleration, [2.5, 6.5])
    assert drive is None and fraction is None and cut_off is None


def test_blocks_with_a_code_at_the_sensors_end_are_marked_with_their_neighbours() -> None:
    """Of six blocks of four the third holds one code at the upper end: it and the ones next to it are marked."""
    codes = np.zeros(24, dtype=np.int16)
    codes[9] = 100
    piece = PlatePiece(0, codes.astype(np.float32), None, None, codes)
    *_, cut_off = piece.means(4, 0, (-np.inf, 90.0))
    np.testing.assert_array_equal(cut_off, [False, True, True, True, False, False])


@pytest.mark.parametrize("lost", [(7, 13), (7, 14), (20, 20)])
def test_a_tone_keeps_its_phase_over_two_gaps(make, tmp_path: Path, lost: tuple[int, int]) -> None:
    """Two gaps within a piece, their sum a whole number of blocks or not: the fit is as good as without gaps."""
    with open_recording(make([0.4], hold=40).path) as source:
        codes = np.column_stack([source.codes(name) for name in source.channels])
        assert block_width(RATE_HZ, source.steps, source.setup.forcing) == 20
        cuts = np.array([0, 12000, 20000, len(codes)])
        path = tmp_path / "gaps.h5"
        with RecordingWriter(
            path, source.setup, profile_text="", channels=source.channels, backend="test", simulated=True
        ) as writer:
            for k, missing in enumerate((0, *lost)):
                own = codes[cuts[k] + missing : cuts[k + 1]]
                writer.append(Block(int(cuts[k] - sum(lost[: max(k - 1, 0)])), own, lost_before=missing))
            for step in source.steps:
                writer.mark_step(step)
        (whole,) = plate_of(source).steps
    with open_recording(path) as torn:
        (step,) = plate_of(torn).steps
    assert whole is not None and step is not None
    assert step.acceleration.rms == pytest.approx(whole.acceleration.rms, rel=0.05)
    assert abs(step.tone(1)[0] - whole.tone(1)[0]) < 5.0 * whole.acceleration.amplitude_sigma()[0]


def test_a_step_that_was_stopped_while_it_settled_has_no_motion(make, tmp_path: Path) -> None:
    """Nothing of it is fitted, and nothing asked of its drive; the step after it is as it was."""
    path = tmp_path / "stopped.h5"
    with open_recording(make([0.4, 0.6], hold=40).path) as source:
        with RecordingWriter(
            path, source.setup, profile_text="", channels=source.channels, backend="test", simulated=True
        ) as writer:
            writer.append(Block(0, np.column_stack([source.codes(name) for name in source.channels])))
            for step in source.steps:
                step = step.copy()
                step["settle_samples"] = step["n_samples"] if step["gamma"] < 0.5 else step["settle_samples"]
                writer.mark_step(step)
        second = plate_of(source).steps[1]
    with open_recording(path) as stopped:
        found = plate_of(stopped).steps
    assert second is not None and found[0] is None and found[1] is not None
    assert found[1].gamma == second.gamma


def test_blocks_know_the_place_and_the_time_since_the_last_impact() -> None:
    """Each block's class is its place by the contact voltage, and how many masks it is clear of, written out."""
    rng = np.random.default_rng(4)
    first, masks = 1000, np.array([2, 3, 5, 7, 10])
    impacts = np.sort(rng.integers(990, 1400, 25))
    begins, fraction = impacts - 1, rng.choice([0.0, 0.05, 0.5, 0.95, 1.0], 420).astype(np.float32)
    found = np.empty(420, np.int8)
    _classify(first, fraction, begins, impacts, masks, found)
    for i, part in enumerate(fraction.tolist()):
        before = impacts[begins <= first + i]
        level = int(np.sum(masks < first + i - before[-1])) if before.size else N_MASK_LEVELS - 1
        place = FLIGHT if part > 0.9 else CONTACT if part < 0.1 else NEITHER
        assert found[i] == place * N_MASK_LEVELS + level


@pytest.mark.parametrize(("open_part", "fitted"), [(0.9, (1, 2, 3, 4, 5, 6)), (0.5, (1, 2))])
def test_where_impacts_hide_half_of_every_cycle_harmonics_give_way(open_part: float, fitted: tuple[int, ...]) -> None:
    """A mask at the same phases of all cycles: the forcing's two tones are right to a percent with what is left."""
    n = np.arange(600)
    angle = 2.0 * np.pi * FREQUENCY_HZ * n / 1000.0
    values = np.cos(angle) + 0.8 * np.cos(2.0 * angle + 1.0) + 1e-3 * np.random.default_rng(2).standard_normal(600)
    level = np.where(angle / (2.0 * np.pi) % 1.0 < open_part, N_MASK_LEVELS - 1, 0)
    state = StepState(0, FREQUENCY_HZ, (1, 2), 0, 12000, 0.6, frequency_hz=FREQUENCY_HZ)
    state.spans.append(Span(0, np.column_stack([values, values]), (FLIGHT * N_MASK_LEVELS + level).astype(np.int8)))
    accumulator = object.__new__(StepAccumulator)
    accumulator.block_rate_hz, accumulator.width = 1000.0, 1
    accumulator._accumulate(state)
    assert state.multiples == fitted and state.lock_in is not None
    found = state.lock_in.part(state.clear_classes()).solve(0).amplitudes
    np.testing.assert_allclose(np.abs(found[:2]), [1.0, 0.8], rtol=0.01)


def test_where_motion_is_cut_off_what_impacts_left_in_is_masked_all_the_same() -> None:
    """A sensor's end makes every mask costly: with the shortest one ringing stayed in, and gamma was .35 % off."""
    n = np.arange(600)
    angle = 2.0 * np.pi * FREQUENCY_HZ * n / 1000.0
    values = 10.0 * np.cos(angle) + 20.0 * np.cos(2.0 * angle) + 0.02 * np.random.default_rng(2).standard_normal(600)
    cycle, place = np.divmod(angle / (2.0 * np.pi), 1.0)
    since = place - 0.62  # of an impact, in cycles of 39 blocks
    values += np.where(since >= 0.0, (-1.0) ** (cycle % 3 > 0) * np.exp(-since / 0.03), 0.0)
    level = np.where(since >= 0.0, np.minimum(since / 0.025, N_MASK_LEVELS - 1), N_MASK_LEVELS - 1).astype(int)
    level[np.abs(values) > 12.0] = 0
    state = StepState(0, FREQUENCY_HZ, (1, 2), 0, 12000, 0.6, frequency_hz=FREQUENCY_HZ)
    state.spans.append(Span(0, np.column_stack([values, values]), (FLIGHT * N_MASK_LEVELS + level).astype(np.int8)))
    accumulator = object.__new__(StepAccumulator)
    accumulator.block_rate_hz, accumulator.width = 1000.0, 1
    accumulator._accumulate(state)
    assert state.lock_in is not None
    found = state.lock_in.part(state.clear_classes()).solve(0).amplitudes
    np.testing.assert_allclose(np.abs(found[:2]), [10.0, 20.0], rtol=0.002)
