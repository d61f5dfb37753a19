"""A rig that chooses its own steps: within the limits, to the hidden cause, from where it was stopped."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import shakerbench as sb
from analysis.attribution.candidates import parameter_of
from analysis.explore.choice import Pool
from analysis.explore.explanations import Explanation, Weighed
from analysis.loop.result import DetectionLimits
from bench.commands.ramp import Driver
from bench.jobs.blocks import Aims, Driven, by_person, offers, run_seconds, tells
from bench.jobs.blocks import Chosen as Block
from bench.jobs.explore import _can_be_shown, _held, _in_vain, _next, _not_shown, explore
from bench.jobs.run_ramp import make_backend
from bench.profiles.edit import with_values
from bench.profiles.find import load, planned
from bench.terminal.run_console import obey
from daq.recording import open_recording
from daq.recording.writer import RecordingWriter
from daq.setup.errors import InputError
from rig.execution.operator import StopRequest
from rig.execution.run import run_ramp
from rig.profile import parse_profile
from rig.programme.ramp import NextSteps
from rig.programme.sequencer import State, Stop

TEXT = load("simulated")[1]


def test_every_offer_is_within_the_limits():
    """No gamma is offered that a limit of the rig forbids, however low the limits are; none at all is said."""
    tight = with_values(TEXT, {"limits.plate_mps2": 60.0}, "p")
    for option in offers(tight, Aims(60.0)):
        ramp = {"ramp.gamma": list(option.gammas), "forcing.ratio": option.setup.forcing.ratio, "ramp.order": "up"}
        assert not planned(parse_profile(with_values(tight, ramp, "p")))[2]
    with pytest.raises(InputError, match="allow no block"):
        offers(with_values(TEXT, {"limits.plate_mps2": 3.0}, "p"), Aims(60.0))


def test_blocks_wait_for_the_plate_alone():
    """A step of a block settles for as many cycles as are asked for, whatever the profile's ramp waits."""
    brief, waited = (offers(TEXT, Aims(60.0, settle_cycles=n))[0] for n in (3, 7))
    assert (brief.setup.forcing, brief.rising) == (waited.setup.forcing, waited.rising)
    for steps in (4, 8):
        longer_s = waited.seconds(range(steps)) - brief.seconds(range(steps))
        assert longer_s == pytest.approx(steps * 4 / brief.setup.forcing.frequency_hz, rel=1e-3)


def test_steps_are_held_longer_while_something_is_unexplained():
    """Twice the cycles after an unexplained verdict, the cycles asked for before a verdict and after any other."""
    aims = Aims(60.0, hold_cycles=9)
    assert _held(aims, SimpleNamespace(verdict="unexplained")).hold_cycles == 18
    assert _held(aims, None) == _held(aims, SimpleNamespace(verdict="explained")) == aims


def test_blocks_are_spread_until_a_verdict_is_possible():
    """With too few steps for a verdict the next block is of another forcing, from above, whatever the best set is."""
    aims = Aims(60.0)
    offered = partial(offered_for, aims)
    first, _ = _next(TEXT, None, (), offered, aims)
    judged = SimpleNamespace(loop=None, fitted=None)
    second, why = _next(TEXT, judged, (first,), offered, aims)
    assert why == "" and "too few steps for a verdict yet: spread over the range" in second.reason
    one, two = (parse_profile(block.text) for block in (first, second))
    assert one.forcing != two.forcing and (one.ramp.order, two.ramp.order) == ("up", "down")
    assert len(one.ramp.gammas()) == len(two.ramp.gammas()) == aims.steps


def test_a_block_that_told_nothing_is_not_driven_again():
    """The same gammas of the same forcing were driven in vain, in whichever order; others were not."""
    block = by_person(Block(TEXT, 1.0, "because"), NextSteps((0.4, 0.2), 2))
    forcing = parse_profile(block.text).forcing
    chosen = SimpleNamespace(option=SimpleNamespace(setup=SimpleNamespace(forcing=forcing)), gammas=(0.2, 0.4))
    assert _in_vain(chosen, [Block(TEXT, 1.0, "because"), block])
    assert not _in_vain(chosen, [Block(TEXT, 1.0, "because")])
    assert not _in_vain(SimpleNamespace(option=chosen.option, gammas=(0.2, 0.3)), [block])


