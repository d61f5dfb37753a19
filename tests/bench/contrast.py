"""Contrast of all text of a page, as WCAG 2.2 (success criterion 1.4.3) computes it.

Our own forty lines and not axe-core: that would have to be fetched when the tests run, or be kept here with its half a
megabyte; it leaves out text
over a gradient, and neither can look into a canvas, whose two colours of words are therefore checked by name.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

LEAST, LEAST_LARGE = 4.5, 3.0
ON_CANVAS = ("ink", "faint")  # colours of words on the canvases' paper

SCRIPT = Path(__file__).with_suffix(".js").read_text(encoding="utf-8")


def too_pale(page: Any) -> list[str]:
    """Text of the page, and colours of words on its canvases, whose contrast is too low; in the light and the dark."""
    found = []
    for theme in ("light", "dark"):
        page.evaluate("(theme) => { document.documentElement.dataset.theme = theme; }", theme)
        found += [f"{theme}: {one}" for one in page.evaluate(SCRIPT, [LEAST, LEAST_LARGE, list(ON_CANVAS)])]
    return found
