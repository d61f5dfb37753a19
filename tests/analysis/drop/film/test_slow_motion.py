"""Films read at the rate at which they play, where nobody said at which they were taken."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.drop.film.camera_fit import fit_camera
from analysis.drop.film.outcome import Units, of_camera
from analysis.drop.film.track import Clip
from analysis.drop.outcome import Outcome
from daq.setup.errors import InputError

G, E, SCALE_M, FPS = 9.80665, 0.6, 1.5e-4, 240.0


def _measured(fall_m: float, played_fps: float) -> Outcome:
    """A fall and two bounces taken at 240 frames a second, read at another rate, without a scale."""
    hit, speed = np.sqrt(2.0 * fall_m / G), E * np.sqrt(2.0 * G * fall_m)
    flight = 2.0 * speed / G
    times = np.arange(0.0, hit + flight * (1.0 + E), 1.0 / FPS)
    height = fall_m - 0.5 * G * times**2
    for start, up in ((hit, speed), (hit + flight, E * speed)):
        since = times - start
        height = np.where(since >= 0.0, up * since - 0.5 * G * since**2, height)
    pixels = height / SCALE_M + np.random.default_rng(1).normal(0.0, 0.05, len(times))
    clip = Clip("film", np.arange(len(times), dtype=np.float64), pixels, G / SCALE_M / FPS**2)
    units = Units(1.0 / played_fps, None, G, assumed_rate=True, ball=30.0)
    return of_camera(["film"], fit_camera([clip], np.random.default_rng(1)), units, np.random.default_rng(1))


def test_a_fall_of_three_metres_at_the_playback_rate_is_refused() -> None:
    """5 cm taken at 240 and played at 30 frames a second would be 3.2 m."""
    with pytest.raises(InputError, match=r"fall of 3\.2 m .* --fps"):
        _measured(0.05, 30.0)


def test_the_playback_rate_is_said_with_the_size_that_it_makes() -> None:
    """Below that, the words name rate and size; restitution needs neither."""
    outcome = _measured(0.05, 60.0)
    words = next(one for one in outcome.sentences if "at which the film plays" in one)
    assert "60 frames a second" in words and "72 mm" in words
    assert outcome.payload["models"][0]["parameters"]["e0"]["value"] == pytest.approx(E, abs=0.005)
