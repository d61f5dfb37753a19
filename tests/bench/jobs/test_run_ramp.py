"""A stopped ramp goes on as a new recording that names the first."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.jobs.run_ramp import continued, make_backend, record
from bench.profiles.find import load
from daq.recording import open_recording
from daq.setup.errors import InputError
from rig.backends.simulated import SimulatedBackend
from rig.profile import parse_profile
from tests.fakes.faults import FaultyBackend, Unplugged

GAMMA = "gamma = { start = 0.4, stop = 2.6, steps = 23 }   # or a list: gamma = [0.5, 0.7]"


def profile_of(*gammas: float):
    """The simulated rig with a few gammas, and its text."""
    _, text = load("simulated")
    assert GAMMA in text
    text = text.replace(GAMMA, f"gamma = {list(gammas)}").replace('order = "up"', "")
    return parse_profile(text), text


def test_goes_on_at_the_first_unfinished_step(tmp_path: Path) -> None:
    """The card goes away in the second of three steps: the second and third follow in a new file."""
    profile, text = profile_of(0.4, 0.5, 0.6)
    first, second = tmp_path / "a.h5", tmp_path / "b.h5"
    backend = FaultyBackend(make_backend(profile), [Unplugged(30_000)])
    assert record(profile, text, backend, first, quiet=True).how == "failed"
    rest, keys = continued(profile, first)
    assert rest.ramp.gammas() == (0.5, 0.6)
    assert (keys["continues"], keys["from_step"]) == ("a.h5", 1)
    assert record(rest, text, make_backend(rest), second, extra=keys, quiet=True).how == "complete"
    with open_recording(second) as recording:
        assert recording.steps["gamma"].tolist() == [0.5, 0.6]
        assert recording.attrs["extra"]["continues"] == "a.h5"
    with pytest.raises(InputError, match="all 3 steps were finished"):
        continued(profile, second)
    assert continued(profile, second, 2)[0].ramp.gammas() == (0.6,)


def test_another_ramp_or_step_is_refused(tmp_path: Path) -> None:
    """A profile with other gammas, or a step that does not exist, is refused in words."""
    profile, text = profile_of(0.4)
    record(profile, text, make_backend(profile), tmp_path / "a.h5", quiet=True)
    with pytest.raises(InputError, match="another ramp"):
        continued(profile_of(0.4, 0.5)[0], tmp_path / "a.h5")
    with pytest.raises(InputError, match="steps 0 to 0"):
        continued(profile, tmp_path / "a.h5", 1)


def test_a_watched_run_is_paced_on_the_simulated_rig_and_opens_a_device_as_any_other() -> None:
    """The page's run on a sound card is not refused for keeping to the clock, which a card does by itself."""
    assert make_backend(load("soundcard")[0], watched=True).name == "soundcard"
    watched, free = (make_backend(load("simulated")[0], watched=on) for on in (True, False))
    assert isinstance(watched, SimulatedBackend) and watched._real_time
    assert isinstance(free, SimulatedBackend) and not free._real_time
