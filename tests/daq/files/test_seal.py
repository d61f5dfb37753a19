"""The seal: damage is found before HDF5 sees it, put right where it can be, and else a gap that is said."""

from __future__ import annotations

import io
import logging
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.daq import hostile_recordings
from daq.files.frames.marked_frames import MAGIC
from daq.files.seal import FOOTER, Seal, read_seal, text_crc
from daq.files.tables import BLOCK_DTYPE, STEP_DTYPE, Holes
from daq.recording import CHANNELS, Block, open_recording, verify
from daq.recording.opening import in_subprocess
from daq.recording.reader import Recording, gaps_of, timestamps_ns
from daq.recording.recover import recover
from daq.recording.writer import RecordingWriter
from daq.setup.errors import InputError
from daq.setup.setup import Setup

N = 150_000


@pytest.fixture
def run(tmp_path: Path, setup: Setup) -> tuple[Path, np.ndarray]:
    """A closed recording of three chunks a channel, with a gap and two steps; and its codes."""
    codes = np.random.default_rng(4).integers(-999, 999, (N, 3), np.int16)
    writer = RecordingWriter(
        tmp_path / "a.h5", setup, profile_text="p", channels=CHANNELS, backend="s", simulated=True, note="n"
    )
    for first in range(0, N, 1000):
        lost = 5 if first == 20_000 else 0
        writer.append(Block(first, codes[first : first + 1000], clock_ns=first, lost_before=lost))
    writer.mark_step({"first_sample": 0, "n_samples": 100_000, "gamma": 0.5})
    writer.mark_step({"first_sample": 100_000, "n_samples": 50_000, "gamma": 0.6})
    writer.close()
    return tmp_path / "a.h5", codes


def seal_of(path: Path) -> Seal:
    """The seal, which is there."""
    seal = read_seal(path)
    assert isinstance(seal, Seal)
    return seal


def change(path: Path, offset: int, n_bytes: int = 1) -> None:
    """Change neighbouring bytes."""
    with path.open("r+b") as raw:
        raw.seek(offset)
        there = raw.read(n_bytes)
        raw.seek(offset)
        raw.write(bytes(byte ^ 0x5A for byte in there))


def extent(path: Path, column: str, first: int) -> np.void:
    """The extent of a chunk."""
    seal = seal_of(path)
    rows = seal.extents
    return rows[(rows["column"] == seal.columns.index(column)) & (rows["first_sample"] == first)][0]


def test_the_seal_covers_every_byte(run: tuple[Path, np.ndarray]) -> None:
    """Extents follow each other from the first byte to the seal; other HDF5 readers do not mind it."""
    path, codes = run
    seal = seal_of(path)
    ends = seal.extents["offset"] + seal.extents["n_bytes"]
    assert seal.extents["offset"].tolist() == [0, *ends[:-1].tolist()]
    assert ends[-1] == seal.end < path.stat().st_size
    with h5py.File(path) as file:
        np.testing.assert_array_equal(file["drive"][:], codes[:, 2])


def test_one_byte_costs_nothing(run: tuple[Path, np.ndarray], caplog: pytest.LogCaptureFixture) -> None:
    """A changed byte in samples, and one in tables or attributes: said, and everything is read as it was written."""
    path, codes = run
    tables = seal_of(path).extents
    tables = tables[tables["column"] < 0]
    change(path, int(extent(path, "drive", 65536)["offset"]) + 777)
    change(path, int(tables["offset"][-1]) + 99)
    with caplog.at_level(logging.WARNING), open_recording(path) as recording:
        np.testing.assert_array_equal(recording.codes("drive"), codes[:, 2])
        assert recording.attrs["note"] == "n"
        assert len(recording.damage) == 2
        assert not recording.is_less
    assert "drive: samples 65536 to 131071" in caplog.text
    assert "a second copy has them" in caplog.text
    assert verify(path).state == "damaged"
    found = recover(path)
    assert not found.is_less
    assert verify(found.path).state == "complete"


