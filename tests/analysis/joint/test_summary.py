"""One run's summary: where it is linearised."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from analysis.attribution.candidates import Prior, coordinate_of, priors_of
from analysis.joint.summary import Point, summarise
from analysis.thresholds import FROZEN
from benchmarks.analysis.joint import short_runs
from daq.recording import open_recording

GAP = ("contact_gap", "gap_m")


def test_a_run_is_linearised_where_all_runs_put_a_bent_calibration(tmp_path: Path) -> None:
    """The height at which the contact opens is not the run's own, which follows its noise; a gain stays the run's."""
    (path,) = short_runs(tmp_path, 1, 506, {"adhesion.pull_g": 0.0034})
    with open_recording(path) as opened:
        alone = Point(priors_of(opened.setup), {("adhesion", "a_mps2"): 0.0333})
    assert alone.bent == (GAP,)
    together = replace(alone, population={GAP: Prior(3e-12, 1e-21)})
    first, second = (summarise(path, point, FROZEN) for point in (alone, together))
    place, gain = alone.own.index(GAP), alone.own.index(("drive_gain", "relative"))
    common = coordinate_of(GAP, 3e-12)
    assert abs(first.quadratic.origin[place] - common) > 0.1 * common
    assert second.quadratic.origin[place] == pytest.approx(common, rel=0.01)
    assert second.quadratic.origin[gain] == pytest.approx(first.quadratic.origin[gain], abs=0.02)
