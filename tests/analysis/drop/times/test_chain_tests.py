"""Chains of events that are no drop, and sounds that mislead: refused, or read right."""

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.io import wavfile

from analysis.drop.times.impact_chain import drops_of, unheard
from analysis.drop.times.onsets import onsets_of_file, sound_onsets
from daq.setup.errors import InputError


def _impacts(ratio: float, first: float, n: int, start: float) -> np.ndarray:
    return start + np.concatenate(([0.0], np.cumsum(first * ratio ** np.arange(n))))


@pytest.mark.parametrize("scatter_s", [0.0, 0.002])
def test_a_metronome_is_no_drop(scatter_s: float) -> None:
    """Even intervals have a restitution of 1, which no ball has."""
    events = np.arange(30) * 0.5 + scatter_s * np.random.default_rng(1).standard_normal(30)
    with pytest.raises(InputError, match="even intervals"):
        drops_of(events, "metronome.wav")[0]


@pytest.mark.parametrize("seed", range(8))
def test_a_rally_is_no_drop(seed: int) -> None:
    """Sixty taps of a game at 0.3 to 0.8 s hold chains that shrink by chance; none is believed."""
    with pytest.raises(InputError, match="no three of them"):
        drops_of(np.cumsum(np.random.default_rng(seed).uniform(0.3, 0.8, 60)), "rally.wav")


def test_twelve_drops_in_one_recording() -> None:
    """Twelve clean drops of 23 impacts among stray noises are twelve drops."""
    rng = np.random.default_rng(5)
    drops = [_impacts(0.85, 0.6 + 0.002 * k, 22, 5.0 * k) for k in range(12)]
    events = np.concatenate([*drops, rng.uniform(0.0, 60.0, 20)])
    assert [len(drop.impacts_s) for drop in drops_of(events, "x")] == [23] * 12


def test_a_rhythm_is_no_row_of_drops() -> None:
    """Six taps that quicken, again and again every three seconds to the millisecond, are no drops."""
    events = np.concatenate([_impacts(0.8, 0.4, 5, 3.0 * k) for k in range(8)])
    with pytest.raises(InputError, match="a rhythm"):
        drops_of(events, "rhythm.wav")


def test_loudness_goes_with_energy() -> None:
    """A chain that shrinks but grows louder is none of a ball's."""
    times = _impacts(0.8, 0.5, 10, 1.0)
    quieter, louder = -0.25 * np.arange(11.0), 0.25 * np.arange(11.0)
    assert len(drops_of(unheard(times)._replace(loudness=quieter), "x")[0].impacts_s) == 11
    with pytest.raises(InputError, match="grow quieter"):
        drops_of(unheard(times)._replace(loudness=louder), "x")[0]


@pytest.mark.parametrize("rate_hz", [8000.0, 44100.0])
def test_a_clipped_first_impact_is_timed(rate_hz: float) -> None:
    """Twenty times too loud, with a swing that clips for 60 ms: the first impact is found where it is."""
    rng = np.random.default_rng(3)
    impacts = _impacts(0.8, 0.5, 12, 1.0)
    sound = 1e-3 * rng.standard_normal(int((impacts[-1] + 0.7) * rate_hz))
    for k, when in enumerate(impacts):
        first = int(np.ceil(when * rate_hz))
        since = np.arange(len(sound) - first) / rate_hz
        tap = np.sin(2 * np.pi * 120.0 * since) + 0.3 * rng.standard_normal(len(since))
        sound[first:] += 20.0 * 0.8**k * tap * np.exp(-since / 0.02)
    onsets = sound_onsets(np.clip(sound, -1.0, 1.0), rate_hz, "x")
    found = drops_of(onsets, "x")[0]
    assert found.impacts_s[0] == pytest.approx(impacts[0], abs=1e-3)
    assert np.isnan(onsets.loudness[0])


def test_a_long_file_is_read_in_pieces(tmp_path: Path, synthetic: ModuleType) -> None:
    """A drop that lies across the border of two pieces of a minute's noise is found whole."""
    rate = 8000
    truth = synthetic.Truth(height_m=0.4, e0=0.8, hold_s=0.0)
    tap, impacts = synthetic.taps(truth, 4.0, rate, np.random.default_rng(2), noise=0.0)
    sound = 2e-3 * np.random.default_rng(3).standard_normal(70 * rate)
    sound[18 * rate : 18 * rate + len(tap)] += tap
    wavfile.write(tmp_path / "long.wav", rate, (sound * 32767 * 0.5).astype(np.int16))
    onsets = onsets_of_file(tmp_path / "long.wav")
    drops = drops_of(onsets, "long.wav")
    assert len(drops) == 1
    assert drops[0].impacts_s[:6] == pytest.approx(18.0 + impacts[:6], abs=1e-3)