def test_a_lost_piece_is_a_gap(run: tuple[Path, np.ndarray]) -> None:
    """Samples that are gone count as lost; all others, their times, the steps and later gaps stay what they were."""
    path, codes = run
    with open_recording(path) as recording:
        times = recording.timestamps_ns()
    gone = extent(path, "accelerometer", 65536)  # more of it than the parity gives back
    change(path, int(gone["offset"]) + 50, int(gone["n_bytes"]) - 100)
    left = np.r_[0:65536, 131072:N]
    found = recover(path)
    assert found.is_less
    for file in (path, found.path):
        with open_recording(file) as recording:
            assert recording.n_samples == len(left)
            for i, name in enumerate(CHANNELS):
                np.testing.assert_array_equal(recording.codes(name), codes[left, i])
                np.testing.assert_array_equal(recording.codes(name, 65000, 66000), codes[left[65000:66000], i])
            np.testing.assert_array_equal(recording.timestamps_ns(), times[left])
            assert recording.gaps.tolist() == [[20_000, 5], [65_536, 65_536]]
            assert recording.steps["n_samples"].tolist() == [65_536, N - 131_072]
    assert verify(found.path).state == "complete"
    assert "accelerometer: samples 65536 to 131071" in verify(path).where[0]


def test_damaged_bytes_never_reach_hdf5(run: tuple[Path, np.ndarray], monkeypatch: pytest.MonkeyPatch) -> None:
    """Wherever a sector of the tables is overwritten, HDF5 is handed the bytes that were written."""
    path, codes = run
    seen = []
    for row in seal_of(path).extents:
        if row["column"] < 0:
            half = int(row["n_bytes"]) // 2
            change(path, int(row["offset"]) + half, min(half, 512))
    whole = seal_of(path)
    before = h5py.File

    def opened(file: object, *arguments: object, **options: object) -> object:
        assert isinstance(file, io.RawIOBase)
        for row in whole.extents[whole.extents["column"] < 0]:
            file.seek(int(row["offset"]))
            seen.append(zlib.crc32(file.read(int(row["n_bytes"]))) == row["crc32"])
        return before(file, *arguments, **options)

    monkeypatch.setattr(h5py, "File", opened)
    with open_recording(path) as recording:
        np.testing.assert_array_equal(recording.codes("continuity"), codes[:, 0])
    assert seen
    assert all(seen)


def test_a_damaged_seal_is_damage(run: tuple[Path, np.ndarray]) -> None:
    """A byte of each table of the seal: found; the recording is read without it, in another process first."""
    path, codes = run
    seal_end = seal_of(path).end
    end_of_first = seal_of(path).parity_at
    change(path, path.stat().st_size - FOOTER.size - 30)
    change(path, end_of_first - FOOTER.size - 30)
    assert "another is whole" in verify(path).where[0]
    change(path, path.stat().st_size - (end_of_first - seal_end) - FOOTER.size - 30)
    assert verify(path).where[0] == "its table of checksums differs from what was written"
    with open_recording(path) as recording:
        np.testing.assert_array_equal(recording.codes("drive"), codes[:, 2])
        assert recording.damage == ("its table of checksums differs from what was written",)
    with path.open("r+b") as raw:  # no trace of the seal is left
        raw.truncate(seal_end)
    found = recover(path)
    assert not found.is_less
    assert verify(found.path).state == "complete"


def earlier(path: Path) -> None:
    """Make of a recording one of the time before seals."""
    with path.open("r+b") as raw:
        raw.truncate(seal_of(path).end)
    with h5py.File(path, "r+") as file:
        del file.attrs["sealed"]
        plain = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in file.attrs.items()}
        file.attrs["attributes_crc32"] = text_crc(plain)


def test_recordings_without_a_seal_stay_readable(run: tuple[Path, np.ndarray]) -> None:
    """A recording by an earlier version is whole, is read, and is said to be unchecked in its tables."""
    path, codes = run
    earlier(path)
    report = verify(path)
    assert report.state == "complete"
    assert "without checksums over its tables" in report.where[0]
    with open_recording(path) as recording:
        np.testing.assert_array_equal(recording.codes("drive"), codes[:, 2])
        assert "unchecked" in recording.damage[0]


