"""A rig that chooses its own steps: within the limits, to the hidden cause, from where it was stopped."""

from functools import partial
from pathlib import Path

import pytest

import shakerbench as sb
from bench.commands.explore import _drive
from bench.jobs.explore import Aims, explore, offers, run_seconds, with_gammas
from bench.jobs.explore import Chosen as Block
from bench.jobs.run_ramp import make_backend
from bench.profiles.edit import with_values
from bench.profiles.find import load
from bench.profiles.plan import planned
from daq.recording import RecordingWriter, open_recording
from daq.setup.errors import InputError
from rig.execution.run import StopRequest, run_ramp
from rig.profile import parse_profile
from rig.programme.sequencer import Stop

TEXT = load("simulated")[1]


def test_every_offer_is_within_the_limits():
    """No gamma is offered that a limit of the rig forbids, however low the limits are; none at all is said."""
    tight = with_values(TEXT, {"limits.plate_mps2": 60.0}, "p")
    for option in offers(tight, Aims(60.0)):
        ramp = {"ramp.gamma": list(option.gammas), "forcing.ratio": option.setup.forcing.ratio, "ramp.order": "up"}
        assert not planned(parse_profile(with_values(tight, ramp, "p")))[2]
    with pytest.raises(InputError, match="allow no block"):
        offers(with_values(TEXT, {"limits.plate_mps2": 3.0}, "p"), Aims(60.0))


def test_a_person_cannot_pass_the_limits():
    """Gammas typed in place of a choice are planned and refused as any other; good ones are the block."""
    block = Block(TEXT, 1.0, "because")
    with pytest.raises(InputError, match="limits forbid"):
        with_gammas(block, [0.8, 40.0])
    own = with_gammas(block, [0.8, 1.2])
    assert parse_profile(own.text).ramp.gammas() == (0.8, 1.2) and own.seconds > 0 and "a person" in own.reason


def test_a_failed_block_ends_it(tmp_path):
    """A device that fails is the end, with its reason; nothing is simulated in its place."""
    told = []

    def broken(block, path, number):
        return "failed: the device went away"

    found = explore(TEXT, tmp_path, Aims(60.0), broken, say=told.append)
    assert found.failed and "device went away" in found.why and found.recordings == ()
    assert "nothing is known yet" in told[0]


def test_a_block_stopped_at_once_is_left_out(tmp_path):
    """A block that a person stopped before two steps were held is said, kept, and in nobody's way."""
    whole, text = tmp_path / "block-01.h5", with_values(TEXT, {"ramp.gamma": [0.6, 0.8, 1.0]}, "p")

    profile = parse_profile(text)
    backend = make_backend(profile, seed=3)
    writer = RecordingWriter(
        whole, profile.setup(), profile_text=text, channels=backend.channels, scales=backend.scales,
        backend=backend.name, simulated=True,
    )  # fmt: skip
    request = StopRequest()
    request.ask(Stop.RAMP_DOWN, "a person")
    run_ramp(profile, backend, writer, stop_request=request)
    told, driven = [], []

    def broken(block, path, number):
        driven.append(path.name)
        return "failed: the device went away"

    found = explore(TEXT, tmp_path, Aims(60.0), broken, say=told.append)
    assert found.recordings == () and driven == ["block-02.h5"]
    assert "left out: block-01.h5" in told[0] and "block 2: " in told[1]
    assert whole.exists()


@pytest.mark.slow
def test_it_finds_what_is_hidden_in_a_part_of_the_time(tmp_path):
    """Friction is named, alone, in less than half of the ramp's rig time; every block says why; the rest resumes."""
    profile = sb.load_profile("simulated")
    whole = run_seconds(parse_profile(profile.text))
    drive = partial(_drive, Path("friction"), 23, True)
    told = []
    found = explore(profile.text, tmp_path, Aims(whole), drive, say=told.append)
    assert found.loop is not None and found.loop.names == ("coulomb_friction",) and found.loop.verdict == "explained"
    assert found.rig_s < 0.5 * whole
    for path, block in zip(found.recordings, found.blocks, strict=True):
        with open_recording(path) as recording:
            assert recording.attrs["extra"]["chosen_because"] == block.reason
            assert recording.n_samples / recording.rate_hz == pytest.approx(block.seconds, rel=0.02)
    again = explore(profile.text, tmp_path, Aims(whole), drive, say=told.append)
    assert again.recordings == found.recordings and again.why == found.why
