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

from daq.errors import InputError
from daq.recording import Recording

Floats = npt.NDArray[np.float64]

MEASURED = "#12355b"
DOUBTFUL = "#b5651d"
MODEL = "#e07a5f"
ZONE = "#f2d0a4"
PLATE = "#5c677d"
CONTACT = "#dfe7ef"
STYLE: dict[Any, Any] = {
    "font.family": "serif", "mathtext.fontset": "cm", "font.size": 10, "axes.linewidth": 0.8, "xtick.direction": "in",
    "ytick.direction": "in", "figure.constrained_layout.use": True, "savefig.dpi": 160, "svg.fonttype": "none",
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

    matplotlib.use("Agg")
    from matplotlib import pyplot

    with matplotlib.rc_context(STYLE):
        drawn, axes = pyplot.subplots(**options)
        try:
            yield drawn, axes
            colour = "#a4161a" if badge.startswith("SIMULATED") else "#2d6a4f"
            drawn.text(
                0.993, 1.0 - 0.07 / drawn.get_figheight(), badge, ha="right", va="top", fontsize=8, color="white",
                weight="bold",
                bbox={"boxstyle": "round,pad=0.3", "facecolor": colour, "edgecolor": "none"},
            )
            drawn.get_layout_engine().set(rect=(0.0, 0.0, 1.0, 1.0 - 0.32 / drawn.get_figheight()))
            folder.mkdir(parents=True, exist_ok=True)
            for form in FORMATS:
                drawn.savefig(folder / f"{name}.{form}")
        except OSError as error:
            raise InputError(f"{folder}: cannot write {name} ({error}); name a folder you can write to") from error
        finally:
            pyplot.close(drawn)


def gamma_axis(ratio: int, gamma: Floats, peak: Floats) -> tuple[Floats, str]:
    """What runs along the horizontal axis: ``gamma_peak`` at c = 1 (the paper's experimental axis), else ``gamma``."""
    if ratio == 1:
        return peak, r"$\Gamma_{\mathrm{peak}} = \max(-\ddot{x}_p)/g$   (c = 1)"
    return gamma, rf"$\Gamma = A\omega^2/g$   (c = {ratio})"