@pytest.mark.parametrize("n_bytes", [1, 100])
def test_damage_without_a_seal_is_a_gap(run: tuple[Path, np.ndarray], n_bytes: int) -> None:
    """A recording by an earlier version with a damaged piece: the rest is read, and recovered."""
    path, codes = run
    at = int(extent(path, "drive", 0)["offset"]) + 300
    earlier(path)
    change(path, at, n_bytes)
    assert verify(path).where[0] == "drive: samples 0 to 65535 do not read back"
    found = recover(path)
    for file in (path, found.path):
        with open_recording(file) as recording:
            np.testing.assert_array_equal(recording.codes("drive"), codes[65536:, 2])
            assert recording.gaps[0].tolist() == [0, 65_536 + 5]


def test_an_unreadable_table_is_left_out(run: tuple[Path, np.ndarray]) -> None:
    """Without a seal, a step table that does not read costs the steps and no sample, and is said."""
    path, codes = run
    with h5py.File(path) as file:
        at = file["steps/gamma"].id.get_chunk_info(0).byte_offset
    earlier(path)
    change(path, at)
    found = recover(path)
    with open_recording(found.path) as recording:
        assert len(recording.steps) == 0
        np.testing.assert_array_equal(recording.codes("drive"), codes[:, 2])
    assert "the table steps does not read back" in found.damage


@pytest.mark.parametrize("marked", [True, False])
@pytest.mark.parametrize("table", ["frame_blocks", "frame_steps"])
def test_rows_of_a_run_that_was_cut_off_are_checked(tmp_path: Path, setup: Setup, table: str, marked: bool) -> None:
    """A changed number in the tables of a run that was cut off is found; without marks a block's costs that block."""
    path, codes = tmp_path / "a.h5", np.random.default_rng(1).integers(-9, 9, (3000, 3), np.int16)
    writer = RecordingWriter(path, setup, profile_text="", channels=CHANNELS, backend="s", simulated=True)
    for first in range(0, 3000, 1000):
        writer.append(Block(first, codes[first : first + 1000], clock_ns=first))
        writer.mark_step({"first_sample": first, "n_samples": 1000, "gamma": 0.5})
    info = writer._frames._file[table].id.get_chunk_info(0)
    itemsize = writer._frames._file[table].dtype.itemsize
    writer._frames._file.close()
    change(path, info.byte_offset + itemsize + 25)  # a clock, or a gamma, of the second row
    if not marked:
        path.write_bytes(path.read_bytes().replace(MAGIC, bytes(len(MAGIC))))
    report = verify(path)
    assert report.state == "damaged"
    assert "row" in report.where[0]
    with open_recording(recover(path).path) as recording:
        left = np.r_[0:1000, 2000:3000] if table == "frame_blocks" and not marked else np.r_[0:3000]
        np.testing.assert_array_equal(recording.codes("drive"), codes[left, 2])
        assert len(recording.steps) == (3 if marked else 2)


