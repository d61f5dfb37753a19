"""The record of decisions: every entry is complete and stands in the index."""

from __future__ import annotations

import re
from pathlib import Path

FOLDER = Path(__file__).parents[2] / "docs" / "decisions"
PAGES = sorted(p for p in FOLDER.glob("*.md") if p.name != "index.md")
ENTRY = re.compile(r"^## (\d+)\. ([^\n]+)\n\n(.*?)(?=^## |\Z)", re.MULTILINE | re.DOTALL)


def test_every_decision_is_dated_and_says_what_was_rejected() -> None:
    """Each entry has a date, a status, what was decided, why, and the alternative that was not taken."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        entries = ENTRY.findall(text)
        assert len(entries) == len(re.findall(r"^## ", text, re.MULTILINE)) > 0
        for number, _, body in entries:
            assert re.match(r"\d{4}-\d\d-\d\d, (accepted|replaced)\b", body), number
            parts = re.findall(r"^\*\*(Decided|Why|Rejected)\*\*: \S", body, re.MULTILINE)
            assert parts == ["Decided", "Why", "Rejected"], number


def test_every_decision_stands_in_the_index() -> None:
    """The index has one row an entry, with its number, title and page, in the order of the numbers."""
    rows = re.findall(r"^\| (\d+) \| \[(.+)\]\((\w+\.md)#", (FOLDER / "index.md").read_text("utf-8"), re.MULTILINE)
    entries = [(n, title, page.name) for page in PAGES for n, title, _ in ENTRY.findall(page.read_text("utf-8"))]
    assert rows == sorted(entries, key=lambda entry: int(entry[0]))
