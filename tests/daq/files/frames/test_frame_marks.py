"""Marks in a frames file: pages by which its rows and frames are found without HDF5."""

from __future__ import annotations

import zlib

import numpy as np

from daq.files.frames.marked_frames import MarkLog, piece_rows, read_marks, running_crcs
from daq.files.tables import BLOCK_DTYPE, STEP_DTYPE, step_row

CODES = np.random.default_rng(1).integers(-999, 999, (1000, 3), np.int16)


def log_of(n_blocks: int, n_samples: int = 100) -> MarkLog:
    """A log with blocks of ``n_samples`` that follow each other."""
    log = MarkLog({"rate_hz": np.float64(2000.0), "note": "n"}, 3, 1000)
    log.add_chunk(4711)
    for i in range(n_blocks):
        row = np.zeros(1, BLOCK_DTYPE)
        row["first_sample"], row["n_samples"] = i * n_samples, n_samples
        log.add_block(i, row, running_crcs(CODES[:n_samples]))
    return log


def test_what_is_put_in_comes_out_of_any_bytes() -> None:
    """Attributes, places, rows and checksums are read back from pages that stand anywhere between other bytes."""
    log = log_of(3)
    log.add_rows("steps", 0, step_row({"first_sample": 0, "gamma": 0.5}))
    log.add_rows("steps", 0, step_row({"first_sample": 0, "gamma": 0.75}))
    marks = read_marks(b"x" * 77 + b"\0\1".join(log.pages()) + b"y" * 5)
    assert marks is not None
    assert marks.attributes == {"rate_hz": 2000.0, "note": "n"}
    assert (marks.n_channels, marks.chunk_rows, marks.addresses, marks.n_damaged) == (3, 1000, {0: 4711}, 0)
    assert [int(row["first_sample"][0]) for row in marks.rows["blocks"].values()] == [0, 100, 200]
    assert marks.rows["steps"][0].dtype == STEP_DTYPE
    assert float(marks.rows["steps"][0]["gamma"][0]) == 0.75
    assert marks.crcs[2][-1] == zlib.crc32(CODES[:100].tobytes())
    assert read_marks(b"no marks in here") is None


def test_many_rows_take_several_pages() -> None:
    """More rows than a page can hold go on in the next one, and none is lost."""
    log = log_of(500, 20)
    pages = log.pages()
    assert len(pages) > 1
    marks = read_marks(b"".join(pages))
    assert marks is not None
    assert list(marks.rows["blocks"]) == list(range(500))


def test_each_row_stands_in_two_marks() -> None:
    """With any page of a log zeroed, every row is still there once the next one has been written."""
    log, pages = log_of(0), []
    for i in range(5):
        row = np.zeros(1, BLOCK_DTYPE)
        row["first_sample"], row["n_samples"] = i * 100, 100
        log.add_block(i, row, running_crcs(CODES[:100]))
        pages += log.pages()
    pages += log.pages()
    for gone in range(len(pages)):
        marks = read_marks(b"".join(page if i != gone else bytes(len(page)) for i, page in enumerate(pages)))
        assert marks is not None
        assert sorted(marks.rows["blocks"]) == [0, 1, 2, 3, 4]


def test_a_changed_page_does_not_count() -> None:
    """Of a page in which a bit differs nothing is taken; it is counted."""
    first, second = bytearray(log_of(1).pages()[0]), log_of(2).pages()[0]
    first[200] ^= 1
    marks = read_marks(bytes(first) + second)
    assert marks is not None
    assert (len(marks.rows["blocks"]), marks.n_damaged) == (2, 1)
    assert read_marks(bytes(first)) is None


def test_each_piece_of_a_block_is_checked_by_itself() -> None:
    """The running CRC-32 of one piece, begun with that of the piece before, gives its own; long blocks have 256."""
    crcs, step = running_crcs(CODES), piece_rows(1000, 3)
    assert crcs[-1] == zlib.crc32(CODES.tobytes())
    assert zlib.crc32(CODES[5 * step : 6 * step].tobytes(), crcs[4]) == crcs[5]
    assert len(running_crcs(np.zeros((65536, 3), np.int16))) == 256
