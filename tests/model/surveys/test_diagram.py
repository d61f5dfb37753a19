"""Diagrams, forbidden zones and ensembles."""

from __future__ import annotations

import numpy as np
import pytest

from model.bifurcations.forbidden_zones import forbidden_zones
from model.orbits.attractor import attractor
from model.orbits.exact_ball import FrictionBall, IdealBall
from model.surveys import ensemble
from model.surveys.diagram import FIELDS, adaptive, diagram
from model.surveys.ensemble import Axis, Job
from model.tones import Forcing

FORCING = Forcing.superposition(1)


@pytest.mark.parametrize(("peak", "low", "high"), [(5.0, 8.209, 9.410), (8.0, 7.219, 10.150)])
def test_the_first_forbidden_zone_is_where_published(peak, low, high):
    """One sine: flight times of the first forbidden zone, to the digits given."""
    zone = forbidden_zones(FORCING, peak / 2)[0]
    np.testing.assert_allclose(zone, (low, high), atol=6e-4)


def test_no_flight_of_a_long_orbit_lies_in_a_forbidden_zone():
    """c = 3: a thousand gammas' cycles and the zones never meet."""
    forcing = Forcing.superposition(3)
    for gamma in (0.9, 1.35, 1.66):
        zones = forbidden_zones(forcing, gamma)
        tau = diagram(IdealBall(forcing), [gamma]).tau
        assert zones.size
        for low, high in zones:
            assert not np.any((tau > low + 1e-6) & (tau < high - 1e-6))


def test_there_is_no_zone_before_the_first_is_born():
    """One sine below gamma_peak 4.603: every flight time up to the longest occurs."""
    assert forbidden_zones(FORCING, 2.3).size == 0
    assert forbidden_zones(FORCING, 2.31).size == 2


@pytest.mark.parametrize("ball", [IdealBall(FORCING), FrictionBall(FORCING, 0.3, 0.2), FrictionBall(FORCING, e0=0.2)])
def test_rows_are_the_attractors(ball):
    """The compiled rows say what `attractor` says, resting, locked, sticking and chattering alike."""
    gammas = np.array([0.3, 0.8, 1.3, 1.7, 1.95, 2.5])
    rows = diagram(ball, gammas)
    for i, gamma in enumerate(gammas):
        found = attractor(ball, float(gamma))
        assert (rows.flights[i], rows.resets[i], rows.locked[i]) == (found.flights, found.resets, found.locked)
        n = min(found.tau.size, rows.tau.shape[1])
        np.testing.assert_allclose(rows.tau[i, :n], found.tau[:n], atol=1e-12)


def test_an_adaptive_diagram_is_finer_where_something_happens():
    """More gammas beside the doubling than in the middle of a window, and the change is pinned down."""
    ball = IdealBall(FORCING)
    rows = adaptive(lambda g: diagram(ball, g), 1.7, 1.9, 11, halvings=10)
    change = np.flatnonzero(np.diff(rows.flights))
    assert change.size == 1
    gap = rows.gamma[change[0] + 1] - rows.gamma[change[0]]
    assert gap < 1e-4 < np.max(np.diff(rows.gamma))
    assert rows.gamma[change[0]] <= np.sqrt(np.pi**2 + 4) / 2 <= rows.gamma[change[0] + 1]


def job(**changes):
    """A small grid of gammas and frictions."""
    axes = (Axis("coulomb_friction.mu", (0.0, 0.2)),)
    return Job(**{"ratio": 1, "gammas": tuple(np.linspace(0.4, 2.0, 30)), "axes": axes, **changes})


def test_an_ensemble_left_unfinished_is_continued(tmp_path):
    """Chunks already there are not flown again, and the whole equals one flown at once."""

    class StopError(Exception):
        """The run is interrupted."""

    def stop_after_first(done, total):
        if done >= 14:
            raise StopError

    broken, whole = tmp_path / "broken.h5", tmp_path / "whole.h5"
    with pytest.raises(StopError):
        ensemble.run(job(), broken, chunk=7, progress=stop_after_first)
    assert 0 < ensemble.load(broken)[0].gamma.size < 60
    seen = []
    ensemble.run(job(), broken, chunk=7, progress=lambda done, total: seen.append(done))
    assert seen[0] > 14
    ensemble.run(job(), whole, chunk=60)
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(ensemble.load(broken)[0], name), getattr(ensemble.load(whole)[0], name))


def test_a_file_of_another_job_is_refused(tmp_path):
    """Results are never mixed."""
    ensemble.run(job(), tmp_path / "a.h5")
    with pytest.raises(ValueError, match="another job"):
        ensemble.run(job(phase_rad=1.0), tmp_path / "a.h5")


def test_workers_compute_the_same(tmp_path):
    """Two spawned processes give what one gives."""
    ensemble.run(job(), tmp_path / "one.h5", chunk=20)
    ensemble.run(job(), tmp_path / "two.h5", chunk=20, workers=2)
    np.testing.assert_array_equal(ensemble.load(tmp_path / "one.h5")[0].tau, ensemble.load(tmp_path / "two.h5")[0].tau)


def test_an_axis_means_its_effect(tmp_path):
    """A point of the grid is the attractor of the ball with that effect."""
    ensemble.run(job(), tmp_path / "grid.h5")
    rows, attributes = ensemble.load(tmp_path / "grid.h5")
    assert tuple(attributes["shape"]) == (2, 30)
    found = attractor(FrictionBall(FORCING, 0.2, 0.2), rows.gamma[50])
    np.testing.assert_allclose(rows.tau[50, : found.tau.size], found.tau, atol=1e-12)


def test_a_job_that_cannot_be_flown_is_refused_at_once(tmp_path):
    """An unknown effect, a value out of bounds: said before anything is written."""
    with pytest.raises(ValueError, match="called 'nonsense'"):
        ensemble.run(job(axes=(Axis("nonsense.x", (1.0,)),)), tmp_path / "a.h5")
    with pytest.raises(ValueError, match="mu_down"):
        ensemble.run(job(axes=(Axis("coulomb_friction.mu", (0.1, 1.5)),)), tmp_path / "a.h5")
    assert not (tmp_path / "a.h5").exists()


@pytest.mark.filterwarnings("ignore")  # Dask's own
def test_a_local_cluster_computes_the_same(tmp_path):
    """On a Dask cluster of two workers the rows are those of one process."""
    pytest.importorskip("distributed")
    ensemble.run(job(), tmp_path / "one.h5", chunk=20)
    ensemble.run(job(), tmp_path / "dask.h5", chunk=20, workers=2, cluster="local")
    np.testing.assert_array_equal(ensemble.load(tmp_path / "one.h5")[0].tau, ensemble.load(tmp_path / "dask.h5")[0].tau)
