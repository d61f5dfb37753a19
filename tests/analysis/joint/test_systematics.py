"""Errors of the contact's edges that all runs share: derivatives, and what they keep from being named."""

from dataclasses import replace

import numpy as np
import pytest

from analysis.attribution.candidates import priors_of
from analysis.attribution.fit import Fitter
from analysis.attribution.hypothesis import Refits
from analysis.joint.summary import NAMES, UNIT_S, systematic_errors
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.whitening import Whitener
from analysis.residuals.observations import observations_from
from benchmarks.analysis.joint import short_runs

LATE_S = 2e-6


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """One short run of the other plant, in whose highest steps the ball leaves at once."""
    return ForwardModel(observations_from(short_runs(tmp_path_factory.mktemp("run"), 1, 541, {})), {})


def test_derivatives_are_what_later_edges_do(model):
    """Edges that are dated later change the residuals as the derivatives say, against their sign: later is measured."""
    whitener = Whitener.of(model, {})
    slopes, _ = systematic_errors(model, whitener, {})
    seen = model.observations
    brief = np.append(seen.measured.relaunched[1:] & seen.measured.linked[1:], False)
    assert 3 < brief.sum() < len(seen) / 2
    before = whitener.stacked(model.residuals({}))
    for column, late in ((0, {"opening_s": seen.measured.opening_s + LATE_S}),
                         (1, {"landing_s": seen.measured.landing_s + np.where(brief, LATE_S, 0.0)})):  # fmt: skip
        moved = ForwardModel(replace(seen, measured=replace(seen.measured, **late)), {}, like=model)
        change = whitener.stacked(moved.residuals({})) - before
        same = np.abs(change) < 1e-4
        assert same.mean() > 0.95
        expected = -slopes[:, column] * LATE_S / UNIT_S
        np.testing.assert_allclose(change[same], expected[same], rtol=0.02, atol=0.02 * LATE_S)
        assert np.any(change[same] != 0.0)


def test_priors_are_parts_of_an_edge(model):
    """Openings may be off by a tenth of an edge's uncertainty, brief contacts by no more than an edge's own."""
    fitter = Fitter(model, priors_of(model.observations.setup), np.ones(len(model.observations.steps), dtype=bool))
    whitener = Refits(fitter).converged((), Whitener.of(model, {}), (), {}).whitener
    _, sigma = systematic_errors(model, whitener, {})
    assert len(sigma) == len(NAMES)
    edge_us = 1e6 * float(np.median(model.observations.landing_sigma_s))
    assert 0.05 * edge_us < sigma[0] < 0.2 * edge_us
    assert sigma[1] <= 1.1 * edge_us
