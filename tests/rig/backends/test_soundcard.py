"""The sound card through the real driver: PortAudio, JACK, and the plant in another process."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.jobs.run_ramp import fits
from daq.files.tables import BlockFlag
from daq.recorder.recorder_process import RecorderProcess
from daq.recording import open_recording
from rig.backends.base import BackendError, Lagging, running
from rig.backends.portaudio import DECAY_S
from rig.backends.registry import open_backend
from rig.backends.soundcard import SoundcardBackend
from rig.checks.check import Check
from rig.execution.priority import before_other_work
from rig.execution.run import run_ramp
from rig.profile import Profile, parse_profile
from tests.fakes.commanded_drive import commanded, fades_of_changes

RATE_HZ = 20000.0
BENCH = [sys.executable, "-c", "from bench.cli import main; main()"]
SHORT = (("start = 0.4, stop = 2.6, steps = 23", "start = 0.7, stop = 1.0, steps = 2"), ("# [control]", "[control]"))


@pytest.fixture(autouse=True)
def first() -> Iterator[None]:
    """As `bench ramp` does: before other work, where that is granted."""
    with before_other_work():
        yield


def with_backend(profile: Profile, **changes: Any) -> Profile:
    """The profile with another back end table."""
    table = type(profile.backend).model_validate(profile.backend.model_dump() | changes)
    return profile.model_copy(update={"backend": table})


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"device": "nothing of that name"}, "cards that are there: .*shaker"),
        ({"inputs": {"continuity": 1, "accelerometer": 2, "drive": 7}}, "cannot be opened .* with 7 inputs"),
        ({"inputs": {"continuity": 3, "accelerometer": 2, "drive": 1}}, "input 1 .* does not record the start marker"),
    ],
)
def test_what_does_not_fit_is_said_at_the_start(virtual_card: Profile, changes: dict[str, Any], said: str) -> None:
    """A card that is not there, that has too few inputs, or without the loop-back: refused, with what there is."""
    backend = SoundcardBackend(with_backend(virtual_card, **changes))
    with pytest.raises(BackendError, match=said):
        backend.start()


def test_another_rate_is_refused(virtual_card: Profile) -> None:
    """The card's rate is its own: a profile that says another one is refused, never resampled."""
    sampling = virtual_card.sampling.model_copy(update={"rate_hz": 44100.0})
    profile = virtual_card.model_copy(update={"sampling": sampling})
    with pytest.raises(BackendError, match="cannot be opened at 44100 Hz"):
        SoundcardBackend(profile).start()


def test_time_goes_on_while_nobody_asks(virtual_card: Profile, card_tap: Any) -> None:
    """A pause longer than the buffer costs drive, which is flagged, and no frame; then the drive is in its place.

    Compared at the driver's callback, sample for sample: so it holds however busy the machine is. The back end is the
    profile's; its lag is known once it runs, and is buffer, period and plant together.
    """
    backend = open_backend(virtual_card)
    assert isinstance(backend, SoundcardBackend) and isinstance(backend, Lagging)
    n = 2000
    wave = 0.2 * np.sin(2 * np.pi * np.arange(12 * n) / 400)
    with running(backend):
        lag = backend.lag_samples - 0.15 * backend.rate_hz
        assert 0 < lag <= 2 * 2048 and abs(lag - round(lag)) < 0.05
        codes, flags = [], 0
        for k in range(12):
            if k == 3:
                time.sleep(0.4)
            block = backend.exchange(wave[k * n : (k + 1) * n])
            codes.append(block.codes)
            flags |= block.flags
    assert flags & BlockFlag.UNDERFLOW  # the card ran dry
    begun, origin = card_tap.begun
    kept = np.concatenate(codes)
    delivered = np.concatenate(card_tap.heard)[begun : begun + len(kept)]
    assert np.array_equal(kept, np.rint(delivered * 32768.0).clip(-32768, 32767).astype(np.int16))
    in_place, dry, after_pause = 0, 0, origin + 3 * n + 8000
    for frame, out, handed_over, handed_over_after in card_tap.played:
        index = np.arange(frame, frame + len(out))
        drive = ((index >= origin) & (index - origin < len(wave)) & (index < handed_over)).nonzero()[0]
        expected = (wave[index[drive] - origin] / virtual_card.backend.output_range_v).astype(np.float32)
        assert np.array_equal(out[drive], expected)
        in_place += np.count_nonzero(index[drive] > after_pause)
        nothing = index - max(handed_over_after, frame) > round(DECAY_S * RATE_HZ)
        assert not out[nothing].any()
        dry += np.count_nonzero(nothing & (index > origin))
    assert in_place > 0 and dry > 0


