"""Files as laboratories lay them out: a channel in each row, structures, times rounded by digits or type."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from daq.importers.formats.open import open_source
from daq.importers.import_recording import ImportOptions, import_recording
from daq.importers.plausibility import refuse_mixed_rates
from daq.importers.text.csv import _number
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from kernels.arrays import Floats

MATRIX = np.arange(300.0).reshape(3, 100) + 0.25
Writer = Callable[[Path], object]


def _hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["run/X"] = MATRIX


@pytest.mark.parametrize(
    ("ending", "write", "name"),
    [
        (".h5", _hdf5, "run/X"),
        (".npz", lambda path: np.savez(path, X=MATRIX), "X"),
        (".npz", lambda path: np.savez(path, X=np.asfortranarray(MATRIX)), "X"),
        (".npz", lambda path: np.savez(path, X=MATRIX.T), "X"),
        (".npz", lambda path: np.savez_compressed(path, X=MATRIX.T.copy()), "X"),
        (".mat", lambda path: savemat(path, {"X": MATRIX}), "X"),
        (".mat", lambda path: savemat(path, {"rec": {"raw": {"X": MATRIX.T}, "fs": 20e3, "by": "us"}}), "rec/raw/X"),
    ],
)
def test_a_matrix_is_read_whichever_way_its_channels_lie(tmp_path: Path, ending: str, write: Writer, name: str) -> None:
    """Three channels of 100 samples, in rows or in columns, in memory in either order, come in as three columns."""
    path = tmp_path / f"a{ending}"
    write(path)
    source = open_source(path)
    columns = [f"{name}[{k}]" for k in range(3)]
    piece = next(iter(source.pieces(columns)))
    np.testing.assert_array_equal([piece.columns[column] for column in columns], MATRIX)
    assert source.rate_hz == (20e3 if "rec" in name else None)


@pytest.mark.parametrize("digits", [5, 6, 7])
def test_times_written_with_so_many_digits_are_even(tmp_path: Path, setup: Setup, digits: int) -> None:
    """Times of 15 s at 2 kHz with five to seven digits, of which many come twice, are 2 kHz with no gap."""
    time = np.arange(30_000) / 2000.0
    text = "time,accelerometer_v\n" + "".join(f"{t:.{digits}g},{np.sin(160.0 * t):.4f}\n" for t in time)
    (path := tmp_path / "a.csv").write_text(text)
    base = import_recording(open_source(path), tmp_path / "a.h5", setup, "", ImportOptions()).timebase
    assert (base.rate_hz, base.uniform, len(base.gaps)) == (pytest.approx(2000.0, rel=1e-4), True, 0)


def test_times_of_single_precision_are_of_one_rate(tmp_path: Path) -> None:
    """At 600 s steps of 50 us come as 61 or 0 us; a file of two rates, so rounded, is still refused."""

    def given(steps: Floats) -> None:
        times = np.round((600.0 + np.cumsum(steps)).astype(np.float32).astype(float), 6)
        refuse_mixed_rates(tmp_path / "a.csv", lambda a, b: times[a:b], len(times), 1e-6)

    given(np.full(100_000, 5e-5))
    with pytest.raises(InputError, match="mixed rates"):
        given(np.repeat([5e-5, 1e-4], 50_000))


def test_a_time_of_day_counts_from_midnight() -> None:
    """Loggers that write no date give seconds since midnight."""
    assert _number("00:01:02.500050", None) == pytest.approx(62.50005, abs=1e-9)
    assert _number("00:01:02,500050", ",") == pytest.approx(62.50005, abs=1e-9)
    assert _number("12:61:00", None) is None
