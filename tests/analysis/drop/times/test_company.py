"""A drop in company: a clap before it, a voice after it, its echo, another ball."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.drop.times.chain_tests import ends_that_stray, ends_unlike_in_loudness
from analysis.drop.times.impact_chain import drops_of, unheard
from analysis.drop.times.onsets import sound_onsets
from daq.setup.errors import InputError


def _impacts(ratio: float, n: int, first_s: float = 0.4, start_s: float = 0.0) -> np.ndarray:
    return start_s + np.concatenate(([0.0], np.cumsum(first_s * ratio ** np.arange(n))))


def test_a_faint_sound_before_the_drop_is_no_first_impact() -> None:
    """It fits the intervals, but the first impact is the fastest and cannot be the faintest."""
    times = np.concatenate(([-0.5], _impacts(0.8, 8)))  # 0.5 s before: just as an impact would
    loudness = 1.3 * np.log(np.append(np.diff(times), 0.06)) + 0.1 * np.sin(np.arange(len(times)))
    assert drops_of(unheard(times)._replace(loudness=loudness), "x")[0].impacts_s == pytest.approx(times)
    loudness[0] -= 3.0
    assert drops_of(unheard(times)._replace(loudness=loudness), "x")[0].impacts_s == pytest.approx(times[1:])


def test_a_knock_after_the_drop_is_no_last_impact() -> None:
    """An impact of so low a speed is not that loud; an unknown (clipped) peak says nothing."""
    times = _impacts(0.8, 9)
    loudness = 1.3 * np.log(np.append(0.5, np.diff(times)))
    single = np.ones(len(times) - 1, dtype=bool)
    assert ends_unlike_in_loudness(loudness, times, single) == (False, False)
    loudness[-1] += 3.0
    assert ends_unlike_in_loudness(loudness, times, single) == (False, True)
    loudness[-1] = np.nan
    assert ends_unlike_in_loudness(loudness, times, single) == (False, False)


def test_a_law_that_does_not_follow_the_others_excuses_no_end() -> None:
    """Ratios that change steadily with the flight: a first one 6 % off is none of them, whatever a constant says."""
    flights = [0.6]
    for _ in range(11):
        flights.append(flights[-1] * (0.86 - 0.14 * flights[-1]))
    times = np.concatenate(([0.0], np.cumsum(flights)))
    single = np.ones(len(times), dtype=bool)
    true = times[0] - (0.86 - np.sqrt(0.86**2 - 0.56 * flights[0])) / 0.28
    assert ends_that_stray(np.concatenate(([true], times)), single) == (False, False)
    assert ends_that_stray(np.concatenate(([true + 0.06], times)), single) == (True, False)


def test_a_voice_after_the_drop_is_set_aside() -> None:
    """A clap, ten impacts, then a dozen syllables at even intervals, which make the longer chain."""
    impacts = _impacts(0.8, 10, start_s=2.0)
    syllables = impacts[-1] + 0.75 + 0.286 * np.arange(12)
    found = drops_of(np.concatenate(([0.7], impacts, syllables)), "x")
    assert len(found) == 1 and found[0].impacts_s[:8] == pytest.approx(impacts[:8])
    assert found[0].impacts_s[-1] <= impacts[-1] + 1e-9


def test_two_balls_at_once_are_refused() -> None:
    """Neither is chosen in silence; nor are they joined into one that loses more."""
    both = np.sort(np.concatenate((_impacts(0.8, 10), _impacts(0.7, 10, start_s=0.13))))
    with pytest.raises(InputError, match="two things bounce"):
        drops_of(both, "x")


def test_an_echo_is_no_second_ball() -> None:
    """Every impact heard again 31 ms later is one ball in a large room."""
    impacts = _impacts(0.8, 8)
    weight = np.concatenate((np.ones(9), np.full(9, 0.4)))
    found = drops_of(unheard(np.concatenate((impacts, impacts + 0.031)))._replace(strength=weight), "x")
    assert found[0].impacts_s[:6] == pytest.approx(impacts[:6])


def test_samples_that_are_no_numbers() -> None:
    """A damaged float WAV is called damaged, not silent."""
    sound = np.random.default_rng(1).normal(0.0, 0.1, 16000)
    sound[500] = np.nan
    with pytest.raises(InputError, match="1 samples are no numbers"):
        sound_onsets(sound, 16000.0, "x")