def offered_for(aims, hold_cycles):
    """What may be driven with steps held so long."""
    return offers(TEXT, replace(aims, hold_cycles=hold_cycles))


def weighed_with(first):
    """One explanation, of a calibration and two sizes."""
    keys = (("accelerometer_gain", "relative"), ("adhesion", "a_mps2"), ("quadratic_drag", "k_per_m"))
    return Weighed((first,), keys, 1, np.diag([1.0, 50.0, 50.0]), np.zeros(3))


def test_what_is_not_shown_yet():
    """Detection limits above the sizes that matter; and an effect more probable than all else, at its own size."""
    adhesion, drag = ("adhesion", "a_mps2"), ("quadratic_drag", "k_per_m")
    limits = {key: parameter_of(key).scale for key in (adhesion, drag)}
    loop = SimpleNamespace(
        selection=SimpleNamespace(names=()),
        detection=DetectionLimits(
            {"adhesion.a_mps2": 0.5 * limits[adhesion], "quadratic_drag.k_per_m": 1.5 * limits[drag]}, ()
        ),
    )
    declared = Explanation((), (), {}, 0.6)
    assert _not_shown(loop, Aims(60.0), weighed_with(declared)) == {drag: pytest.approx(1.5)}
    assert _not_shown(loop, Aims(60.0, limit=2.0), weighed_with(declared)) == {}
    values = {adhesion: 0.25 * limits[adhesion]}
    likely = Explanation(("adhesion",), (adhesion,), values, 0.9)
    assert _not_shown(loop, Aims(60.0, limit=2.0), weighed_with(likely)) == {adhesion: pytest.approx(2.0)}
    sure = replace(likely, values={adhesion: 10.0 * limits[adhesion]})  # shown long ago, and still not named
    assert _not_shown(loop, Aims(60.0, limit=2.0), weighed_with(sure))[adhesion] == pytest.approx(2.0**0.5)


def test_what_the_time_left_can_show():
    """Of two limits above what is asked for, the one that enough blocks bring down to it; none without time."""
    adhesion, drag = ("adhesion", "a_mps2"), ("quadratic_drag", "k_per_m")
    option = SimpleNamespace(gammas=(0.5, 0.6), seconds=lambda places: 1.0 * len(places))
    pool = Pool(option, np.array([np.diag([0.0, 50.0, 0.5, 0.0])] * 2), np.zeros(2))
    known = weighed_with(Explanation((), (), {}, 1.0))
    hidden = {adhesion: 1.5, drag: 1.5}
    assert _can_be_shown(hidden, [pool], known, 10.0) == [adhesion]
    assert _can_be_shown(hidden, [pool], known, 0.1) == []


def test_a_person_cannot_pass_the_limits():
    """Gammas typed in place of a choice are planned and refused as any other; good ones are the block."""
    block = Block(TEXT, 1.0, "because")
    with pytest.raises(InputError, match="limits forbid"):
        by_person(block, NextSteps((0.8, 40.0)))
    own = by_person(block, NextSteps((0.4, 0.2), 2, "a look at c = 2"))
    profile = parse_profile(own.text)
    assert profile.ramp.gammas() == (0.4, 0.2) and profile.forcing.ratio == 2 and own.seconds > 0
    assert own.reason == "c = 2, 25.37 Hz, gamma 0.4, 0.2: chosen by a person, a look at c = 2"


def test_a_failed_block_ends_it(tmp_path):
    """A device that fails is the end, with its reason; nothing is simulated in its place."""
    told = []

    def broken(block, path, number):
        return Driven("failed: the device went away")

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
        return Driven("failed: the device went away")

    found = explore(TEXT, tmp_path, Aims(60.0), broken, say=told.append)
    assert found.recordings == () and driven == ["block-02.h5"]
    assert "left out: block-01.h5" in told[0] and "block 2: " in told[1]
    assert whole.exists() and not tells(whole)


