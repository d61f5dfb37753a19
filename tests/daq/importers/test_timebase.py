"""Passes over times: the same numbers as NumPy's, one operation after the other."""

from __future__ import annotations

import numpy as np
import pytest

from daq.importers.plausibility import refuse_mixed_rates
from daq.importers.timebase import are_whole, distances, line_sums, longest_step, of_packets, to_nanoseconds
from daq.setup.errors import InputError

TIMES = np.cumsum(np.random.default_rng(4).uniform(0.5e-3, 1.5e-3, 1000)) + 0.25


def test_sums_and_extremes_are_those_of_numpy() -> None:
    """Sums along a line, distances from a grid and the longest step, of a piece that begins at sample 70."""
    x, y, sums = np.arange(70, 1070) - 500.5, TIMES - 0.8, np.ones(5)
    line_sums(TIMES, 70, 500.5, 0.8, sums)
    np.testing.assert_allclose(sums - 1.0, [1000, y.sum(), x @ y, x @ x, y @ y], rtol=1e-11)
    off = TIMES - 0.1 - np.arange(70, 1070) * 1e-3
    found = distances(TIMES, 70, 0.1, 1e-3)
    np.testing.assert_allclose(found, [off.min(), off.max(), off.sum(), off @ off], rtol=1e-11)
    assert longest_step(TIMES) == np.diff(TIMES).max()
    assert (are_whole(np.round(TIMES, 3), 1e3), are_whole(TIMES, 1e3)) == (True, False)


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({}, (False, False, False)),
        ({3: 9.1e9, 4: 9.2e9}, (True, True, False)),
        ({500: 0.3}, (False, True, False)),
        ({500: TIMES[499]}, (False, False, True)),
        ({0: 0.1}, (False, True, False)),
    ],
)
def test_times_that_are_far_fall_or_stand_still_are_seen(change: dict[int, float], found: tuple[bool, ...]) -> None:
    """Nanoseconds are rounded as NumPy rounds them; what cannot be is told, at the border of two pieces too."""
    times = TIMES.copy()
    for at, value in change.items():
        times[at] = value
    stamps = np.empty(1000, np.int64)
    *seen, last_s = to_nanoseconds(times, 0.2, 1.0, 0.0, 9e9, stamps)
    assert tuple(seen) == found
    assert last_s == times[-1] - 0.2
    if not found[0]:
        np.testing.assert_array_equal(stamps, np.rint((times - 0.2) * 1e9).astype(np.int64))


def test_rates_that_scatter_about_one_are_no_mixture(tmp_path) -> None:
    """Steps that differ by a factor of three everywhere have one median; a file of two rates is refused as before."""

    def given(times):
        refuse_mixed_rates(tmp_path / "a.csv", lambda a, b: times[a:b], len(times), 1e-9)

    given(np.cumsum(np.random.default_rng(5).uniform(0.5e-3, 1.5e-3, 100_000)))
    with pytest.raises(InputError, match="mixed rates: 1000 samples/s before row 500 or so, 500 after"):
        given(np.append(np.arange(500) * 1e-3, 0.5 + np.arange(500) * 2e-3))


def test_rows_stamped_once_a_packet_are_even() -> None:
    """Packets of 50 rows, each stamped up to .2 ms late and the first one cut, have the rate of all; a lost one is a
    pause of 50 samples, and rows that share a time by twos and threes are no packets."""
    sent = np.delete(np.arange(400), 120)
    stamp_s = 5e-3 * sent + 2e-4 * np.random.default_rng(7).random(sent.size)
    rows_s = np.repeat(stamp_s, 50)[17:]
    base = of_packets(lambda a, b: rows_s[a:b], len(rows_s), 1e-7, 10_000.0)
    assert base is not None
    assert (base.rate_hz, base.uniform, base.packet) == (10_000.0, True, 50)
    assert base.gaps.tolist() == [[120 * 50 - 17, 50, 0]]
    other = of_packets(lambda a, b: rows_s[a:b], len(rows_s), 1e-7, 10_010.0)
    assert other is not None
    assert other.rate_hz == pytest.approx(10_000.0, rel=1e-5)
    uneven_s = np.repeat(stamp_s, np.arange(sent.size) % 2 + 2)
    assert of_packets(lambda a, b: uneven_s[a:b], len(uneven_s), 1e-7, 500.0) is None
