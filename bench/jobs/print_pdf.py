"""A page on paper: through a headless Chromium (Chrome, Edge), or WeasyPrint where no browser is there."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from daq.files.whole_file import whole
from daq.setup.errors import InputError

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")
PLACES = (  # where the installers of macOS and Windows put one
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
    "/Applications/Microsoft Edge.app/Contents/MacOS/Microsoft Edge",
    "C:/Program Files/Google/Chrome/Application/chrome.exe",
    "C:/Program Files (x86)/Google/Chrome/Application/chrome.exe",
    "C:/Program Files (x86)/Microsoft/Edge/Application/msedge.exe",
)
LONGEST_S = 180.0


def browser() -> str | None:
    """A browser that prints without a window, or None."""
    named = (shutil.which(name) for name in BROWSERS)
    return next((found for found in (*named, *PLACES) if found and Path(found).is_file()), None)


def refuse_without_printer() -> None:
    """Refuse early where nothing can make a PDF (raises InputError)."""
    if browser() is not None:
        return
    try:
        import weasyprint  # noqa: F401
    except (ImportError, OSError) as error:  # OSError: the libraries behind it are not there
        raise InputError(
            "--pdf: neither Chromium, Chrome or Edge nor WeasyPrint was found; install one of them, or open the page "
            "in any browser and print it to a PDF"
        ) from error


def print_pdf(page: Path, pdf: Path) -> None:
    """Print the page ``page`` to ``pdf``, which appears only when it is whole.

    Raises
    ------
    InputError
        When nothing can print it, or the printing failed.
    """
    refuse_without_printer()
    found = browser()
    with whole(pdf) as part, tempfile.TemporaryDirectory() as folder:
        if found is None:
            from weasyprint import HTML

            HTML(filename=str(page)).write_pdf(str(part))
            return
        made = Path(folder) / "page.pdf"
        root = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []  # Chromium refuses root one
        call = [
            found, "--headless", *root, "--disable-gpu", "--disable-extensions", "--disable-dev-shm-usage",
            f"--user-data-dir={Path(folder) / 'profile'}", "--no-first-run", "--no-pdf-header-footer",
            f"--print-to-pdf={made}", page.resolve().as_uri(),
        ]  # fmt: skip
        try:
            done = subprocess.run(
                call, capture_output=True, text=True, errors="replace", timeout=LONGEST_S, check=False
            )
        except subprocess.TimeoutExpired:
            raise InputError(
                f"{page}: {found} did not print it in {LONGEST_S:.0f} s; print it from a browser"
            ) from None
        if done.returncode != 0 or not made.is_file():
            last = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
            raise InputError(
                f"{page}: {found} could not print it ({last}); open the page in a browser and print it there"
            )
        shutil.copyfile(made, part)
