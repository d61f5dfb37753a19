"""The one tone estimator: exact on clean tones, honest about noise, the same whatever piece is handed in."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from daq.loaded_tones import LoadedTones
from daq.lock_in import LockIn, fit_tones, fit_tones_each

RATE = 20000.0
FREQUENCIES = np.array([25.37, 76.11, 50.0])
AMPLITUDES = np.array([3.0 * np.exp(0.4j), 0.7 * np.exp(-2.0j), 0.02j])


def tones(n: np.ndarray) -> np.ndarray:
    """The known signal at samples ``n``."""
    phase = np.exp(2j * np.pi * ((FREQUENCIES[:, None] * n / RATE) % 1.0))
    return 1.5 + (AMPLITUDES[:, None] * phase).real.sum(axis=0)


def test_clean_tones_come_back_exactly_far_into_a_recording():
    """Phases refer to sample 0 even after a thousand million samples."""
    first = 10**9
    fit = fit_tones(tones(first + np.arange(20000)), first, RATE, FREQUENCIES)
    np.testing.assert_allclose(fit.amplitudes, AMPLITUDES, atol=1e-7)
    assert fit.offset == pytest.approx(1.5, abs=1e-6)


def test_masked_samples_do_not_count():
    """Whatever stands in a masked sample leaves no trace."""
    n = np.arange(777, 20777)
    x = tones(n)
    mask = (n // 500) % 4 != 1
    x[~mask] = 1e3
    fit = fit_tones(x, 777, RATE, FREQUENCIES, mask)
    np.testing.assert_allclose(fit.amplitudes, AMPLITUDES, atol=1e-9)
    assert fit.n == mask.sum()
    assert fit.rms < 1e-6


def test_covariance_is_the_scatter_over_repetitions():
    """Whitened errors over many noisy repetitions have unit variance, in every quadrature, masked or not."""
    rng = np.random.default_rng(1)
    n = np.arange(4000)
    mask = (n % 788) > 200
    whitened = []
    for _ in range(300):
        fit = fit_tones(tones(n) + 0.3 * rng.standard_normal(n.size), 0, RATE, FREQUENCIES, mask)
        error = fit.amplitudes - AMPLITUDES
        stacked = np.column_stack([error.real, error.imag]).ravel()
        whitened.append(np.linalg.solve(np.linalg.cholesky(fit.covariance), stacked))
    variance = np.var(whitened, axis=0)
    assert np.all(np.abs(variance - 1.0) < 4 * np.sqrt(2 / 300))


def test_pieces_add_up_to_the_whole():
    """Two pieces accumulated one after the other, or added, give the fit of the whole, for every channel."""
    n = np.arange(9000)
    x = np.column_stack([tones(n), 2.0 * tones(n)])
    whole, left, right = (LockIn(RATE, FREQUENCIES, channels=2) for _ in range(3))
    whole.add(x, 0)
    left.add(x[:4321], 0)
    right.add(x[4321:], 4321)
    both = left + right
    np.testing.assert_allclose(both.solve(1).amplitudes, whole.solve(1).amplitudes, rtol=1e-9)
    np.testing.assert_allclose(both.solve(1).amplitudes, 2 * AMPLITUDES, rtol=1e-8)


def test_values_taken_away_leave_the_fit_of_the_others():
    """A fit less some of its values is that of the others alone."""
    n = np.arange(9000)
    x = tones(n) + 0.1 * np.random.default_rng(4).standard_normal(n.size)
    some = (n // 700) % 5 == 1
    every, few = LockIn(RATE, FREQUENCIES), LockIn(RATE, FREQUENCIES)
    every.add(x, 0)
    few.add(x, 0, some)
    found, wanted = (every - few).solve(), fit_tones(x, 0, RATE, FREQUENCIES, ~some)
    np.testing.assert_allclose(found.amplitudes, wanted.amplitudes, rtol=1e-10)
    np.testing.assert_allclose(found.covariance, wanted.covariance, rtol=1e-9, atol=1e-15)
    assert found.n == wanted.n


def test_means_of_samples_give_the_amplitudes_of_the_samples():
    """The boxcar's gain and delay are taken out, even for a tone near the rate of the means."""
    boxcar = 16
    n = np.arange(boxcar * 2000)
    lock_in = LockIn(RATE / boxcar, FREQUENCIES, boxcar=boxcar)
    lock_in.add(tones(n).reshape(-1, boxcar).mean(axis=1), 0)
    np.testing.assert_allclose(lock_in.solve().amplitudes, AMPLITUDES, atol=1e-9)


