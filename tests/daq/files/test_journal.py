"""Rows that survive: cut-off lines, another program's files, repeated keys."""

import pytest

from daq.files.disk import Journal
from daq.setup.errors import InputError


def test_rows_are_there_when_the_program_is_not(tmp_path):
    """What was added is read again by the next program; the last row of a key counts."""
    first = Journal(tmp_path / "rows")
    first.add("a", {"x": 1})
    first.add("b", {"x": 2.5, "why": "no\nfile"})
    first.add("a", {"x": 3})
    assert Journal(tmp_path / "rows").rows == {"a": {"x": 3}, "b": {"x": 2.5, "why": "no\nfile"}}


@pytest.mark.parametrize("cut", [1, 5, 20])
def test_a_line_that_was_cut_off_costs_no_other(cut, tmp_path):
    """Killed while writing: the half line is left out, and the next row does not join it."""
    path = tmp_path / "rows"
    journal = Journal(path)
    journal.add("a", {"x": 1})
    journal.add("b", {"x": 2})
    path.write_bytes(path.read_bytes()[:-cut])
    again = Journal(path)
    assert again.rows == {"a": {"x": 1}}
    again.add("c", {"x": 3})
    assert Journal(path).rows == {"a": {"x": 1}, "c": {"x": 3}}


def test_a_file_of_another_kind_is_refused(tmp_path):
    """The error names the file and the line."""
    (tmp_path / "rows").write_text("time,volts\n1,2\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"rows, line 1: wanted a result"):
        Journal(tmp_path / "rows")
