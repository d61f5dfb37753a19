"""An error that no person's input should cause: its traceback goes into a file, and one line says where that lies."""

from __future__ import annotations

import platform
import sys
import tempfile
import traceback
from pathlib import Path
from typing import NoReturn

from bench.terminal.console import EXIT_FAILED, fail

DEFECTS = (ValueError, ArithmeticError, LookupError, TypeError, AttributeError)
"""What a library raises, and our own packages where they contradict themselves: never the caller's fault."""


def end_with_defect(error: Exception) -> NoReturn:
    """Write the traceback into a file of the system's folder for temporary ones, name it, and leave with status 1."""
    from bench import __version__

    call = " ".join(["bench", *sys.argv[1:]])
    about = f"shakerbench {__version__}, Python {platform.python_version()}, {platform.platform()}\n{call}\n\n"
    text = about + "".join(traceback.format_exception(error))
    try:
        with tempfile.NamedTemporaryFile(
            "w", encoding="utf-8", prefix="shakerbench-", suffix=".txt", delete=False
        ) as file:
            file.write(text)
        lies = f"its traceback is in {Path(file.name)}"
    except OSError:  # a full disk must not hide what failed
        sys.stderr.write(text)
        lies = "its traceback is above"
    made = "".join(f"\n{note}" for note in getattr(error, "__notes__", ()))
    fail(
        f"this is a defect of shakerbench, not of the call; {lies}: please report it with that file{made}", EXIT_FAILED
    )