@given(
    spans=st.lists(st.tuples(st.integers(0, 60), st.integers(1, 20)), max_size=4),
    sizes=st.lists(st.integers(1, 20), min_size=1, max_size=6), lost=st.integers(0, 9),
)  # fmt: skip
def test_holes_keep_times_and_count_what_is_lost(spans: list[tuple[int, int]], sizes: list[int], lost: int) -> None:
    """For any holes in any blocks: places, ranges, steps and losses are those of a sample-by-sample count."""
    n = sum(sizes)
    blocks = np.zeros(len(sizes), BLOCK_DTYPE)
    blocks["n_samples"], blocks["first_sample"] = sizes, np.cumsum([0, *sizes[:-1]])
    blocks["lost_before"][-1] = lost
    holes = Holes.of([(a, a + m) for a, m in spans], n)
    keep = np.ones(n, bool)
    for a, m in spans:
        keep[a : a + m] = False
    left = np.flatnonzero(keep)
    assert holes.n_samples == len(left)
    assert [i for a, b in holes.ranges(0, n) for i in range(a, b)] == left.tolist()
    assert holes.place(np.arange(n + 1)).tolist() == [int(keep[:i].sum()) for i in range(n + 1)]
    table = holes.blocks(blocks)
    assert table["n_samples"].sum() == len(left)
    times = timestamps_ns(0, n, 1e9, gaps_of(blocks))
    np.testing.assert_array_equal(timestamps_ns(0, len(left), 1e9, gaps_of(table)), times[left])
    step = np.zeros(1, STEP_DTYPE)
    step["first_sample"], step["n_samples"] = n // 3, n - n // 3
    assert holes.steps(step)["n_samples"].sum() == keep[n // 3 :].sum()


KINDS = [
    kind for kind in hostile_recordings.KINDS if kind.__name__ not in ("many_objects", "deep_text", "formula_channel")
]


def test_a_channel_called_like_a_formula_is_refused(run: tuple[Path, np.ndarray]) -> None:
    """A channel's name becomes a heading of a CSV file and of a page: nothing in it may be run."""
    path, _ = run
    with h5py.File(path, "r+") as file:
        for name in ('=HYPERLINK("x")', "<img src=x onerror=alert(1)>"):
            file.attrs["channels"] = ["continuity", name]
            file.flush()
            with pytest.raises(InputError, match="letters, digits"):
                Recording(path, file)


@pytest.mark.parametrize("spoil", KINDS)
def test_hostile_files_are_refused_or_left_out(
    run: tuple[Path, np.ndarray], spoil: Callable[[h5py.File, Path], None]
) -> None:
    """Claims beyond the file and ways out of it: found, never followed; what is sound beside them is read."""
    path, codes = run
    hostile_recordings.outside(path.parent, N)
    with h5py.File(path, "r+") as file:
        spoil(file, path.parent)
    assert verify(path).state == "damaged"
    with open_recording(path) as recording:
        np.testing.assert_array_equal(recording.codes("continuity"), codes[:, 0])
        assert "drive" not in recording.channels or np.array_equal(recording.codes("drive"), codes[:, 2])


def test_too_many_objects_and_text_too_deep_are_refused(run: tuple[Path, np.ndarray]) -> None:
    """A table with a thousand members, and free keys nested without end, end in a sentence."""
    path, _ = run
    with h5py.File(path, "r+") as file:
        for i in range(1000):
            file["steps"].create_group(f"g{i}")
        file.attrs["extra_json"] = "[" * 100_000
    assert verify(path).state == "damaged"
    with pytest.raises(InputError, match="nothing of it can be read"):
        open_recording(path)


HANDS = """
import os
def hang(tell):
    tell("the index")
    while True:
        pass
def crash(tell):
    tell("the heap")
    os.kill(os.getpid(), 11) if os.name == "posix" else os._exit(1)
def hoard(tell):
    tell("the table")
    return len(bytearray(16 << 30))
def refuse(tell):
    from daq.setup.errors import InputError
    raise InputError("not this one")
"""


def test_a_process_that_hangs_or_dies_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What reads a damaged file may loop or crash: the answer says that, and where; a refusal comes through."""
    (tmp_path / "hands.py").write_text(HANDS, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with monkeypatch.context() as hurried:
        hurried.setattr("daq.recording.opening.PATIENCE_S", 0.3)
        hung = in_subprocess("hands:hang")
    dead = in_subprocess("hands:crash")
    assert (hung.at, "does not come to an end" in hung.died) == ("the index", True)
    assert (dead.at, "ended the process" in dead.died) == ("the heap", True)
    with pytest.raises(InputError, match="not this one"):
        in_subprocess("hands:refuse")


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux limits a process' memory")
def test_a_process_that_asks_for_all_memory_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A claim of 16 GB ends the process that believes it, not the machine."""
    (tmp_path / "hands.py").write_text(HANDS, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    assert "MemoryError" in in_subprocess("hands:hoard").died