def test_tones_that_cannot_be_separated_are_refused():
    """Twice the same frequency, or too few samples, is an error and not a number."""
    x = np.zeros(1000)
    with pytest.raises(ValueError, match="cannot be separated"):
        fit_tones(x, 0, RATE, [25.0, 25.0])
    with pytest.raises(ValueError, match="cannot fix"):
        fit_tones(x[:3], 0, RATE, [25.0, 50.0])
    with pytest.raises(ValueError, match="positive"):
        fit_tones(x, 0, RATE, [0.0])


def test_sorts_are_summed_apart() -> None:
    """Each sort's normal equations are those of its own values, however they are mixed, over several stretches."""
    rng = np.random.default_rng(5)
    x, sorts = rng.normal(size=(1300, 2)), rng.integers(-1, 4, 1300).astype(np.int8)
    both = LockIn(1000.0, [20.0, 33.0], channels=2, sorts=4)
    both.add(x, 77, sorts)
    for sort in range(4):
        own, alone = both.part([sort]), LockIn(1000.0, [20.0, 33.0], channels=2)
        alone.add(x, 77, sorts == sort)
        assert own.n == alone.n == int(np.sum(sorts == sort))
        for channel in range(2):
            np.testing.assert_allclose(own.solve(channel).amplitudes, alone.solve(channel).amplitudes, rtol=1e-10)
            np.testing.assert_allclose(own.solve(channel).rms, alone.solve(channel).rms, rtol=1e-10)


def test_stretches_fitted_together_are_those_fitted_alone():
    """Fits of many stretches in one go are the fits of each, and one that is too short is refused."""
    edges = np.array([5000, 5800, 6100, 7900])
    x = tones(np.arange(edges[0], edges[-1])) + np.random.default_rng(2).normal(0.0, 0.1, edges[-1] - edges[0])
    each = fit_tones_each(x, edges, RATE, FREQUENCIES[:2])
    assert each.amplitudes.shape == (3, 2)
    for i, (a, b) in enumerate(pairwise(edges)):
        alone = fit_tones(x[a - edges[0] : b - edges[0]], a, RATE, FREQUENCIES[:2])
        np.testing.assert_allclose(each.amplitudes[i], alone.amplitudes, rtol=1e-9)
        own = each.n[i], each.offsets[i], each.rms[i]
        assert own == (alone.n, pytest.approx(alone.offset), pytest.approx(alone.rms))
    with pytest.raises(ValueError, match="2 values cannot fix 5 unknowns"):
        fit_tones_each(x[:302], np.array([5000, 5300, 5302]), RATE, FREQUENCIES[:2])


def test_what_was_solved_is_forgotten_when_values_are_added():
    """A fit, a part and an inverse that were asked for before more values came are those of all values afterwards."""
    n, sorts = np.arange(6000), np.repeat(np.arange(3, dtype=np.int8), 2000)
    growing, whole = (LockIn(RATE, FREQUENCIES, sorts=3) for _ in range(2))
    growing.add(tones(n[:3000]), 0, sorts[:3000])
    early = growing.solve(), growing.part([0, 1]).solve(), growing.inverse()
    growing.add(tones(n[3000:]), 3000, sorts[3000:])
    whole.add(tones(n), 0, sorts)
    np.testing.assert_allclose(growing.inverse(), whole.inverse(), rtol=1e-9)
    np.testing.assert_allclose(growing.part([0, 1]).inverse(), whole.part([0, 1]).inverse(), rtol=1e-9)
    assert (growing.solve().n, growing.part([0, 1]).solve().n) == (6000, 4000)
    assert (early[0].n, early[1].n) == (3000, 3000)


