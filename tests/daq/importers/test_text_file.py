"""Text read once, in blocks of whole lines: nothing is lost or doubled between them, and the hash is the file's."""

from __future__ import annotations

import gzip
import hashlib
from pathlib import Path

import pytest

from daq.importers.text import text_file
from daq.importers.text.text_file import LongLineError, TextFile


@pytest.mark.parametrize("end", ["\n", "", "\n\n", "x" * 70])
def test_blocks_are_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, end: str) -> None:
    """Blocks of whole lines, one after the other, are what follows the lines read before; only a newline may be new."""
    monkeypatch.setattr(text_file, "_BLOCK_BYTES", 100)
    text = "head\n" + "".join(f"{'7' * (i % 50)}\n" for i in range(400)) + end
    path = tmp_path / "a.csv"
    path.write_text(text)
    with TextFile(path) as file:
        assert file.readline(100) == b"head\n"
        blocks = [bytes(block) for block in file.blocks()]
        assert all(block.endswith(b"\n") for block in blocks)
        assert b"".join(blocks).decode() == text[5:] + ("" if text.endswith("\n") else "\n")
        assert file.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_a_hash_of_what_was_not_read_as_it_is_is_left_to_others(tmp_path: Path) -> None:
    """A packed or recoded file has no hash here; a byte-order mark belongs to the hash and not to the text."""
    (tmp_path / "a.csv.gz").write_bytes(gzip.compress(b"1,2\n"))
    (tmp_path / "b.csv").write_text("1,2\n", encoding="utf-16")
    (tmp_path / "c.csv").write_text("1,2\n", encoding="utf-8-sig")
    hashes = []
    for name in ("a.csv.gz", "b.csv", "c.csv"):
        with TextFile(tmp_path / name) as file:
            assert b"".join(map(bytes, file.blocks())) == b"1,2\n"
            hashes.append(file.sha256)
    assert hashes == ["", "", hashlib.sha256((tmp_path / "c.csv").read_bytes()).hexdigest()]


def test_a_line_longer_than_any_row(tmp_path: Path) -> None:
    """Whole lines before it come first, then the error."""
    path = tmp_path / "a.csv"
    path.write_bytes(b"1,2\n" + b"3" * 5_000_000)
    with TextFile(path) as file:
        blocks = file.blocks()
        assert bytes(next(blocks)) == b"1,2\n"
        with pytest.raises(LongLineError):
            next(blocks)
