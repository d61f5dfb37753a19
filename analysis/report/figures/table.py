"""The table of figures, which `bench report`, `bench reprocess --figures` and the page of a closed loop draw."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

from analysis.loop.result import ClosedLoop
from analysis.report.figures.flights import draw_bifurcations, draw_history, draw_return_maps, draw_trajectory
from analysis.report.figures.loop import draw_candidates, draw_discovery, draw_errors
from analysis.report.figures.measured import Measured
from analysis.report.figures.plate import draw_plate
from analysis.report.figures.residuals import draw_landings, draw_plate_residuals, draw_takeoffs

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

Draw = Callable[["Canvas"], None]


@dataclass(frozen=True)
class Figure:
    """A figure.

    Attributes
    ----------
    name
        Of its files and of its element in the page.
    draw
        Draws on an empty figure: from a `Measured`, or from a `ClosedLoop` where ``needs`` says so. What draws no axes
        is left out.
    needs
        ``recording``, ``flights`` (a recording in which some were seen) or ``loop``.
    place
        Part of the page; figures of one part stand in the order of the table.
    caption
        One or two sentences.
    """

    name: str
    draw: Callable[[Any, Canvas], None]
    needs: Literal["recording", "flights", "loop"]
    place: Literal["flights", "plate", "errors", "why", "residuals"]
    caption: str


FIGURES = (
    Figure(
        "bifurcation", draw_bifurcations, "flights", "flights",
        "Bifurcation diagram: flight times against gamma, measured (dark dots; crosses: double hit or unsure) over the "
        "prediction for the plate's motion as measured (light). Shaded: flight times forbidden to the ideal ball.",
    ),
    Figure(
        "return_maps", draw_return_maps, "flights", "flights",
        "Return maps of the steps with most modes: each flight time against the one before (dots), and the predicted "
        "cycle (open squares).",
    ),
    Figure(
        "history", draw_history, "flights", "flights",
        "Flight times in order of time. Bars: the predicted cycle of each step. Plus signs: the step still settles.",
    ),
    Figure(
        "trajectory", draw_trajectory, "flights", "flights",
        "Plate and ball over a few periods, with the contact voltage below.",
    ),
    Figure(
        "plate", draw_plate, "recording", "plate",
        "The plate's gain and lag against the drive, one period of its acceleration, and its harmonics.",
    ),
    Figure(
        "errors", draw_errors, "loop", "errors",
        "Landing error of each step (robust), before (open squares) and after (dots), with the noise floor. Diamonds: "
        "held-out steps.",
    ),
    Figure(
        "candidates", draw_candidates, "loop", "why",
        "Candidates added one at a time: gain on steps not fitted, with its standard error. Hatched: rejected.",
    ),
    Figure(
        "discovered", draw_discovery, "loop", "why",
        "What was discovered beyond the named effects, with its 95 % band.",
    ),
    Figure(
        "residuals", draw_landings, "loop", "residuals",
        "Landings: measured minus predicted, against what might cause them.",
    ),
    Figure(
        "takeoffs", draw_takeoffs, "loop", "residuals",
        "Take-offs: measured minus predicted, against what might cause them.",
    ),
    Figure(
        "plate_residuals", draw_plate_residuals, "loop", "residuals",
        "The plate against the drive as the model predicts it, before and after.",
    ),
)  # fmt: skip


def figures_of(shown: Measured | ClosedLoop) -> list[tuple[Figure, Draw]]:
    """Figures of a recording, or of a closed loop, each with the function that draws it."""
    if isinstance(shown, ClosedLoop):
        needs: tuple[str, ...] = ("loop",)
    else:
        needs = ("recording",) if shown.compared is None else ("recording", "flights")
    return [(one, partial(one.draw, shown)) for one in FIGURES if one.needs in needs]
