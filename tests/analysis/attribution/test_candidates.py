"""Where fits of a candidate begin."""

from __future__ import annotations

from analysis.attribution.candidates import distinct_starts
from analysis.residuals.forward_model import ParameterId

RATIO, HZ, DAMPING = keys = tuple(("table_resonance", q) for q in ("mass_ratio", "frequency_hz", "damping"))


def start(loss: float, hz: float, ratio: float = 0.02) -> tuple[float, dict[ParameterId, float]]:
    """A start at a pitch."""
    return loss, {RATIO: ratio, HZ: hz, DAMPING: 0.05}


def test_another_pitch_begins_a_fit_of_its_own() -> None:
    """Of starts in order, the best and the best at an unlike pitch; another size alone makes no other start."""
    starts = [start(1.0, 3.4), start(2.0, 3.4, ratio=0.01), start(3.0, 4.3), start(4.0, 4.9), start(5.0, 8.0)]
    assert distinct_starts(starts, keys) == [starts[0], starts[3]]
    assert distinct_starts(starts[:3], keys) == starts[:1]


def test_squares_are_also_begun_where_they_have_a_slope() -> None:
    """A bent amplifier's harmonics are squares: beside the absent effect, the best start with it present is tried."""
    bends = tuple(("harmonic_distortion", q) for q in ("quadratic_per_g", "cubic_per_g2"))
    points = ((0.0, 0.0), (3e-3, 5e-4), (1.0, 1.0))
    starts = [(float(i), dict(zip(bends, point, strict=True))) for i, point in enumerate(points)]
    assert distinct_starts(starts, bends, absent=True) == starts[:2]
    assert distinct_starts(starts[1:], bends, absent=True) == starts[1:2]
    assert distinct_starts(starts, bends) == starts[:1]
