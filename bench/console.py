"""What every command shares: exit codes, error lines, tables for a person and JSON for a machine.

The rule kept here: exit 0 the job was done, 1 the run failed, 2 the call was wrong.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any, NoReturn

EXIT_FAILED = 1
EXIT_USAGE = 2


def fail(message: str, code: int = EXIT_FAILED) -> NoReturn:
    """Print an error that a person can act on, to standard error, and leave with ``code``."""
    sys.stderr.write(f"error: {message}\n")
    raise SystemExit(code)


def warn(message: str) -> None:
    """Print something to mind, to standard error, and go on."""
    sys.stderr.write(f"warning: {message}\n")


def write_json(payload: Any, target: str | None) -> None:
    """Write ``payload`` as JSON to the file ``target``, or to standard output when it is ``-``; nothing when None."""
    if target is None:
        return
    text = json.dumps(payload, indent=1, allow_nan=False, default=_plain) + "\n"
    if target == "-":
        sys.stdout.write(text)
    else:
        Path(target).write_text(text, encoding="utf-8")


def _plain(value: Any) -> Any:
    """Numpy scalars and arrays, paths and dates as JSON knows them."""
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "isoformat"):
        return value.isoformat()
    raise TypeError(f"cannot write {type(value).__name__} as JSON")
