"""Errors at the edges: what a person handed in cannot be used."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from kernels.errors import InputError as InputError  # everybody above the model takes it from here


def require_file(path: Path) -> None:
    """Refuse a path that is a folder, or where nothing is (raises InputError)."""
    if not path.is_file():
        raise InputError(f"{path}: {'is a folder; wanted a file' if path.is_dir() else 'no such file'}")


@contextmanager
def package(name: str, wanted_by: str) -> Iterator[None]:
    """Say what to install where an import in it fails; ``wanted_by`` is as ``TDMS needs`` (raises InputError)."""
    try:
        yield
    except ImportError as error:
        raise InputError(
            f"{wanted_by} the package {name}: pip install {name}, or pip install 'shakerbench[interchange]'"
        ) from error
