"""The table of the figures of a recording, which `bench report` and `bench reprocess --figures` draw. Decision 316."""

from __future__ import annotations

from analysis.report.figures.flights import draw_bifurcations, draw_history, draw_return_maps, draw_trajectory
from analysis.report.figures.plate import draw_plate
from analysis.report.figures.style import Figure

FIGURES = (
    Figure(
        "bifurcation", draw_bifurcations, "flights",
        "Bifurcation diagram: flight times against gamma, measured (dark dots; crosses: double hit or unsure) over the "
        "prediction for the plate's motion as measured (light). Shaded: flight times forbidden to the ideal ball. "
        "Diamonds: steps in which the ball was held on an unstable cycle (dashed: predicted).",
    ),
    Figure(
        "return_maps", draw_return_maps, "flights",
        "Return maps of the steps with most modes: each flight time against the one before (dots), and the predicted "
        "cycle (open squares).",
    ),
    Figure(
        "history", draw_history, "flights",
        "Flight times in order of time. Bars: the predicted cycle of each step. Plus signs: the step still settles.",
    ),
    Figure(
        "trajectory", draw_trajectory, "flights",
        "Plate and ball over a few periods, with the contact voltage below.",
    ),
    Figure(
        "plate", draw_plate, "plate",
        "The plate's gain and lag against the drive, one period of its acceleration, and its harmonics.",
    ),
)  # fmt: skip