def test_check_refuses_a_latency_over_a_cycle(virtual_card: Profile) -> None:
    """`bench check` through the driver: all is as the profile says, but 0.15 s of buffer are too late for a stop."""
    findings = Check(virtual_card, SoundcardBackend(virtual_card)).run()
    assert {finding.what for finding in findings if not finding.passed} == {"output latency and loop-back delay"}
    assert len(findings) == 15


def test_a_ramp_is_what_the_plant_gave(virtual_sound: tuple[Profile, str], tmp_path: Path) -> None:
    """Closed loop on gamma through the driver: the steps reach their gamma, and the step table lies on the frames."""
    text = virtual_sound[1]
    for old, new in SHORT:
        assert old in text, old
        text = text.replace(old, new)
    profile = parse_profile(text)
    backend = SoundcardBackend(profile)
    writer = RecorderProcess(
        tmp_path / "run.h5", profile.setup(), block_samples=1024, profile_text=text, channels=backend.channels,
        scales=backend.scales, backend=backend.name, simulated=False,
    )  # fmt: skip
    summary = run_ramp(profile, backend, writer)
    assert summary.how == "complete", summary.why
    with open_recording(tmp_path / "run.h5") as recording:
        assert recording.attrs["backend"] == "soundcard" and not recording.attrs["simulated"]
        for step in recording.steps:
            assert step["achieved_gamma"] == pytest.approx(step["gamma"], rel=0.02)
        begin = int(recording.steps["first_sample"][0])
        drive = recording.read_v("drive")
        assert begin > 500 and np.abs(drive[:begin]).max() < 5e-3
        until = int(recording.gaps[0, 0]) if len(recording.gaps) else recording.n_samples  # a busy machine skips
        fades = fades_of_changes(recording.setup, recording.drive_changes)
        asked = commanded(recording.setup, fades, 0, until - begin)
        assert np.mean(np.abs(drive[begin:until] - asked) < 5e-3) > 0.98


def test_a_driver_that_dies_ends_the_run_and_keeps_it(rehearse: Callable[..., Any], tmp_path: Path) -> None:
    """The card goes away in the middle: exit 1 in seconds, the device is named, what was recorded is whole."""
    out = tmp_path / "run.h5"
    with rehearse() as (_, text, virtual):
        (tmp_path / "run.toml").write_text(text, encoding="utf-8")
        command = [*BENCH, "ramp", str(tmp_path / "run.toml"), "--out", str(out)]
        process = subprocess.Popen(command, stderr=subprocess.PIPE, env=dict(os.environ))
        try:
            while not out.exists() or out.stat().st_size < 200_000:
                assert process.poll() is None, process.communicate()
                time.sleep(0.05)
            virtual.terminate()
            _, errors = process.communicate(timeout=30)
        finally:
            process.kill()
    assert process.returncode == 1 and b"sound card 'shaker'" in errors
    with open_recording(out) as recording:
        assert recording.attrs["ended"] == "failed" and "shaker" in recording.attrs["why"]
        assert recording.n_samples > 3000


def test_a_profile_fits_a_card_by_name_and_channels(virtual_card: Profile) -> None:
    """`bench devices` finds the card of a profile, and no other."""
    from rig.backends.portaudio import cards

    there = {card.name: fits(virtual_card, card) for card in cards()}
    assert there["shaker"] and not there["system"]
    table = {"continuity": 1, "accelerometer": 2, "drive": 4}
    assert not any(fits(with_backend(virtual_card, inputs=table), card) for card in cards())
