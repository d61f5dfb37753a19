"""Readings that stand at their end."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from analysis.flights.assemble import flights_of
from analysis.flights.plausibility import plausibility_warnings
from analysis.residuals.observations import observed
from analysis.signals.saturation import share_at_an_end
from daq.files.tables import Block
from daq.recording import RecordingWriter, open_recording

N = 4096


@pytest.mark.parametrize("noise", [0.0, 0.3, 3.0, 100.0])
@pytest.mark.parametrize("amplitude", [1, 3, 30, 1000, 20000])
def test_a_sine_that_turns_at_its_ends_does_not_stand_there(amplitude: float, noise: float) -> None:
    """Whole codes, with and without noise: only what is cut off stands at an end, for as long as it would be beyond."""
    rng = np.random.default_rng(7)
    codes = np.rint(amplitude * np.sin(2.0 * np.pi * 25.37 / 20000.0 * np.arange(N)) + noise * rng.standard_normal(N))
    assert share_at_an_end(codes) == 0.0
    if amplitude >= 30:
        limit = np.floor(0.9 * amplitude)
        assert share_at_an_end(np.minimum(codes, limit)) == np.mean(codes >= limit)
    assert share_at_an_end(np.zeros(N)) == 0.0


@pytest.mark.parametrize("dtype", [np.int16, np.float64])
def test_only_a_crowd_at_an_end_counts(dtype: type) -> None:
    """More than four times as many readings at an end as at the next value count, at either end, whatever the order."""
    values = np.repeat([-9, -4, 0, 5, 6], [50, 10, 20, 10, 41]).astype(dtype)
    rng = np.random.default_rng(2)
    assert share_at_an_end(rng.permutation(values)) == pytest.approx(91 / 131)
    assert share_at_an_end(rng.permutation(values[1:][values[1:] < 6])) == pytest.approx(49 / 89)
    assert share_at_an_end(np.repeat(np.array([1, 2], dtype), [40, 10])) == 0.0


def test_steps_of_a_saturated_accelerometer_are_told_and_left_out(make, tmp_path: Path) -> None:
    """A sensor that ends at 1.2 g, and both tones together reach twice gamma: steps beyond are named in a warning, and
    no closed loop uses them."""
    with open_recording(make([0.3, 0.5, 0.8, 0.9], hold=20).path) as source:
        codes = np.column_stack([source.codes(name) for name in source.channels])
        at = source.channels.index("accelerometer")
        one_g = 9.80665 * abs(source.setup.channels.accelerometer.volts_per_mps2) / source.scale("accelerometer")[0]
        rest = round(float(np.median(codes[:2000, at])))
        codes[:, at] = np.clip(codes[:, at], rest - round(1.2 * one_g), rest + round(1.2 * one_g))
        with RecordingWriter(
            tmp_path / "cut.h5", source.setup, profile_text="", channels=source.channels, backend="test", simulated=True
        ) as writer:
            writer.append(Block(0, codes, lost_before=0))
            for step in source.steps:
                writer.mark_step(step)
    with open_recording(tmp_path / "cut.h5") as recording:
        flights = flights_of(recording)
        (warning,) = (w for w in plausibility_warnings(recording, flights.plate, None) if "saturates" in w)
        seen = observed(recording, flights)
    assert "the accelerometer saturates in step 2, 3:" in warning
    assert warning in seen.notes
    assert seen.steps.number.tolist() == [0, 1]
