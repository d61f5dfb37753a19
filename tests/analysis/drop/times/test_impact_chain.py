"""Finding one ball's impacts among events."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analysis.drop.times.impact_chain import drops_of
from daq.setup.errors import InputError


def _impacts(ratio: float, first: float = 0.5, n: int = 10, start: float = 1.0) -> np.ndarray:
    return start + np.concatenate(([0.0], np.cumsum(first * ratio ** np.arange(n))))


def test_a_clean_drop_is_taken_whole() -> None:
    """Nothing is dropped, added or marked in a clean drop."""
    times = _impacts(0.9)
    found = drops_of(times, "x")[0]
    assert found.impacts_s == pytest.approx(times)
    assert not found.missed.any() and not found.broken.any() and len(found.false_s) == 0


def test_a_missed_impact_is_marked_not_invented() -> None:
    """The interval that holds an unheard impact is marked, and is no row of the fit."""
    found = drops_of(np.delete(_impacts(0.88), 6), "x")[0]
    assert found.missed.tolist() == [0, 0, 0, 0, 0, 1, 0, 0, 0]
    assert not {5, 6} & set(found.usable.tolist())


@settings(max_examples=25, deadline=None)
@given(ratio=st.floats(0.7, 0.95), where=st.floats(0.3, 0.7), index=st.integers(2, 6))
def test_a_false_event_is_left_out(ratio: float, where: float, index: int) -> None:
    """A click between two impacts is listed as false, wherever it falls."""
    times = _impacts(ratio)
    click = times[index] + where * (times[index + 1] - times[index])
    found = drops_of(np.append(times, click), "x")[0]
    assert click in found.false_s
    assert found.impacts_s == pytest.approx(times)


def test_noise_before_and_after_is_ignored() -> None:
    """Events of another kind around the drop do not join it."""
    times = _impacts(0.85, start=3.0)
    found = drops_of(np.concatenate(([0.2, 1.9], times, [12.0])), "x")[0]
    assert found.impacts_s == pytest.approx(times)


def test_too_few_events_are_refused() -> None:
    """Two events carry no restitution, and the error says what is wanted."""
    with pytest.raises(InputError, match="no three of them"):
        drops_of(np.array([0.1, 0.5]), "two.csv")[0]


def test_a_click_before_the_drop_is_not_its_first_impact() -> None:
    """A click one plausible flight before the drop does not belong to it: the other bounces say so."""
    times = _impacts(0.85, n=10, start=3.0)
    found = drops_of(np.append(times, 3.0 - 0.5 / 0.85 * 1.04), "x")[0]
    assert found.impacts_s == pytest.approx(times)
    assert len(found.false_s) == 1


def test_a_first_bounce_that_loses_more_to_the_air_stays() -> None:
    """Ratios that change steadily, as with drag, are no reason to give up the first impact."""
    flights = [0.6]
    for _ in range(9):
        flights.append(flights[-1] * (0.92 - 0.15 * flights[-1] ** 2))
    times = np.concatenate(([0.0], np.cumsum(flights)))
    assert drops_of(times, "x")[0].impacts_s == pytest.approx(times)


def test_two_drops_in_one_recording_are_two_drops() -> None:
    """A ball dropped twice gives two sets of models, in order."""
    one, two = _impacts(0.8, n=8), _impacts(0.8, n=9, start=6.0)
    found = drops_of(np.concatenate((one, two)), "x")
    assert [len(drop.impacts_s) for drop in found] == [9, 10]
    assert found[1].impacts_s[0] == pytest.approx(6.0)


def test_no_flight_grows_after_an_irregular_bounce() -> None:
    """Noises after the last bounce, at intervals of a long flight, do not continue the ball's bounces."""
    times = _impacts(0.85, n=10)
    found = drops_of(np.concatenate((times, times[-1] + np.array([0.4, 0.76, 1.08]))), "x")[0]
    assert found.impacts_s == pytest.approx(times)


def test_three_of_many_events_are_chance() -> None:
    """Among fifty events at random some three shrink steadily; that is no drop."""
    with pytest.raises(InputError, match="no three of them"):
        drops_of(np.sort(np.random.default_rng(1).uniform(0.0, 60.0, 30)), "talk.wav")[0]
