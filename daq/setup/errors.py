"""Errors at the edges: what a person handed in cannot be used."""

from __future__ import annotations

from pathlib import Path


class InputError(ValueError):
    """Bad input: the message names the file, the place, what was wanted, what came and what to do."""


def require_file(path: Path) -> None:
    """Refuse a path that is a folder, or where nothing is (raises InputError)."""
    if not path.is_file():
        raise InputError(f"{path}: {'is a folder; wanted a file' if path.is_dir() else 'no such file'}")
