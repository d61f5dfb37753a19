"""Finding one ball's impacts among events."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analysis.drop.sequence import bounces_of
from daq.errors import InputError


def _impacts(ratio: float, first: float = 0.5, n: int = 10, start: float = 1.0) -> np.ndarray:
    return start + np.concatenate(([0.0], np.cumsum(first * ratio ** np.arange(n))))


def test_a_clean_drop_is_taken_whole() -> None:
    """Nothing is dropped, added or marked in a clean drop."""
    times = _impacts(0.9)
    found = bounces_of(times, "x")
    assert found.impacts_s == pytest.approx(times)
    assert not found.missed.any() and not found.broken.any() and len(found.false_s) == 0


def test_a_missed_impact_is_marked_not_invented() -> None:
    """The interval that holds an unheard impact is marked, and is no row of the fit."""
    found = bounces_of(np.delete(_impacts(0.88), 6), "x")
    assert found.missed.tolist() == [0, 0, 0, 0, 0, 1, 0, 0, 0]
    assert not {5, 6} & set(found.usable.tolist())


@settings(max_examples=25, deadline=None)
@given(ratio=st.floats(0.7, 0.95), where=st.floats(0.3, 0.7), index=st.integers(2, 6))
def test_a_false_event_is_left_out(ratio: float, where: float, index: int) -> None:
    """A click between two impacts is listed as false, wherever it falls."""
    times = _impacts(ratio)
    click = times[index] + where * (times[index + 1] - times[index])
    found = bounces_of(np.append(times, click), "x")
    assert click in found.false_s
    assert found.impacts_s == pytest.approx(times)


def test_noise_before_and_after_is_ignored() -> None:
    """Events of another kind around the drop do not join it."""
    times = _impacts(0.85, start=3.0)
    found = bounces_of(np.concatenate(([0.2, 1.9], times, [12.0])), "x")
    assert found.impacts_s == pytest.approx(times)


def test_too_few_events_are_refused() -> None:
    """Two events carry no restitution, and the error says what is wanted."""
    with pytest.raises(InputError, match="no three of them"):
        bounces_of(np.array([0.1, 0.5]), "two.csv")
