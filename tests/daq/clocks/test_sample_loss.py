"""Lost samples: counted to the sample on the loop-back, placed, never invented."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.daq import losses, sample_path
from daq.clocks.loss_search import NOTHING, Found, Searcher
from daq.clocks.sample_loss import LossDetector
from daq.files.tables import Block, BlockFlag
from daq.recording import CHANNELS, open_recording, verify
from daq.recording.writer import RecordingWriter
from daq.setup.clock import SYSTEM
from daq.setup.setup import Setup

RATE_HZ = 20_000.0


@pytest.mark.parametrize("ratio", [1, 2])
@pytest.mark.parametrize("lost", [1, 17, 800, 5000])
def test_losses_are_counted_and_placed(lost: int, ratio: int) -> None:
    """One loss, from one sample to a quarter of a second: one gap, the right count, at its place."""
    (at, _, _), *declared = losses.run(np.random.default_rng(lost + ratio), lost, ratio, seconds=4.0)
    assert [n for _, n, _ in declared] == [lost]
    assert abs(declared[0][0] - at) < 400


def test_clean_runs_stay_clean() -> None:
    """Steps, fades, latency, noise and a late clock are not losses."""
    for ratio in (1, 2, 3):
        assert losses.run(np.random.default_rng(ratio), 0, ratio, seconds=4.0)[1:] == []


def feed(finder: LossDetector, played: np.ndarray, heard: np.ndarray, kept: np.ndarray | None = None) -> list[Block]:
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
    blocks = feed(LossDetector(RATE_HZ), played, played, kept)
    assert [b.lost_before for b in blocks if b.lost_before] == [100, 7, 300]
    assert sum(len(b.codes) + b.lost_before for b in blocks) == len(played)
    starts = [b.first_sample for b in blocks]
    assert starts == list(np.cumsum([0, *[len(b.codes) for b in blocks[:-1]]]))


def test_repeated_frames_are_taken_out() -> None:
    """A driver that hands out the same frames twice does not lengthen the recording."""
    t = np.arange(60_000) / RATE_HZ
    played = np.sin(2 * np.pi * 25.37 * t) * np.minimum(t, 1.0)
    heard = np.r_[played[:40_000], played[39_800:59_800]]
    blocks = feed(LossDetector(RATE_HZ), played, heard)
    assert sum(len(b.codes) for b in blocks) == pytest.approx(59_800, abs=1)
    assert any(b.flags & BlockFlag.FILLED for b in blocks)


def test_a_drop_out_is_flagged_not_counted() -> None:
    """Zeros in the place of samples shift nothing: no gap, but the block is flagged."""
    t = np.arange(60_000) / RATE_HZ
    played = np.sin(2 * np.pi * 25.37 * t) * np.minimum(t, 1.0)
    heard = played.copy()
    heard[40_000:40_400] = 0.0
    blocks = feed(LossDetector(RATE_HZ), played, heard)
    assert sum(b.lost_before for b in blocks) == 0
    flagged = [b.first_sample for b in blocks if b.flags & BlockFlag.FILLED]
    assert flagged
    assert all(abs(first - 40_000) < 3 * 1024 for first in flagged)


def test_silence_is_no_loss_but_the_device_clock_counts() -> None:
    """With the drive at zero nothing is declared, unless the device's own time jumps."""
    zeros = np.zeros(50_000)
    assert sum(b.lost_before for b in feed(LossDetector(RATE_HZ), zeros, zeros[:40_000])) == 0
    finder, blocks = LossDetector(RATE_HZ), []
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


@pytest.mark.parametrize("case", ["clean", "lost", "dry", "unplugged", "storm"])
def test_the_sample_path_does_bounded_work(case: str) -> None:
    """No block takes over a tenth of its time in counted work, whatever happens; each loss and disturbance is said."""
    seen = sample_path.follow(case, seconds=6.0)
    sample_path.require(seen, case)
    third, half = round(2.0 * sample_path.RATE_HZ), round(3.0 * sample_path.RATE_HZ)
    if case == "lost":
        assert seen["lost"] == 777 and abs(seen["place"] - third) < 40
    else:
        assert seen["lost"] == 0
    if case in ("clean", "lost"):
        assert seen["filled"] == 0
    if case == "dry":
        assert 0 < seen["filled"] < 4 * sample_path.CHUNK and seen["last_filled"] < third + 4 * sample_path.CHUNK
    if case in ("unplugged", "storm"):  # it recovers once the drive is back
        assert seen["filled"] > 0.9 * (half - third) and seen["last_filled"] < half + 4 * sample_path.CHUNK


