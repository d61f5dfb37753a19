"""What a person types during a run: understood, refused in words, and never waited for."""

import os
import sys
import time

import pytest

from bench.terminal.run_console import TypedLines, obey, steps_from
from daq.setup.errors import InputError
from rig.execution.operator import StopRequest
from rig.programme.ramp import NextSteps
from rig.programme.sequencer import Stop


@pytest.mark.parametrize(
    ("text", "steps"),
    [
        ("0.8, 1.2: too quiet: really", NextSteps((0.8, 1.2), None, "too quiet: really")),
        ("c=2 0.4,0.2", NextSteps((0.4, 0.2), 2)),
        (" ", NextSteps()),
        (": the wrong ball", NextSteps((), None, "the wrong ball")),
    ],
)
def test_steps_are_read_from_words(text, steps):
    """Gammas with commas or blanks, c where it changes, and the reason after a colon."""
    assert steps_from(text) == steps


@pytest.mark.parametrize("text", ["0.8 x", "c=2", "c=two 1", "-1", "nan", "inf", "c=0 1"])
def test_what_is_no_step_is_refused(text):
    """Anything else is refused with what is wanted."""
    with pytest.raises(InputError, match="wanted"):
        steps_from(text)


def test_lines_become_requests():
    """Hold, go on, own steps, another choice and stop; the last of equal stops counts, and reasons are kept."""
    asked = []
    request = StopRequest(asked.append)
    for line in ("", "h: again", "go", "G"):
        obey(request, line)
    assert not request.pause and request.notes == ["a person: hold after this step", "a person: go on"]
    obey(request, "0.8 1.2: nearer")
    assert request.wanted is Stop.FINISH_STEP and request.then == asked[0] == NextSteps((0.8, 1.2), None, "nearer")
    obey(request, "n")
    assert request.then == NextSteps()
    obey(request, "s: enough")
    assert request.then is None and request.why.endswith("enough")
    request.ask(Stop.RAMP_DOWN, "SIGINT")
    obey(request, "0.8")
    assert request.wanted is Stop.RAMP_DOWN and request.then is None  # a stronger stop is the end


def test_a_ramp_has_no_steps_of_its_own():
    """Where nothing follows a run, steps typed are refused and the run goes on."""
    request = StopRequest()
    with pytest.raises(InputError, match="start another"):
        obey(request, "0.8")
    assert request.wanted is None and not request.leads


@pytest.mark.skipif(sys.platform == "win32", reason="a pseudo-terminal is POSIX's")
def test_typed_lines_are_taken_without_waiting(capsys):
    """Whole lines are taken as they come, half of one is waited for by nobody, and a closed terminal answers None."""
    ours, theirs = os.openpty()
    typed, request, seen = TypedLines(theirs), StopRequest(), []
    after_block = typed.obeyed(request, seen.append)
    os.write(ours, b"nonsense\nh: du")
    until = time.monotonic() + 10.0
    while "wanted" not in capsys.readouterr().err and time.monotonic() < until:
        after_block("status")
    assert seen and not request.pause
    os.write(ours, b"st\n")
    while not request.pause and time.monotonic() < until:
        after_block("status")
    assert request.notes == ["a person: hold after this step: dust"]
    os.write(ours, b"\x04")  # the end of what is typed
    assert typed.answer("drive it") is None and typed.take() == []
    os.close(ours)
    os.close(theirs)
