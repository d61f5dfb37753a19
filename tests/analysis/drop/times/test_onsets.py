"""Onsets in a sound, and contact closings, against known impacts."""

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from analysis.drop.load import load_all
from analysis.drop.times.impact_chain import drops_of, unheard
from analysis.drop.times.model_fit import Drop
from analysis.drop.times.onsets import sound_onsets
from daq.files.tables import Block
from daq.recording.writer import RecordingWriter
from daq.setup.errors import InputError
from daq.setup.setup import Setup


def test_onsets_to_the_sample(synthetic: ModuleType) -> None:
    """Every tap of a synthetic drop is found to three samples, most to one."""
    truth = synthetic.Truth(height_m=0.25, e0=0.82, hold_s=0.3)
    sound, impacts = synthetic.taps(truth, 3.0, 44100.0, np.random.default_rng(4))
    times, strength, _ = sound_onsets(sound, 44100.0, "x")
    found = drops_of(unheard(times)._replace(strength=strength), "x")[0].impacts_s
    off = 44100.0 * np.abs(found[:, None] - impacts[None]).min(axis=0)
    assert len(found) == len(impacts)
    assert off.max() < 3.0 and np.median(off) <= 1.0


@pytest.mark.parametrize(
    "room",
    [
        {"hum": 0.05, "gain": 0.2},
        {"gain": 3.0, "channels": 2, "rate_hz": 48_000.0},
        {"speech": 0.005, "gain": 0.4},
        {"noise": 5e-3, "rate_hz": 96_000.0},
    ],
    ids=["hum", "clipped", "speech", "noise"],
)
def test_onsets_in_an_ordinary_room(synthetic: ModuleType, room: dict[str, float]) -> None:
    """Over hum, talk and noise, and where the recording clips, the loud impacts are found within a few samples."""
    truth = synthetic.Truth(height_m=0.4, e0=0.82, hold_s=0.0)
    setting = synthetic.Room(**room)
    sound, impacts, loud = synthetic.sound(truth, setting, np.random.default_rng(6))
    times, strength, _ = sound_onsets(sound, setting.rate_hz, "x")
    found = drops_of(unheard(times)._replace(strength=strength), "x")[0].impacts_s
    due = impacts[(loud > 10.0 * (setting.noise + setting.speech)) & (np.diff(impacts, prepend=0.0) > 0.04)]
    off = np.abs(found[:, None] - due[None]).min(axis=0)
    assert len(due) >= 6 and off.max() < 1e-3 and np.median(off) < 1e-4
    assert len(found) - len(due) <= 8  # the last, faint ones


def test_silence_is_an_error() -> None:
    """A recording of nothing says so."""
    with pytest.raises(InputError, match="silent"):
        sound_onsets(np.zeros(44100), 44100.0, "quiet.wav")


def _contact_recording(folder: Path, times: np.ndarray, rate: float, shaken_v: float = 0.0) -> Path:
    """A recording of a ball that closes the contact at ``times``, on a plate shaken at 25 Hz or at rest."""
    setup = Setup.model_validate(
        {
            "name": "rest",
            "sampling": {"rate_hz": rate},
            "forcing": {"frequency_hz": 25.0},
            "channels": {"accelerometer": {"sensitivity": 0.1, "unit": "V/g"}},
            "ball": {"mass_kg": 0.25},
        }
    )
    volts = np.full(int(2.0 * rate), 5.0)
    for when in times:
        first = int(np.ceil(when * rate))
        volts[first : first + 20] = 0.0
        volts[first + 8] = 5.0
    codes = np.zeros((len(volts), 3), dtype=np.int16)
    codes[:, 0] = np.round(volts / 10.0 * 32767)
    shaking = shaken_v * np.sin(2 * np.pi * 25.0 * np.arange(len(volts)) / rate)
    codes[:, 1] = np.round(shaking / 10.0 * 32767)
    writer = RecordingWriter(
        folder / "rest.h5",
        setup,
        profile_text="",
        channels=("continuity", "accelerometer", "drive"),
        backend="test",
        simulated=True,
    )
    writer.append(Block(first_sample=0, codes=codes, flags=0, clock_ns=0, lost_before=0))
    writer.close()
    return next(folder.glob("rest*.h5"))


CLOSINGS_S = 0.3 + np.concatenate(([0.0], np.cumsum(0.3 * 0.7 ** np.arange(8))))


def test_a_contact_channel_with_the_plate_at_rest(tmp_path: Path) -> None:
    """Closings of the contact circuit in a recording are the impacts; chatter within a closing is not."""
    drop = load_all(_contact_recording(tmp_path, CLOSINGS_S, 20000.0))[0]
    assert isinstance(drop, Drop)
    assert drop.bounces.impacts_s == pytest.approx(CLOSINGS_S, abs=1.1 / 20000.0)


def test_a_shaken_plate_is_no_drop_test(tmp_path: Path) -> None:
    """The same closings on a plate that is shaken by 1 g are refused."""
    with pytest.raises(InputError, match="needs the plate at rest"):
        load_all(_contact_recording(tmp_path, CLOSINGS_S, 20000.0, shaken_v=0.1))
