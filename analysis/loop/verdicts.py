"""The three verdicts and their words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

Verdict = Literal["explained", "unexplained", "nothing_missing"]

VERDICTS: Mapping[Verdict, str] = {
    "explained": "Explained",
    "unexplained": "Unexplained: something is left that no named effect accounts for",
    "nothing_missing": "Nothing is missing: the declared model explains the recording",
}


def short_verdict(verdict: str) -> str:
    """A verdict in one or two words: ``nothing missing``."""
    return verdict.replace("_", " ")
