"""Onsets in a sound, and contact closings, against known impacts."""

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.io import wavfile

from analysis.drop.onsets import read_wav, sound_onsets
from analysis.drop.sequence import bounces_of
from daq.errors import InputError


def test_onsets_to_the_sample(synthetic: ModuleType) -> None:
    """Every tap of a synthetic drop is found to three samples, most to one."""
    truth = synthetic.Truth(height_m=0.25, e0=0.82, hold_s=0.3)
    sound, impacts = synthetic.taps(truth, 3.0, 44100.0, np.random.default_rng(4))
    times, strength = sound_onsets(sound, 44100.0, "x")
    found = bounces_of(times, "x", strength=strength).impacts_s
    off = 44100.0 * np.abs(found[:, None] - impacts[None]).min(axis=0)
    assert len(found) == len(impacts)
    assert off.max() < 3.0 and np.median(off) <= 1.0


@pytest.mark.parametrize("kind", ["int16", "int32", "uint8", "float32"])
def test_sample_formats_read_alike(tmp_path: Path, kind: str) -> None:
    """8, 16, 32 bit and float WAV give the same sound."""
    wave = 0.5 * np.sin(np.arange(8000) / 9.0)
    stored = {
        "int16": (wave * 32767).astype(np.int16),
        "int32": (wave * 2147483647).astype(np.int32),
        "uint8": (wave * 127 + 128).astype(np.uint8),
        "float32": wave.astype(np.float32),
    }[kind]
    wavfile.write(tmp_path / "x.wav", 8000, stored)
    samples, rate = read_wav(tmp_path / "x.wav")
    assert rate == 8000.0
    assert np.corrcoef(samples[:, 0], wave)[0, 1] > 0.999


def test_silence_is_an_error() -> None:
    """A recording of nothing says so."""
    with pytest.raises(InputError, match="silent"):
        sound_onsets(np.zeros(44100), 44100.0, "quiet.wav")


def test_a_damaged_wav_is_an_error(tmp_path: Path) -> None:
    """A WAV header without a WAV behind it is refused by name."""
    target = tmp_path / "bad.wav"
    target.write_bytes(b"RIFF\x10\x00\x00\x00WAVEjunkjunkjunk")
    with pytest.raises(InputError, match=r"bad\.wav"):
        read_wav(target)
