"""Verify: every damage is found and placed; nothing whole is called damaged."""

from __future__ import annotations

import importlib
from pathlib import Path

import h5py
import numpy as np
import pytest

from daq.files.frames.frame_file import FRAME_STEPS, as_if_ended
from daq.files.frames.marked_frames import MAGIC
from daq.recording import CHANNELS, Block, verify
from daq.recording.recover import recover
from daq.recording.writer import RecordingWriter
from daq.setup.errors import InputError
from daq.setup.setup import Setup


def record(path: Path, setup: Setup, n_blocks: int = 4) -> RecordingWriter:
    """An open writer with some blocks of 50000 frames in it."""
    rng = np.random.default_rng(2)
    writer = RecordingWriter(path, setup, profile_text="", channels=CHANNELS, backend="simulated", simulated=True)
    for i in range(n_blocks):
        writer.append(Block(50_000 * i, rng.integers(-999, 999, (50_000, 3), np.int16)))
    writer.mark_step({"first_sample": 0, "n_samples": 100_000})
    return writer


def overwrite(path: Path, name: str, chunk: int, n_bytes: int = 1) -> None:
    """Change bytes in the middle of a stored chunk of a dataset."""
    with h5py.File(path, "r") as file:
        dataset = file[name]
        where = (chunk * dataset.chunks[0],) + (0,) * (dataset.ndim - 1)
        info = dataset.id.get_chunk_info_by_coord(where)
    with path.open("r+b") as raw:
        raw.seek(info.byte_offset + info.size // 2)
        there = raw.read(n_bytes)
        raw.seek(-n_bytes, 1)
        raw.write(bytes(byte ^ 0x10 for byte in there))


def test_states_of_sound_files(tmp_path: Path, setup: Setup) -> None:
    """A finished run is complete, a failed or interrupted one stopped with its reason, a running one incomplete."""
    path = tmp_path / "a.h5"
    writer = record(path, setup)
    assert verify(path).state == "incomplete"
    writer.close()
    assert verify(path).state == "complete"
    record(tmp_path / "b.h5", setup).close("failed", "amplifier tripped")
    report = verify(tmp_path / "b.h5")
    assert report.state == "stopped"
    assert "amplifier tripped" in report.where[0]
    assert report.n_samples == 200_000


@pytest.mark.parametrize("name", [*CHANNELS, "timestamp"])
def test_a_changed_byte_is_placed(tmp_path: Path, setup: Setup, name: str) -> None:
    """One bit, or a few bytes, of one chunk of one channel: damaged, with the channel and the range of samples."""
    path = tmp_path / "a.h5"
    record(path, setup).close()
    for n_bytes in (1, 100):
        overwrite(path, name, 1, n_bytes)
        report = verify(path)
        assert report.state == "damaged"
        assert report.where[0].startswith(f"{name}: samples 65536 to 131071 (bytes ")
        assert "computed from the parity" in report.where[0]


def test_a_changed_byte_in_the_frames_is_placed(tmp_path: Path, setup: Setup) -> None:
    """A run that was cut off and whose frames were changed names the samples; without marks, the block."""
    path = tmp_path / "a.h5"
    writer = record(path, setup)
    writer._frames.close()
    rows_per_chunk = 65536 // 6
    overwrite(path, "frames", 60_000 // rows_per_chunk)
    report = verify(path)
    assert report.state == "damaged"
    first = int(report.where[0].split()[1])
    assert report.where[0].startswith("samples 5")
    assert 59_000 < first <= 60_000 < int(report.where[0].split()[3])
    path.write_bytes(path.read_bytes().replace(MAGIC, bytes(len(MAGIC))))
    assert "block 1: samples 50000 to 99999" in verify(path).where[0]


def test_a_missing_chunk_is_damage(tmp_path: Path, setup: Setup) -> None:
    """HDF5 reads a chunk that was never written as zeros without a word; the sum over the channel does not."""
    path = tmp_path / "a.h5"
    record(path, setup).close()
    with h5py.File(path, "r+") as file:
        data, attributes, scale = file["drive"][:65536], dict(file["drive"].attrs), file["timestamp"]
        del file["drive"]
        again = file.create_dataset("drive", (200_000,), "<i2", chunks=(65536,), fletcher32=True)
        again[:65536] = data
        again.dims[0].attach_scale(scale)
        for key in ("scale_factor", "add_offset", "crc32"):
            again.attrs[key] = attributes[key]
    where = verify(path).where
    assert "/drive: damaged: claims 400000 bytes; 131072 are stored" in where[0]


@pytest.mark.parametrize(("is_written", "readings"), [(False, [True]), (True, [True, False])])
def test_only_a_file_that_is_written_is_waited_for(
    tmp_path: Path, setup: Setup, monkeypatch: pytest.MonkeyPatch, is_written: bool, readings: list[bool]
) -> None:
    """A damaged file that was cut off is read once, as if it had ended; one that changes meanwhile is read again."""
    running = record(tmp_path / "running.h5", setup)
    path = tmp_path / "a.h5"
    path.write_bytes(running.path.read_bytes())
    with h5py.File(as_if_ended(path), "r") as file:
        at = h5py.h5o.get_info(file[FRAME_STEPS].id).addr
    with path.open("r+b") as raw:
        raw.seek(at)
        raw.write(bytes(64))
    asked, module = [], importlib.import_module("daq.recording.verify")
    real = module._survey

    def survey(path: Path, *, ended: bool, **options: int) -> object:
        asked.append(ended)
        found = real(path, ended=ended, **options)
        if is_written:
            path.touch()
        return found

    monkeypatch.setattr(module, "_survey", survey)
    assert verify(path).state == "damaged"
    assert asked == readings


def test_changed_metadata_is_damage(tmp_path: Path, setup: Setup) -> None:
    """A note altered after the run is found."""
    path = tmp_path / "a.h5"
    record(path, setup).close()
    with h5py.File(path, "r+") as file:
        file.attrs["note"] = "better than it was"
    assert verify(path).where == [
        "the root attributes differ from what was written",
        "its checksums are gone: another program has written to it since",
    ]


def test_a_shortened_file_is_damage(tmp_path: Path, setup: Setup) -> None:
    """A copy that broke off does not pass, wherever it broke off."""
    path = tmp_path / "a.h5"
    record(path, setup).close()
    whole = path.read_bytes()
    for share in (0.3, 0.7, 0.99):
        cut = tmp_path / "cut.h5"
        cut.write_bytes(whole[: int(len(whole) * share)])
        assert verify(cut).state == "damaged"


def test_what_is_left_of_a_file_that_was_cut_off_is_said(tmp_path: Path, setup: Setup) -> None:
    """At a seventh, what is missing and what to do; with the checksums alone cut off, that nothing else is missing."""
    path = tmp_path / "a.h5"
    record(path, setup).close()
    whole, cut = path.read_bytes(), tmp_path / "cut.h5"
    cut.write_bytes(whole[: len(whole) // 7])
    said = rf"cut off after {len(whole) // 7} of \d+ bytes: .* were in the part that is missing; copy the whole file"
    with pytest.raises(InputError, match=said):
        recover(cut)
    assert len(verify(cut).where) == 1
    cut.write_bytes(whole[:-100])
    found = recover(cut)
    assert (found.n_samples, found.is_less) == (200_000, False)
    assert "cut off behind its samples and tables, of which nothing is missing" in found.damage[0]


def test_every_byte_of_a_small_file_counts_or_is_idle(tmp_path: Path, setup: Setup) -> None:
    """Flip bytes all over the file: each flip is found, or changes nothing that a reader gets."""
    path = tmp_path / "a.h5"
    writer = RecordingWriter(path, setup, profile_text="", channels=CHANNELS, backend="s", simulated=True)
    codes = np.random.default_rng(1).integers(-9, 9, (500, 3), np.int16)
    writer.append(Block(0, codes))
    writer.close()
    whole = path.read_bytes()
    other = tmp_path / "b.h5"
    assert verify(path).state == "complete"
    found = 0
    for place in np.random.default_rng(3).integers(0, len(whole), 60):
        changed = bytearray(whole)
        changed[place] ^= 0xFF
        other.write_bytes(changed)
        try:
            state = verify(other).state
        except InputError:
            continue  # it no longer is a recording at all
        found += state == "damaged"
        if state == "complete":
            with h5py.File(other) as file:
                for i, name in enumerate(CHANNELS):
                    np.testing.assert_array_equal(file[name][:], codes[:, i])
    assert found > 10
    other.write_bytes(whole)  # the same path and the same bytes: no state is left from the damaged ones
    assert verify(other) == verify(path) and verify(other).state == "complete"


def test_only_recordings_are_judged(tmp_path: Path) -> None:
    """A file that never was a recording is refused, not called damaged."""
    with pytest.raises(InputError, match="no such file"):
        verify(tmp_path / "none.h5")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = [1]
    with pytest.raises(InputError, match="not a recording"):
        verify(tmp_path / "other.h5")


def test_a_block_that_changed_before_the_run_was_closed_is_flagged(tmp_path: Path, setup: Setup) -> None:
    """Its samples stay, and whoever opens the recording hears which differ."""
    path = tmp_path / "r.h5"
    writer = RecordingWriter(path, setup, profile_text="", channels=CHANNELS, backend="b", simulated=True)
    codes = np.random.default_rng(3).integers(-999, 999, (3000, 3), np.int16)
    for k in range(0, 3000, 1000):
        writer.append(Block(k, codes[k : k + 1000]))
    at = path.read_bytes().index(codes[1500:1600].tobytes())
    with path.open("r+b") as file:
        file.seek(at)
        file.write(b"\xff")
    writer.close()
    report = verify(path)
    assert report.state == "damaged" and report.n_samples == 3000
    assert report.where == ["block 1: samples 1000 to 1999 differ from what was recorded"]
