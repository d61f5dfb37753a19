"""Recordings: what was written is read, by us and by others, before and after the run has ended."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from daq.recording import CHANNELS, Block, BlockFlag, open_recording, verify
from daq.recording.writer import RecordingWriter
from daq.setup.errors import InputError
from daq.setup.setup import Setup


def write(
    path: Path, setup: Setup, sizes: list[int], lost: dict[int, int] | None = None, seed: int = 1
) -> tuple[RecordingWriter, np.ndarray]:
    """An open writer with blocks of ``sizes`` in it, and all the codes it was given."""
    rng = np.random.default_rng(seed)
    codes = rng.integers(-32768, 32767, (sum(sizes), 3), np.int16, endpoint=True)
    writer = RecordingWriter(
        path,
        setup,
        profile_text="name = 'test'\n",
        channels=CHANNELS,
        backend="simulated",
        simulated=True,
        note="knob at 3",
        extra={"temperature_degc": 21.5},
        scenario_sha256="ab" * 32,
    )
    first = 0
    for i, n in enumerate(sizes):
        gap = (lost or {}).get(i, 0)
        writer.append(Block(first, codes[first : first + n], flags=i % 2, clock_ns=1000 * i, lost_before=gap))
        first += n
    return writer, codes


def test_everything_written_comes_back(tmp_path: Path, setup: Setup) -> None:
    """Codes, volts, tables, note, free keys, hash and the way it ended survive the change from frames to columns."""
    writer, codes = write(tmp_path / "a.h5", setup, [100, 1, 5000, 70000])
    writer.mark_step({"first_sample": 0, "n_samples": 100, "gamma": 0.5, "frequency_hz": 25.37, "direction": 1})
    writer.mark_step({"first_sample": 100, "n_samples": 5001, "gamma": 0.6, "frequency_hz": 25.37})
    writer.close("stopped", "operator")
    with open_recording(tmp_path / "a.h5") as recording:
        assert recording.frames is None
        assert recording.n_samples == len(codes)
        for i, name in enumerate(recording.channels):
            np.testing.assert_array_equal(recording.codes(name), codes[:, i])
            np.testing.assert_allclose(recording.read_v(name, 50, 5000), codes[50:5000, i] * (10 / 32768), rtol=1e-15)
        assert recording.setup == setup
        assert recording.steps["gamma"].tolist() == [0.5, 0.6]
        assert np.isnan(recording.steps["achieved_gamma"]).all()
        assert recording.blocks["n_samples"].tolist() == [100, 1, 5000, 70000]
        assert recording.blocks["flags"].tolist() == [0, 1, 0, 1]
        attrs = recording.attrs
        assert (attrs["note"], attrs["extra"]) == ("knob at 3", {"temperature_degc": 21.5})
        assert (attrs["ended"], attrs["why"], attrs["simulated"]) == ("stopped", "operator", True)
        assert (attrs["scenario_sha256"], attrs["profile_text"]) == ("ab" * 32, "name = 'test'\n")


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(sizes=st.lists(st.integers(1, 3000), min_size=1, max_size=12), data=st.data())
def test_frames_and_columns_read_alike(tmp_path: Path, setup: Setup, sizes: list[int], data: st.DataObject) -> None:
    """Any range of any channel, and the times, are the same before and after `close`, with gaps anywhere."""
    path = tmp_path / "a.h5"
    path.unlink(missing_ok=True)
    lost = {i: data.draw(st.integers(0, 50)) for i in range(1, len(sizes))}
    start = data.draw(st.integers(0, sum(sizes)))
    writer, _ = write(path, setup, sizes, lost)
    with open_recording(path) as recording:
        assert recording.attrs["ended"] == "incomplete"
        before = [recording.codes(c, start, start + 777) for c in CHANNELS] + [recording.timestamps_ns(start)]
    writer.close()
    with open_recording(path) as recording:
        after = [recording.codes(c, start, start + 777) for c in CHANNELS] + [recording.timestamps_ns(start)]
        assert recording.gaps[:, 1].sum() == sum(lost.values())
    for left, right in zip(before, after, strict=True):
        np.testing.assert_array_equal(left, right)


def test_times_jump_over_gaps(tmp_path: Path, setup: Setup) -> None:
    """A gap of 7 samples moves every later time by 7 sample intervals, and the gap is declared where it is."""
    write(tmp_path / "a.h5", setup, [10, 10], {1: 7})[0].close()
    with open_recording(tmp_path / "a.h5") as recording:
        assert recording.gaps.tolist() == [[10, 7]]
        assert np.diff(recording.timestamps_ns(8, 12)).tolist() == [500_000, 4_000_000, 500_000]


def test_never_overwrites(tmp_path: Path, setup: Setup) -> None:
    """A second run cannot take the name of the first, whether that one is closed or still running."""
    writer, codes = write(tmp_path / "a.h5", setup, [10])
    with pytest.raises(InputError, match="never overwritten"):
        write(tmp_path / "a.h5", setup, [10])
    writer.close()
    with pytest.raises(InputError, match="never overwritten"):
        write(tmp_path / "a.h5", setup, [10])
    with open_recording(tmp_path / "a.h5") as recording:
        np.testing.assert_array_equal(recording.codes("drive"), codes[:, 2])


def test_missing_folder_is_refused(tmp_path: Path, setup: Setup) -> None:
    """The error names the folder that has to be made."""
    with pytest.raises(InputError, match="does not exist"):
        write(tmp_path / "none" / "a.h5", setup, [10])


def test_a_block_must_follow_the_one_before(tmp_path: Path, setup: Setup) -> None:
    """A block out of place, or with another number of channels, is refused and leaves the file as it was."""
    writer, codes = write(tmp_path / "a.h5", setup, [10])
    with pytest.raises(ValueError, match="starts at sample 10"):
        writer.append(Block(11, codes))
    with pytest.raises(ValueError, match="3 channels"):
        writer.append(Block(10, codes[:, :2]))
    writer.append(Block(10, codes))
    writer.close()
    assert verify(tmp_path / "a.h5").state == "complete"


def test_marking_a_step_again_replaces_it(tmp_path: Path, setup: Setup) -> None:
    """A step marked at its start and again at its end is one row, with what was achieved."""
    writer, _ = write(tmp_path / "a.h5", setup, [100])
    writer.mark_step({"first_sample": 0, "n_samples": 100, "gamma": 0.5})
    writer.mark_step({"first_sample": 0, "n_samples": 60, "gamma": 0.5, "achieved_gamma": 0.499})
    writer.close()
    with open_recording(tmp_path / "a.h5") as recording:
        assert recording.steps[["n_samples", "achieved_gamma"]].tolist() == [(60, 0.499)]
    with pytest.raises(ValueError, match="no field"):
        write(tmp_path / "b.h5", setup, [1])[0].mark_step({"gama": 0.5})


def test_an_exception_ends_the_recording_with_its_reason(tmp_path: Path, setup: Setup) -> None:
    """Leaving by Ctrl-C says stopped, by an error failed, and both recordings are whole."""
    for name, error, how in (("a.h5", KeyboardInterrupt(), "stopped"), ("b.h5", RuntimeError("card gone"), "failed")):
        with pytest.raises(type(error)), write(tmp_path / name, setup, [50])[0]:
            raise error
        with open_recording(tmp_path / name) as recording:
            assert recording.attrs["ended"] == how
        assert verify(tmp_path / name).state == "stopped"


def test_xarray_sees_volts_units_and_times(tmp_path: Path, setup: Setup) -> None:
    """xarray decodes the codes to volts on a time axis, with units and names, and reads the step table as a group."""
    writer, codes = write(tmp_path / "a.h5", setup, [300])
    writer.mark_step({"first_sample": 0, "n_samples": 300, "gamma": 0.5, "frequency_hz": 25.37})
    writer.close()
    with xarray.open_dataset(tmp_path / "a.h5", engine="h5netcdf") as data:
        assert data["drive"].dims == ("timestamp",)
        np.testing.assert_allclose(data["drive"], codes[:, 2] * (10 / 32768), rtol=1e-12)
        assert data["accelerometer"].attrs["units"] == "V"
        assert data["continuity"].attrs["long_name"] == "contact circuit voltage"
        np.testing.assert_array_equal(np.diff(data["timestamp"].values), np.timedelta64(500, "us"))
    with xarray.open_dataset(tmp_path / "a.h5", engine="h5netcdf", group="steps") as steps:
        assert steps["gamma"].item() == 0.5


def test_the_file_is_what_the_format_says(tmp_path: Path, setup: Setup) -> None:
    """Raw int16 codes, int64 nanoseconds, equal lengths, chunked, bitshuffle-LZ4 and fletcher32, dimension scales."""
    write(tmp_path / "a.h5", setup, [300])[0].close()
    with h5py.File(tmp_path / "a.h5") as file:
        for name in CHANNELS:
            dataset = file[name]
            assert dataset.dtype == np.dtype("<i2")
            assert dataset.shape == file["timestamp"].shape
            assert dataset.fletcher32
            assert "32008" in dataset._filters  # the registered number of bitshuffle
            assert dataset.attrs["scale_factor"] == 10 / 32768
            assert dataset.attrs["coupling"] == "dc"
            assert dataset.dims[0].keys() == ["timestamp"]
        assert file["timestamp"].dtype == np.dtype("<i8")


def test_unknown_channel_names_those_there_are(tmp_path: Path, setup: Setup) -> None:
    """Asking for a channel that is not there lists the ones that are."""
    write(tmp_path / "a.h5", setup, [3])[0].close()
    with open_recording(tmp_path / "a.h5") as recording, pytest.raises(InputError, match="continuity, accelerometer"):
        recording.read_v("acceleration")


def test_other_files_are_not_taken_for_recordings(tmp_path: Path) -> None:
    """No file, no HDF5, and HDF5 of somebody else are told apart."""
    with pytest.raises(InputError, match="no such file"):
        open_recording(tmp_path / "none.h5")
    (tmp_path / "text.h5").write_text("hello")
    with pytest.raises(InputError, match=r"cannot be read as HDF5.*bench import"):
        open_recording(tmp_path / "text.h5")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = [1, 2]
    with pytest.raises(InputError, match="bench import"):
        open_recording(tmp_path / "other.h5")


def test_block_flags_survive(tmp_path: Path, setup: Setup) -> None:
    """What a back end says of a block is in the block table."""
    writer, _ = write(tmp_path / "a.h5", setup, [5])
    writer.append(Block(5, np.zeros((5, 3), np.int16), flags=int(BlockFlag.CLIPPED | BlockFlag.OVERFLOW)))
    writer.close()
    with open_recording(tmp_path / "a.h5") as recording:
        assert BlockFlag(int(recording.blocks["flags"][1])) == BlockFlag.CLIPPED | BlockFlag.OVERFLOW
