"""What every picture of a recording shares: colours for measured and predicted, the badge, saving.

The rule kept here: measured is always dark dots, predicted always the light line or cloud beneath them, and a badge on
each picture says whether the rig was simulated.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from daq.recording import Recording
from daq.recording.whole_file import whole
from daq.setup.errors import InputError

Floats = npt.NDArray[np.float64]

MEASURED = "#12355b"
BEFORE, AFTER, FLOOR = "#e07a5f", "#12355b", "#8d99ae"  # of the closed loop: declared model, improved model, noise
DOUBTFUL = "#b5651d"
MODEL = "#e07a5f"
ZONE = "#f2d0a4"
PLATE = "#5c677d"
CONTACT = "#dfe7ef"
STYLE: dict[Any, Any] = {
    "font.family": "serif",
    "mathtext.fontset": "cm",
    "font.size": 10,
    "axes.linewidth": 0.8,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "figure.constrained_layout.use": True,
    "savefig.dpi": 160,
    "svg.fonttype": "none",
}
FORMATS = ("png", "svg")


def badge_of(recording: Recording) -> str:
    """What the badge says: simulated or real, and which recording."""
    rig = "SIMULATED RIG" if recording.attrs.get("simulated") else "measured on a rig"
    return f"{rig}: {recording.path.name}"


@contextmanager
def figure(folder: Path, name: str, badge: str, **options: Any) -> Iterator[tuple[Any, Any]]:
    """A figure and its axes; saved as PNG and SVG in ``folder`` at the end.

    Raises
    ------
    InputError
        When the folder cannot be written.
    """
    import matplotlib
    from matplotlib.figure import Figure

    size = options.pop("figsize", None)
    with matplotlib.rc_context(STYLE):
        drawn = Figure(figsize=size)
        axes = drawn.subplots(**options)
        try:
            yield drawn, axes
            colour = "#a4161a" if badge.startswith("SIMULATED") else "#2d6a4f"
            drawn.text(
                0.993,
                1.0 - 0.07 / drawn.get_figheight(),
                badge,
                ha="right",
                va="top",
                fontsize=8,
                color="white",
                weight="bold",
                bbox={"boxstyle": "round,pad=0.3", "facecolor": colour, "edgecolor": "none"},
            )
            layout: Any = drawn.get_layout_engine()
            layout.set(rect=(0.0, 0.0, 1.0, 1.0 - 0.32 / drawn.get_figheight()))
            folder.mkdir(parents=True, exist_ok=True)
            for form in FORMATS:
                with whole(folder / f"{name}.{form}") as part:
                    drawn.savefig(part, format=form)
        except OSError as error:
            raise InputError(f"{folder}: cannot write {name} ({error}); name a folder you can write to") from error


def clipped_dots(ax: Any, x: Floats, y: Floats, limit: float, **style: Any) -> int:
    """Dots within ``+-limit``; what lies beyond stands at the edge as a triangle that points outwards.

    Returns
    -------
    int
        How many lie beyond.
    """
    above, below = y > limit, y < -limit
    inside = ~above & ~below
    ax.plot(x[inside], y[inside], ".", ms=4.5, mew=0, alpha=0.6, **style)
    for rows, mark, edge in ((above, "^", limit), (below, "v", -limit)):
        at = np.full(int(rows.sum()), 0.95 * edge)
        ax.plot(x[rows], at, mark, ms=4.5, mfc="none", mew=0.8, clip_on=False, **style)
    return int(above.sum() + below.sum())
