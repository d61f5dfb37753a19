"""Words of the report: what is left after a fit."""

from types import SimpleNamespace

from analysis.report.wording import what_is_left
from analysis.thresholds import FROZEN


def left(p, ratio):
    """A closed loop of which only the remainder is known."""
    return SimpleNamespace(remainder=SimpleNamespace(p_lack_of_fit=p, ratio=ratio), limits=FROZEN)


def test_a_certain_remainder_is_not_called_noise():
    """With p below the threshold the size is told; only what may be noise is said to look like it."""
    assert what_is_left(left(0.3, 1.0)) == "what is left looks like noise (p = 0.3)"
    certain = what_is_left(left(1e-12, 1.1))
    assert "noise (p" not in certain and "1.10 times the noise" in certain
