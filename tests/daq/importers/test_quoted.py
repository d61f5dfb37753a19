"""Tables whose fields stand in quotes: the same numbers as without, or an error with line and column."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from daq.importers.formats.open import open_source
from daq.setup.errors import InputError
from kernels.arrays import Floats

NAMES = ("time_s", "accelerometer_v", "drive_v")


@pytest.fixture
def table() -> Floats:
    """Six-digit numbers of both signs."""
    rng = np.random.default_rng(3)
    return np.round(np.column_stack([np.arange(500) / 2000.0, rng.normal(0, 3, (500, 2))]), 6)


def read(path: Path, names: tuple[str, ...] = NAMES) -> Floats:
    """The columns of a file."""
    pieces = [np.column_stack([piece.columns[n] for n in names]) for piece in open_source(path).pieces(names)]
    return np.concatenate(pieces)


def written(path: Path, table: Floats, delimiter: str, field: Callable[[int, str], str]) -> Path:
    """The table with a header in quotes; ``field`` says how a number of a column stands there."""
    lines = [delimiter.join(f'"{name}"' for name in NAMES)]
    lines += [delimiter.join(field(i, f"{v:.6f}") for i, v in enumerate(row)) for row in table.tolist()]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
def test_every_field_in_quotes(tmp_path: Path, table: Floats, delimiter: str) -> None:
    """Numbers in quotes are numbers, whatever separates them, and so is a column that alone is quoted."""
    every = written(tmp_path / "a.csv", table, delimiter, lambda _, text: f'"{text}"')
    one = written(tmp_path / "b.csv", table, delimiter, lambda i, text: f'"{text}"' if i == 1 else text)
    for path in (every, one):
        np.testing.assert_array_equal(read(path), table)


@pytest.mark.parametrize("delimiter", [",", ";"])
def test_decimal_commas_in_quotes(tmp_path: Path, table: Floats, delimiter: str) -> None:
    """Within quotes a comma is a decimal point, also where commas separate the columns."""
    path = written(tmp_path / "a.csv", table, delimiter, lambda _, text: f'"{text.replace(".", ",")}"')
    np.testing.assert_array_equal(read(path), table)


def test_a_comma_within_a_title(tmp_path: Path, table: Floats) -> None:
    """A title in quotes may hold what separates the columns."""
    path = written(tmp_path / "a.csv", table, ",", lambda _, text: f'"{text}"')
    path.write_text(path.read_text().replace('"drive_v"', '"drive, looped back"'))
    np.testing.assert_array_equal(read(path, (*NAMES[:2], "drive, looped back")), table)


def test_what_is_no_number_in_quotes_is_named(tmp_path: Path, table: Floats) -> None:
    """The error says file, line, column and what stands there."""
    path = written(tmp_path / "a.csv", table, ",", lambda _, text: f'"{text}"')
    lines = path.read_text().split("\n")
    lines[7] = '"0.003","open","1.0"'
    path.write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"a\.csv: line 8, column accelerometer_v: wanted a number, got 'open'"):
        read(path)