def test_an_answer_that_comes_late_is_the_same() -> None:
    """Searches in a thread, however slow, declare what searches at once declare, at the same samples."""

    class Slow(Searcher):
        """Answers when it has been looked at twenty times, however fast its thread is."""

        def __init__(self) -> None:
            super().__init__(SYSTEM.executor("search"))
            self.looks = 0

        def answer(self, *, wait: bool) -> Found | None:
            self.looks += 1
            return super().answer(wait=True) if wait or self.looks % 20 == 0 else None

    t = np.arange(100_000) / RATE_HZ
    played = np.sin(2 * np.pi * 25.37 * t) * np.minimum(t, 1.0)
    kept = np.r_[0:40_000, 40_200:70_000, 75_000 : len(played)]
    gaps = []
    for searcher in (Searcher(), Slow()):
        blocks = feed(LossDetector(RATE_HZ, searcher=searcher), played, played, kept)
        gaps.append([(b.first_sample, b.lost_before, b.lost_uncertainty) for b in blocks if b.lost_before])
        assert sum(len(b.codes) for b in blocks) == len(kept)
    assert gaps[0] == gaps[1] and len(gaps[0]) == 2


def test_an_answer_that_never_comes_costs_no_sample() -> None:
    """A search that is kept from running: the frames are flagged and go on, in order, all of them."""

    class Never(Searcher):
        """Takes every question and answers none while the run lasts."""

        def answer(self, *, wait: bool) -> Found | None:
            return NOTHING if wait else None

    t = np.arange(150_000) / RATE_HZ
    played = np.sin(2 * np.pi * 25.37 * t) * np.minimum(t, 1.0)
    heard = np.r_[played[:40_000], np.random.default_rng(0).standard_normal(9000), played[49_000:]]
    finder = LossDetector(RATE_HZ, searcher=Never())
    finder.expect(0)
    blocks = feed(finder, played, heard)
    assert [b.first_sample for b in blocks] == np.cumsum([0] + [len(b.codes) for b in blocks])[:-1].tolist()
    assert sum(len(b.codes) for b in blocks) == 150_000 and not any(b.lost_before for b in blocks)
    assert any(b.flags & BlockFlag.FILLED for b in blocks)


def test_a_devices_own_count_rules_out_whole_periods() -> None:
    """A disturbance that would fit a period lost is none where the device's own time knows of no loss."""
    period = 800
    t = np.arange(120_000)
    played = np.sin(2 * np.pi * t / period) * np.minimum(t / 20_000, 1.0) * (1.0 + 1e-6 * t)
    heard = played.copy()
    heard[60_000:62_000] = played[60_000 + period : 62_000 + period]
    finder, blocks = LossDetector(RATE_HZ), []
    for i in range(0, len(played), 500):
        finder.played(played[i : i + 500])
        adc_ns = round(i / RATE_HZ * 1e9) + 10**9
        blocks += finder.heard(Block(i, np.zeros((500, 3), np.int16), adc_ns=adc_ns), heard[i : i + 500])
    blocks += finder.flush()
    assert not any(b.lost_before for b in blocks) and sum(len(b.codes) for b in blocks) == 120_000


def test_a_known_latency_of_a_cycle_survives_a_drive_that_grows_slowly() -> None:
    """A drive that comes back 40 ms late, as was measured before, is not taken for one that comes back a cycle less."""
    t = np.arange(100_000) / RATE_HZ
    played = np.sin(2 * np.pi * 25.37 * t) * (t / 10.0) ** 2
    heard = np.r_[np.zeros(800), played[:-800]] + 3e-4 * np.random.default_rng(1).standard_normal(len(played))
    finder = LossDetector(RATE_HZ)
    finder.expect(800.0)
    feed(finder, played, heard)
    assert finder.lost_samples == 0
    assert finder._lag == pytest.approx(-800.0, abs=0.1)
