"""Lost samples: counted to the sample on the loop-back, placed, never invented."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from daq.block import Block, BlockFlag
from daq.clock import LossFinder
from daq.recording import CHANNELS, RecordingWriter, open_recording, verify
from daq.setup import Setup

RATE_HZ = 20_000.0


def losses() -> ModuleType:
    """The benchmark of 100 lossy and 100 clean runs."""
    path = Path(__file__).parents[2] / "benchmarks" / "losses.py"
    spec = importlib.util.spec_from_file_location("losses", path)
    if spec is None or spec.loader is None:
        raise ImportError(path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("ratio", [1, 2])
@pytest.mark.parametrize("lost", [1, 17, 800, 5000])
def test_losses_are_counted_and_placed(lost: int, ratio: int) -> None:
    """One loss, from one sample to a quarter of a second: one gap, the right count, at its place."""
    (at, _, _), *declared = losses().run(np.random.default_rng(lost + ratio), lost, ratio, seconds=4.0)
    assert [n for _, n, _ in declared] == [lost]
    assert abs(declared[0][0] - at) < 400


def test_clean_runs_stay_clean() -> None:
    """Steps, fades, latency, noise and a late clock are not losses."""
    for ratio in (1, 2, 3):
        assert losses().run(np.random.default_rng(ratio), 0, ratio, seconds=4.0)[1:] == []


def feed(finder: LossFinder, played: np.ndarray, heard: np.ndarray, kept: np.ndarray | None = None) -> list[Block]:
    """Blocks of 512 through a finder, without clocks; of the samples heard, those numbered ``kept`` arrive."""
    blocks: list[Block] = []
    kept = np.arange(len(heard)) if kept is None else kept
    for i in range(0, len(played), 512):
        finder.played(played[i : i + 512])
        volts = heard[kept[(kept >= i) & (kept < i + 512)]]
        if len(volts):
            codes = np.repeat(np.rint(volts * 3276.8).astype(np.int16)[:, None], 3, axis=1)
            blocks += finder.heard(Block(i, codes), volts)
    return blocks + finder.flush()


def test_several_losses_add_up() -> None:
    """Three losses in one run are three gaps; recorded and lost add up to played."""
    t = np.arange(100_000) / RATE_HZ
    played = np.sin(2 * np.pi * 25.37 * t) * np.minimum(t, 1.0)
    kept = np.r_[0:30_000, 30_100:55_000, 55_007:80_000, 80_300:100_000]
    blocks = feed(LossFinder(RATE_HZ), played, played, kept)
    assert [b.lost_before for b in blocks if b.lost_before] == [100, 7, 300]
    assert sum(len(b.codes) + b.lost_before for b in blocks) == len(played)
    starts = [b.first_sample for b in blocks]
    assert starts == list(np.cumsum([0, *[len(b.codes) for b in blocks[:-1]]]))


def test_repeated_frames_are_taken_out() -> None:
    """A driver that hands out the same frames twice does not lengthen the recording."""
    t = np.arange(60_000) / RATE_HZ
    played = np.sin(2 * np.pi * 25.37 * t) * np.minimum(t, 1.0)
    heard = np.r_[played[:40_000], played[39_800:59_800]]
    blocks = feed(LossFinder(RATE_HZ), played, heard)
    assert sum(len(b.codes) for b in blocks) == pytest.approx(59_800, abs=1)
    assert any(b.flags & BlockFlag.FILLED for b in blocks)


def test_a_drop_out_is_flagged_not_counted() -> None:
    """Zeros in the place of samples shift nothing: no gap, but the block is flagged."""
    t = np.arange(60_000) / RATE_HZ
    played = np.sin(2 * np.pi * 25.37 * t) * np.minimum(t, 1.0)
    heard = played.copy()
    heard[40_000:40_400] = 0.0
    blocks = feed(LossFinder(RATE_HZ), played, heard)
    assert sum(b.lost_before for b in blocks) == 0
    flagged = [b.first_sample for b in blocks if b.flags & BlockFlag.FILLED]
    assert flagged
    assert all(abs(first - 40_000) < 3 * 1024 for first in flagged)


def test_silence_is_no_loss_but_the_device_clock_counts() -> None:
    """With the drive at zero nothing is declared, unless the device's own time jumps."""
    zeros = np.zeros(50_000)
    assert sum(b.lost_before for b in feed(LossFinder(RATE_HZ), zeros, zeros[:40_000])) == 0
    finder, blocks = LossFinder(RATE_HZ), []
    for i in range(60):
        finder.played(zeros[:1024])
        adc = int((i * 1024 + (300 if i >= 40 else 0)) / RATE_HZ * 1e9) + 10**9
        blocks += finder.heard(Block(i * 1024, np.zeros((1024, 3), np.int16), adc_ns=adc), zeros[:1024])
    assert [b.lost_before for b in blocks if b.lost_before] == [300]


def test_what_does_not_add_up_is_suspect(tmp_path: Path, setup: Setup) -> None:
    """Expected = recorded + declared gaps, or the file says so."""
    for name, expected, suspect in (("a.h5", 120, False), ("b.h5", 125, True)):
        writer = RecordingWriter(
            tmp_path / name, setup, profile_text="", channels=CHANNELS, backend="s", simulated=True
        )
        writer.append(Block(0, np.zeros((60, 3), np.int16)))
        writer.append(Block(60, np.zeros((40, 3), np.int16), lost_before=20, lost_uncertainty=2))
        writer.close(expected_samples=expected)
        report = verify(tmp_path / name)
        assert (report.suspect, report.lost_samples, report.state) == (suspect, 20, "complete")
        with open_recording(tmp_path / name) as recording:
            assert recording.attrs["expected_samples"] == expected
