"""Text dialects: whatever the separators and decorations of a file, its numbers give the same recording."""

from __future__ import annotations

import gzip
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from daq.importers.formats.open import open_source
from daq.importers.import_recording import import_recording
from daq.recording import open_recording
from daq.setup.setup import Setup

RATE_HZ = 2000.0
NAMES = ("time_s", "continuity_v", "accelerometer_v", "drive_v")


@dataclass(frozen=True)
class Dialect:
    """How a table is written down."""

    delimiter: str
    decimal: str
    line_end: str
    encoding: str
    order: tuple[str, ...]
    title: bool
    comments: bool
    blank_lines: bool
    packed: bool


@st.composite
def dialects(draw: st.DrawFn) -> Dialect:
    """Any dialect; a decimal comma needs another delimiter."""
    delimiter = draw(st.sampled_from([",", ";", "\t"]))
    return Dialect(
        delimiter,
        "." if delimiter == "," else draw(st.sampled_from([".", ","])),
        draw(st.sampled_from(["\n", "\r\n"])),
        draw(st.sampled_from(["utf-8", "utf-8-sig", "utf-16"])),
        tuple(draw(st.permutations(NAMES))),
        draw(st.booleans()),
        draw(st.booleans()),
        draw(st.booleans()),
        draw(st.booleans()),
    )


def written(folder: Path, columns: Columns, dialect: Dialect) -> Path:
    """The table as a file."""
    rows = zip(*(columns[name] for name in dialect.order), strict=True)
    lines = ["Scope export"] * dialect.title + ["# taken today"] * dialect.comments
    lines.append(dialect.delimiter.join(dialect.order))
    lines += [dialect.delimiter.join(row).replace(".", dialect.decimal) for row in rows]
    if dialect.blank_lines:
        lines[-1:-1] = [""]
    data = (dialect.line_end.join(lines) + dialect.line_end).encode(dialect.encoding)
    path = folder / ("run.csv.gz" if dialect.packed else "run.csv")
    path.write_bytes(gzip.compress(data) if dialect.packed else data)
    return path


class Columns(dict[str, list[str]]):
    """Columns as text."""

    def __repr__(self) -> str:
        """The names alone."""
        return f"Columns({', '.join(self)})"


@pytest.fixture
def columns(ramp) -> Columns:
    """Two steps as text, six decimals."""
    drive_v = ramp([0.1, 0.3], [25.37, 25.37])
    values = {
        "time_s": np.arange(len(drive_v)) / RATE_HZ,
        "continuity_v": 5.0 * (drive_v > 0.25),
        "accelerometer_v": 0.2 * drive_v,
        "drive_v": drive_v,
    }
    return Columns({name: [f"{x:.6f}" for x in column] for name, column in values.items()})


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(dialect=dialects())
def test_any_dialect_gives_the_same_recording(setup: Setup, columns: Columns, dialect: Dialect) -> None:
    """Volts, times and steps are those of the numbers, to the last bit, in whatever dialect they are written."""
    with TemporaryDirectory() as folder:
        out = Path(folder) / "run.h5"
        summary = import_recording(open_source(written(Path(folder), columns, dialect)), out, setup, "")
        with open_recording(out) as recording:
            for name in recording.channels:
                expected = np.array([float(x) for x in columns[f"{name}_v"]])
                assert np.array_equal(recording.read_v(name), expected)
            assert recording.rate_hz == RATE_HZ and len(recording.steps) == 2
            assert recording.steps["gamma"] == pytest.approx([0.1, 0.3], rel=1e-3)  # half: two tones
    assert set(summary.columns) == {"time", "continuity", "accelerometer", "drive"}
