"""Standard output and error that never end a command in a traceback: any code page, a full disk, a closed pipe.

A character that a console cannot show becomes the nearest plain one, or its escape. Output that
cannot be delivered ends the program with one line and status 1; messages that cannot be delivered end nothing.
"""

from __future__ import annotations

import codecs
import errno
import io
import os
import sys
import unicodedata
import warnings
from pathlib import Path
from typing import TextIO, cast

from bench.terminal.console import warn

FALLBACK = "nearest"
PLAIN = {
    "×": "x", "·": "*", "±": "+-", "−": "-", "–": "-", "—": "-", "…": "...", "≤": "<=", "≥": ">=", "≈": "~", "→": "->",
    "←": "<-", "↑": "up", "↓": "down", "°": " deg", "µ": "u", "μ": "u", "σ": "sigma", "Γ": "Gamma", "γ": "gamma",
    "φ": "phi", "τ": "tau", "ω": "omega", "π": "pi", "Δ": "Delta", "δ": "delta", "√": "sqrt", "∞": "inf", "•": "*",
    "‘": "'", "’": "'", "“": '"', "”": '"', "²": "^2", "³": "^3", "⁻": "^-", "\u00a0": " ", "\u202f": " ",
}  # fmt: skip


def nearest(error: UnicodeError) -> tuple[str, int]:
    """Replacement for characters that a console cannot show (an error handler of `codecs`)."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(_plain(sign) for sign in error.object[error.start : error.end]), error.end


def _plain(sign: str) -> str:
    """One character in ASCII."""
    if sign in PLAIN:
        return PLAIN[sign]
    if "\u2800" <= sign <= "\u28ff" or "\u2580" <= sign <= "\u25ff":
        return "*"  # braille and blocks of progress bars
    if "\u2500" <= sign <= "\u257f":
        return "-" if "HORIZONTAL" in unicodedata.name(sign) else "|"
    bare = unicodedata.normalize("NFKD", sign).encode("ascii", "ignore").decode()
    return bare or sign.encode("ascii", "backslashreplace").decode()


codecs.register_error(FALLBACK, nearest)


class SafeStream(io.TextIOWrapper):
    """A standard stream that shows what it can; ``vital`` is standard output, whose loss ends the program."""

    def __init__(self, stream: io.TextIOWrapper, *, vital: bool) -> None:
        super().__init__(
            stream.buffer, stream.encoding, FALLBACK, line_buffering=stream.line_buffering,
            write_through=stream.write_through,
        )  # fmt: skip
        self._vital, self._lost = vital, False

    def write(self, text: str) -> int:
        """Write, or leave with status 1 where standard output takes no more."""
        if self._lost:
            return len(text)
        try:
            return super().write(text)
        except OSError as error:
            self._give_up(error)
        return len(text)

    def flush(self) -> None:
        """Flush, or leave as `write` does."""
        if self._lost or self.closed:
            return
        try:
            super().flush()
        except OSError as error:
            self._give_up(error)

    def _give_up(self, error: OSError) -> None:
        """Send the rest nowhere; the end of standard output ends the program, without words where a reader left."""
        self._lost = True
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self.fileno())
        os.close(nowhere)
        if not self._vital:
            return
        # Windows reports a closed pipe as EINVAL
        if error.errno not in (errno.EPIPE, errno.EINVAL):
            sys.stderr.write(f"error: standard output cannot be written ({error.strerror}); free some space\n")
        raise SystemExit(1)


def make_safe() -> None:
    """Put safe streams in place of standard output and error; warnings of libraries become one line each."""
    for name, vital in (("stderr", False), ("stdout", True)):
        stream = getattr(sys, name)
        if stream is None:  # closed by whoever started this
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115 (open to the end)
        if isinstance(stream, io.TextIOWrapper) and not isinstance(stream, SafeStream):
            setattr(sys, name, cast(TextIO, SafeStream(stream, vital=vital)))
    if not sys.warnoptions:
        # a number that is not finite is answered where it matters; the line of a library helps no one at a bench
        warnings.simplefilter("ignore", RuntimeWarning)
        warnings.showwarning = lambda message, *_, **__: warn(" ".join(str(message).split()))