class Typist:
    """Types lines at given moments of a run: ``(block of the call, step, state)`` -> line."""

    def __init__(self, lines):
        self.lines, self.block, self.seen = dict(lines), 0, []

    def obeyed(self, request, progress):
        """As `bench.terminal.run_console.TypedLines.obeyed`."""
        self.block += 1

        def after_block(status):
            moment = (self.block, status.step.index, status.state)
            if moment not in self.seen:
                self.seen.append(moment)
            if line := self.lines.pop(moment, ""):
                obey(request, line)
            progress(status)

        return after_block


def test_a_person_holds_goes_on_and_takes_over_within_a_block(tmp_path):
    """Held and gone on with, the block is whole; then own steps follow at once; each choice has its reason."""
    typist = Typist({
        (1, 1, State.HOLDING): "h: a dusty ball",
        (1, 1, State.PAUSED): "g",
        (1, 2, State.HOLDING): "c=2 0.4 0.2: where two motions exist",
        (2, 1, State.HOLDING): "s: enough",
    })  # fmt: skip
    told = []
    found = explore(TEXT, tmp_path, Aims(60.0), Driver(seed=3, quiet=True, typed=typist), say=told.append)
    assert found.failed and found.why == "block 2: stopped: a person: step finished, enough"
    assert (1, 1, State.PAUSED) in typist.seen and (1, 3, State.FADING) not in typist.seen
    with open_recording(tmp_path / "block-01.h5") as first, open_recording(tmp_path / "block-02.h5") as second:
        assert len(first.steps) == 3 and found.blocks[0].seconds == first.n_samples / first.rate_hz
        notes = [text.decode() for text in first.notes["text"]]
        assert notes == ["a person: hold after this step: a dusty ball", "a person: go on"]
        held, after = first.steps[1:3]
        assert after["first_sample"] > held["first_sample"] + held["n_samples"]
        assert "own steps next: where two motions exist" in first.attrs["why"]
        assert second.attrs["extra"]["chosen_because"].endswith("chosen by a person, where two motions exist")
        assert second.setup.forcing.ratio == 2 and second.steps["gamma"].tolist() == [0.4, 0.2]
    assert "chosen by a person" in told[-1]


def test_a_block_may_be_ended_for_another_choice(tmp_path):
    """A person ends a block after one step: it is kept but left out, and the rig chooses again."""
    typist = Typist({(1, 0, State.HOLDING): "n: the wrong ball", (2, 0, State.HOLDING): "s"})
    told = []
    found = explore(TEXT, tmp_path, Aims(60.0), Driver(seed=3, quiet=True, typed=typist), say=told.append)
    assert found.recordings == () and found.why.startswith("block 2: stopped")
    assert any("left out: block-01.h5" in line for line in told)
    with open_recording(tmp_path / "block-01.h5") as first:
        assert "another choice next: the wrong ball" in first.attrs["why"]


def test_steps_that_a_limit_forbids_end_nothing(tmp_path):
    """Own steps beyond the limits are refused at once, and the block goes on."""
    request = StopRequest(partial(by_person, Block(TEXT, 1.0, "because")))
    with pytest.raises(InputError, match="limits forbid"):
        obey(request, "0.8 40: higher")
    assert request.wanted is None and request.then is None


@pytest.mark.slow
def test_it_finds_what_is_hidden_in_a_part_of_the_time(tmp_path):
    """Friction is named, alone, in less than half of the ramp's rig time; every block says why; the rest resumes."""
    profile = sb.load_profile("simulated")
    whole = run_seconds(parse_profile(profile.text))
    drive = Driver(Path("friction"), 23, quiet=True)
    told = []
    found = explore(profile.text, tmp_path, Aims(whole), drive, say=told.append)
    assert (
        found.loop is not None
        and found.loop.selection.names == ("coulomb_friction",)
        and found.loop.verdict == "explained"
    )
    assert found.rig_s < 0.5 * whole
    for path, block in zip(found.recordings, found.blocks, strict=True):
        with open_recording(path) as recording:
            assert recording.attrs["extra"]["chosen_because"] == block.reason
            assert recording.n_samples / recording.rate_hz == pytest.approx(block.seconds, rel=0.02)
    again = explore(profile.text, tmp_path, Aims(whole), drive, say=told.append)
    assert again.recordings == found.recordings and again.why == found.why
