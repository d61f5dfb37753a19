"""Damaged recordings read in this process instead of one of their own: for a simulation, of files that HDF5 survives.

Decision 461.
"""

from __future__ import annotations

import importlib
import json
import pkgutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

from daq.recording.opening import Answer
from daq.setup.errors import InputError


def _here(function: str, *arguments: Any) -> Answer:
    """As `daq.recording.opening.in_subprocess`."""
    said = [""]
    try:
        return Answer(json.loads(json.dumps(pkgutil.resolve_name(function)(*arguments, said.append))))
    except (RuntimeError, LookupError, ValueError, TypeError, AttributeError) as error:
        if isinstance(error, InputError):
            raise
        return Answer(None, f"reading it ended ({error})", said[-1])


@contextmanager
def read_here() -> Iterator[None]:
    """Read all files in this process for the length of a block."""
    verify, header = (importlib.import_module(f"daq.recording.{name}") for name in ("verify", "header"))
    with patch.object(verify, "in_subprocess", _here), patch.object(header, "in_subprocess", _here):
        yield
