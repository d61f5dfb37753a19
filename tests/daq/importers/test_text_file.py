"""Text read once, in blocks of whole lines, and ahead: nothing is lost or doubled between them."""

from __future__ import annotations

import gzip
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from daq.importers.text import text_file
from daq.importers.text.csv import ahead
from daq.importers.text.text_file import LongLineError, TextFile


@pytest.mark.parametrize("end", ["\n", "", "\n\n", "x" * 70])
def test_blocks_are_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, end: str) -> None:
    """Blocks of whole lines, one after the other, are what follows the lines read before; only a newline may be new."""
    monkeypatch.setattr(text_file, "_BLOCK_BYTES", 100)
    text = "head\n" + "".join(f"{'7' * (i % 50)}\n" for i in range(400)) + end
    path = tmp_path / "a.csv"
    path.write_text(text)
    with TextFile(path) as file:
        assert file.readline() == b"head\n"
        blocks = [bytes(block) for block in file.blocks()]
        assert all(block.endswith(b"\n") for block in blocks)
        assert b"".join(blocks).decode() == text[5:] + ("" if text.endswith("\n") else "\n")


def test_a_packed_or_recoded_text_is_the_same(tmp_path: Path) -> None:
    """Whatever the packing and the encoding, lines come as UTF-8 without a mark."""
    (tmp_path / "a.csv.gz").write_bytes(gzip.compress(b"1,2\n"))
    (tmp_path / "b.csv").write_text("1,2\n", encoding="utf-16")
    (tmp_path / "c.csv").write_text("1,2\n", encoding="utf-8-sig")
    for name in ("a.csv.gz", "b.csv", "c.csv"):
        with TextFile(tmp_path / name) as file:
            assert b"".join(map(bytes, file.blocks())) == b"1,2\n"


def test_a_line_longer_than_any_row(tmp_path: Path) -> None:
    """Whole lines before it come first, then the error."""
    path = tmp_path / "a.csv"
    path.write_bytes(b"1,2\n" + b"3" * 5_000_000)
    with TextFile(path) as file:
        blocks = file.blocks()
        assert bytes(next(blocks)) == b"1,2\n"
        with pytest.raises(LongLineError):
            next(blocks)


def test_reading_ahead_keeps_order_and_errors() -> None:
    """Items come in order, an error after those before it, and one that stops early leaves no thread."""

    def items() -> Iterator[int]:
        yield from range(5)
        raise ValueError("the sixth")

    seen = []
    with pytest.raises(ValueError, match="the sixth"):
        for item in ahead(items()):
            seen.append(item)
    assert seen == [0, 1, 2, 3, 4]
    early = ahead(items())
    assert next(early) == 0
    early.close()  # type: ignore[attr-defined]
    assert not [t for t in threading.enumerate() if t.name.startswith("reading ahead")]
