"""The pyramid of a recording: exact extremes at every zoom, gaps where samples were lost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from daq.files.tables import Block
from daq.pyramid import Pyramid, build_pyramid, has_pyramid, pyramid_key
from daq.recording import BLOCK_DTYPE, CHANNELS, STEP_DTYPE, Recording, open_recording
from daq.recording.writer import RecordingWriter
from daq.setup.errors import InputError
from daq.setup.setup import Setup

RATE_HZ = 1000
SETUP = {
    "name": "x",
    "sampling": {"rate_hz": RATE_HZ},
    "forcing": {"frequency_hz": 25.37},
    "channels": {"accelerometer": {"sensitivity": 0.1, "unit": "V/g"}},
    "ball": {"mass_kg": 0.25},
}


def record(path: Path, lengths: list[int], lost: list[int], seed: int = 0) -> np.ndarray:
    """A recording of noise in blocks, each after samples that were lost; its codes (n, 3)."""
    rng = np.random.default_rng(seed)
    pieces, at = [], 0
    setup = Setup.model_validate(SETUP)
    writer = RecordingWriter(path, setup, profile_text="", channels=CHANNELS, backend="b", simulated=True)
    for n, gone in zip(lengths, lost, strict=True):
        codes = rng.integers(-3000, 3000, (n, 3)).astype(np.int16)
        writer.append(Block(at, codes, lost_before=gone))
        pieces.append(codes)
        at += n
    writer.close()
    return np.concatenate(pieces)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pieces so small that buckets and stretches run over their ends, and buckets of more samples than the smallest."""
    monkeypatch.setattr("daq.pyramid.PIECE", 1000)
    monkeypatch.setattr("daq.pyramid.MOST_BUCKETS", 40)


def opened(path: Path) -> Pyramid:
    """The pyramid of a recording, made beside it."""
    with open_recording(path) as recording:
        build_pyramid(recording, path.with_suffix(".pyramid"))
    return Pyramid(path.with_suffix(".pyramid"))


@pytest.mark.parametrize("seed", range(5))
def test_every_bucket_holds_the_extremes_of_its_samples(tmp_path: Path, small: None, seed: int) -> None:
    """The extremes are exactly those of the samples of one stretch without a gap."""
    rng = np.random.default_rng(seed)
    lengths = rng.integers(1, 3000, 9).tolist()
    lost = [0, *np.where(rng.random(8) < 0.6, rng.integers(1, 5000, 8), 0).tolist()]
    codes = record(tmp_path / "r.h5", lengths, lost, seed)
    pyramid = opened(tmp_path / "r.h5")
    layout = pyramid.layout
    assert layout.bucket > 64
    assert layout.places == len(codes) + sum(lost)
    for c, got in enumerate(pyramid._extremes):
        stretches = [codes[a:b, c] for a, b in zip(layout.starts[:-1], layout.starts[1:], strict=True)]
        buckets = [x for own in stretches for x in np.split(own, range(layout.bucket, len(own), layout.bucket))]
        assert np.array_equal(np.stack(got, 1), [(x.min(), x.max()) for x in buckets])


@pytest.mark.parametrize("width", [1, 3, 40, 200])
def test_a_view_holds_the_extremes_and_the_gaps(tmp_path: Path, small: None, width: int) -> None:
    """Whatever the zoom, the largest and smallest voltage are those of the samples, and columns in a gap are empty."""
    codes = record(tmp_path / "r.h5", [4000, 3000], [0, 5000])
    volts = codes[:, 1] * 10 / 32768
    pyramid = opened(tmp_path / "r.h5")
    view = pyramid.view(0.0, 12.0, width, lambda: open_recording(tmp_path / "r.h5"))
    low, high = view.low_v["accelerometer"], view.high_v["accelerometer"]
    assert (np.nanmin(low), np.nanmax(high)) == (volts.min(), volts.max())
    assert view.lost.tolist() == [[4.0, 9.0, 5000.0]]
    column = 12.0 / width
    inside = (view.time_s > 4.0 + column) & (view.time_s < 9.0 - column)
    assert np.isnan(low[inside]).all()
    outside = (view.time_s < 4.0 - column) | (view.time_s > 9.0 + column)
    assert np.isfinite(low[outside]).all()


