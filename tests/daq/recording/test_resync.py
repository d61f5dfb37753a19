"""Runs whose HDF5 tables are destroyed: the samples are found by the marks between the frames."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from benchmarks.daq import resync
from daq.files.frames.frame_file import as_if_ended
from daq.files.frames.marked_frames import MAGIC
from daq.files.seal import Seal, read_seal
from daq.recording import CHANNELS, Block, open_recording, verify
from daq.recording.recover import recover
from daq.recording.writer import RecordingWriter
from daq.setup.errors import InputError
from daq.setup.setup import Setup

CODES = np.random.default_rng(1).integers(-999, 999, (30000, 3), np.int16)


@pytest.fixture
def run(tmp_path: Path, setup: Setup) -> Path:
    """A run of 30 blocks and two steps that was not closed; nothing of its end was written."""
    path = tmp_path / "a.h5"
    writer = RecordingWriter(path, setup, profile_text="p", channels=CHANNELS, backend="s", simulated=True, note="n")
    for i in range(30):
        codes = CODES[i * 1000 : (i + 1) * 1000]
        writer.append(Block(i * 1000, codes, clock_ns=i + 1, lost_before=5 if i == 7 else 0))
        if i in (9, 19):
            writer.mark_step({"first_sample": (i - 9) * 1000, "n_samples": 10000, "gamma": 0.1 * i})
    copy = tmp_path / "killed.h5"
    copy.write_bytes(path.read_bytes())
    writer.close()
    return copy


def zero(path: Path, start: int, stop: int) -> None:
    """Zero some bytes of a file."""
    with path.open("r+b") as raw:
        raw.seek(start)
        raw.write(bytes(stop - start))


def chunks(path: Path, name: str) -> list[tuple[int, int]]:
    """First byte and length of the chunks of a dataset."""
    found: list[tuple[int, int]] = []
    with h5py.File(as_if_ended(path), "r") as file:
        file[name].id.chunk_iter(lambda chunk: found.append((chunk.byte_offset, chunk.size)))
    return found


@pytest.mark.parametrize("n_bytes", [8, 48, 2000, 12000])
def test_without_its_index_every_sample_comes_back(run: Path, n_bytes: int) -> None:
    """With the beginning of the file zeroed, HDF5 refuses it; samples, gap, steps and set-up come back all the same."""
    zero(run, 0, n_bytes)
    report = verify(run)
    assert (report.state, report.n_samples, report.lost_samples) == ("damaged", 30000, 5)
    found = recover(run)
    assert (found.n_samples, found.n_steps, found.lost_samples) == (30000, 2, 5)
    assert verify(found.path).state == "stopped"
    with open_recording(found.path) as recording:
        assert recording.attrs["note"] == "n"
        assert recording.gaps.tolist() == [[7000, 5]]
        assert recording.blocks["clock_ns"].tolist() == list(range(1, 31))
        for i, name in enumerate(CHANNELS):
            np.testing.assert_array_equal(recording.codes(name), CODES[:, i])


def test_what_is_gone_is_a_gap_in_its_place(run: Path) -> None:
    """Zeroed frames cost a few samples around them; the rest is in its place, the missing ones declared."""
    place, _ = chunks(run, "frames")[1]
    zero(run, 0, 48)
    zero(run, place + 6000, place + 6600)
    found = recover(run)
    gone = 30000 - found.n_samples
    assert 100 <= gone <= 190
    assert found.lost_samples == 5 + gone
    assert verify(found.path).lost_samples == 5 + gone
    with open_recording(found.path) as recording:
        after = recording.gaps[-1, 0]
        np.testing.assert_array_equal(recording.codes("drive", after), CODES[after + gone :, 2])
        np.testing.assert_array_equal(recording.codes("drive", 0, after), CODES[:after, 2])


def test_a_lost_row_of_the_block_table_costs_no_sample(run: Path) -> None:
    """HDF5 reads the file, but rows of its table are zeroed: the marks have them."""
    place, _ = chunks(run, "frame_blocks")[0]
    zero(run, place, place + 700)
    assert recover(run).n_samples == 30000


def test_steps_keep_their_length_where_the_block_table_is_cut(run: Path) -> None:
    """HDF5 reads only half of the blocks and cuts the step there; the marks have more, and what is gone is said."""
    place, _ = chunks(run, "frame_blocks")[0]
    zero(run, place + 15 * 60, place + 30 * 60)
    found = recover(run)
    assert (found.n_samples, found.is_less) == (22000, True)
    assert found.damage[0].startswith("block 22: its row differs")
    with open_recording(found.path) as recording:
        assert recording.steps["n_samples"].tolist() == [10000, 10000]


def test_rows_that_no_mark_holds_are_found_in_their_table(run: Path) -> None:
    """Without index and without the last marks, blocks after the last whole mark are found by their own checksum."""
    place = run.read_bytes().rfind(MAGIC)
    zero(run, place, place + 4096)
    zero(run, 0, 48)
    assert recover(run).n_samples == 30000


def test_a_file_of_an_earlier_version_is_read_as_before(run: Path) -> None:
    """A frames file without marks opens as it did; with its beginning zeroed it is refused."""
    run.write_bytes(run.read_bytes().replace(MAGIC, bytes(len(MAGIC))))
    assert verify(run).n_samples == 30000
    assert recover(run).n_samples == 30000
    zero(run, 0, 48)
    with pytest.raises(InputError, match="cannot be read as HDF5"):
        recover(run, run.with_name("b.h5"))


@pytest.mark.parametrize("kind", ["cut-off", "closed"])
def test_a_hundredth_zeroed_anywhere(kind: str) -> None:
    """With 1 % zeroed, in a run, in pages, in sectors, 98 % of the samples come back (1,000 files: benchmarks)."""
    results = [row for rows in resync.score(kind, 6, 0.01, 3).values() for row in rows]
    assert not [fault for _, fault in results if fault]
    assert np.mean([back for back, _ in results]) > 0.98


@pytest.mark.parametrize("which", ["the last", "the first", "two of three", "each, in different places"])
def test_one_table_of_checksums_is_enough(run: Path, which: str) -> None:
    """A closed file is read whole, and said to be damaged, if a table of its checksums is, or each at another place."""
    path = recover(run).path
    seal = read_seal(path)
    assert isinstance(seal, Seal)
    size, whole, apart = path.stat().st_size, seal.parity_at - seal.end, which.startswith("each")
    if which != "the last":
        zero(path, seal.end + 10, seal.end + 300)
    if which in ("the last", "two of three") or apart:
        zero(path, size - 600, size - 400 if apart else size)
    if apart:
        zero(path, size - whole - 1000, size - whole - 700)
    report = verify(path)
    assert (report.state, report.n_samples) == ("damaged", 30000)
    assert "table of its checksums" in report.where[0]
    assert verify(recover(path, path.with_name("b.h5")).path).state == "stopped"