def test_inverses_are_those_of_the_normal_matrices():
    """Sums by sort and their inverses agree with a design matrix written out, for tones of very different strength."""
    rng = np.random.default_rng(3)
    n, sort = np.arange(123, 3123), rng.integers(-1, 3, 3000).astype(np.int8)
    fit = LockIn(RATE, FREQUENCIES, sorts=3)
    fit.add(tones(n), 123, sort)
    angle = 2 * np.pi * FREQUENCIES[:, None] * n / RATE
    design = np.vstack([np.ones(n.size), *(row for a in angle for row in (np.cos(a), -np.sin(a)))])
    for chosen in ([0], [2, 1]):
        own = design[:, np.isin(sort, chosen)]
        part = fit.part(chosen)
        np.testing.assert_allclose(part.gram, own @ own.T, atol=1e-7)
        np.testing.assert_allclose(part.inverse() @ (own @ own.T), np.eye(7), atol=1e-8)


def test_tones_that_are_one_are_refused():
    """Two tones a thousandth of a cycle from each other over the values cannot be separated, and the error says so."""
    fit = LockIn(RATE, [25.37, 25.37001])
    fit.add(tones(np.arange(2000)), 0)
    with pytest.raises(ValueError, match="cannot be separated by 2000 values"):
        fit.solve()


def test_some_tones_alone_are_those_of_a_fit_without_the_others() -> None:
    """From the sums of all tones, the fit of some of them is that of a lock-in that knows only these."""
    rng = np.random.default_rng(7)
    x, mask = tones(np.arange(5000)) + 0.1 * rng.standard_normal(5000), rng.random(5000) < 0.8
    every, chosen = LockIn(RATE, FREQUENCIES), np.arange(len(FREQUENCIES)) != 1
    every.add(x, 100, mask)
    found, wanted = every.only(chosen).solve(), fit_tones(x, 100, RATE, np.array(FREQUENCIES)[chosen], mask)
    np.testing.assert_allclose(found.amplitudes, wanted.amplitudes, rtol=1e-12)
    np.testing.assert_allclose(found.covariance, wanted.covariance, rtol=1e-12, atol=1e-18)
    assert (found.n, found.rms) == (wanted.n, pytest.approx(wanted.rms, rel=1e-12))


@pytest.mark.parametrize("frequencies", [[25.37], [25.37, 76.11, 50.0], [25.37, RATE - 25.0, RATE / 2.0]])
def test_whole_stretches_need_no_sums_of_the_tones(frequencies: list[float]) -> None:
    """Normal equations in closed form are those of sums over samples, for tones beyond half the sample rate too."""
    edges = 10**6 + np.array([0, 788, 1900, 2000, 5000])
    x = tones(np.arange(edges[0], edges[-1])) + 0.1 * np.random.default_rng(8).standard_normal(5000)
    summed, closed = (LockIn(RATE, frequencies, boxcar=3, sorts=4) for _ in range(2))
    summed.add(x, int(edges[0]), np.repeat(np.arange(4, dtype=np.int8), np.diff(edges)))
    closed.add_stretches(x, edges)
    np.testing.assert_allclose(closed.gram, summed.gram, atol=1e-8)
    np.testing.assert_allclose(closed.rhs, summed.rhs, atol=1e-8)
    np.testing.assert_array_equal(closed.counts, summed.counts)


def test_hardly_any_contact_shows_no_load() -> None:
    """Of each contact all but two samples are masked, in which the last of a ringing stands: no load bends the tone."""
    rate_hz, hz, amplitude = 20_000.0, 25.0, 2.3
    index, noise = np.arange(20_000), np.random.default_rng(1).standard_normal(20_000)
    x = amplitude * np.sin(2.0 * np.pi * hz * index / rate_hz) + 0.003 * noise
    cycle = index % 800
    touching, unmasked = cycle < 202, cycle >= 200
    x[touching & unmasked] += 0.02
    sums = LockIn(rate_hz, np.array([hz, 2.0 * hz, 3.0 * hz]), sorts=4)
    sums.add(x, 0, (np.where(unmasked, 0, 2) + touching).astype(np.int8))
    amplitudes, _ = LoadedTones.of_sorts(sums, 1.0).solve()
    assert abs(amplitudes[0]) == pytest.approx(amplitude, rel=1e-3)