def test_deep_in_the_samples_themselves_are_shown(tmp_path: Path) -> None:
    """A stretch of few samples gives each of them at its own time, on both sides of a gap."""
    codes = record(tmp_path / "r.h5", [500, 500], [0, 30])
    pyramid = opened(tmp_path / "r.h5")
    view = pyramid.view(0.490, 0.540, 1000, lambda: open_recording(tmp_path / "r.h5"))
    assert view.samples_per_point == 1
    expected = [0.490 + 0.001 * k for k in range(10)] + [0.530 + 0.001 * k for k in range(11)]
    assert view.time_s == pytest.approx(expected)
    assert np.array_equal(view.low_v["drive"], codes[490:511, 2] * (10 / 32768))


def test_one_sample_among_many_stays_visible(tmp_path: Path) -> None:
    """A contact of a single sample shows in a view of the whole recording."""
    path = tmp_path / "r.h5"
    setup = Setup.model_validate(SETUP)
    writer = RecordingWriter(path, setup, profile_text="", channels=CHANNELS, backend="b", simulated=True)
    codes = np.full((100_000, 3), 16384, np.int16)
    codes[77_777, 0] = 0
    writer.append(Block(0, codes))
    writer.close()
    view = opened(path).view(0.0, 100.0, 100, lambda: open_recording(path))
    assert np.flatnonzero(view.low_v["continuity"] == 0.0).tolist() == [77]


def test_a_pyramid_belongs_to_one_recording(tmp_path: Path) -> None:
    """It is known by the checksums of the samples; one of other samples, or a damaged one, is not taken."""
    record(tmp_path / "a.h5", [3000], [0], seed=1)
    record(tmp_path / "b.h5", [3000], [0], seed=2)
    keys = []
    for name in "ab":
        with open_recording(tmp_path / f"{name}.h5") as recording:
            keys.append(pyramid_key(recording))
    path = opened(tmp_path / "a.h5").path
    assert has_pyramid(path, keys[0])
    assert not has_pyramid(path, keys[1])
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    assert not has_pyramid(path, keys[0])
    path.write_bytes(content[:40])
    assert not has_pyramid(path, keys[0])
    with pytest.raises(InputError, match="remove the file"):
        Pyramid(path)


def test_wrong_views_are_refused(tmp_path: Path) -> None:
    """A view backwards, outside, of no or too many columns is refused with what was wanted."""
    record(tmp_path / "r.h5", [3000], [0])
    pyramid = opened(tmp_path / "r.h5")

    def never() -> Recording:
        raise AssertionError

    for start_s, stop_s, width, says in (
        (1.0, 1.0, 10, "start before the stop"), (float("nan"), 1.0, 10, "start before"), (5.0, 6.0, 10, "lasts 3 s"),
        (0.0, 1.0, 0, "1 to 8192 columns"), (0.0, 1.0, 9000, "1 to 8192 columns"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=says):
            pyramid.view(start_s, stop_s, width, never)


def test_imported_volts_with_samples_that_are_no_numbers(tmp_path: Path) -> None:
    """Floats keep their type, and a NaN among them hides none of its neighbours."""
    from daq.files.column_file import ColumnWriter
    from daq.recording.writer import root_attributes

    setup = Setup.model_validate(SETUP)
    path, n = tmp_path / "f.h5", 5000
    values = np.linspace(-1, 1, n)
    values[1000:1200] = np.nan
    attributes = root_attributes(setup, profile_text="", backend="import", simulated=False)
    attributes |= {"channels": ["accelerometer"], "ended": "complete", "why": ""}
    writer = ColumnWriter(path, setup, {"accelerometer": np.dtype("f8")}, {"accelerometer": (1.0, 0.0)}, attributes)
    writer.append(np.arange(n, dtype=np.int64) * 10**6, {"accelerometer": values})
    blocks = np.zeros(1, BLOCK_DTYPE)
    blocks["n_samples"] = n
    writer.check(np.zeros(0, STEP_DTYPE), blocks)
    writer.rename()
    view = opened(path).view(0.0, 5.0, 20, lambda: open_recording(path))
    assert np.nanmin(view.low_v["accelerometer"]) == -1.0
    assert np.nanmax(view.high_v["accelerometer"]) == 1.0
    assert np.isfinite(view.low_v["accelerometer"]).all()
