"""The sequencer: a table of states, samples that no block shows in, stops from anywhere."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.files.tables import STEP_DTYPE
from rig.profile import Profile
from rig.programme.ramp import plan, stop_fade_samples
from rig.programme.sequencer import (
    BLOCKS_PER_CYCLE,
    TRANSITIONS,
    Event,
    Sequencer,
    State,
    Stop,
    change_rows,
    largest_block,
)
from tests.fakes.commanded_drive import commanded, fades_of_changes, fades_of_steps


def rows(marks) -> np.ndarray:
    """The step table that ``marks`` make: the last mark of a first sample stands."""
    last = {step.first_sample: step for step in marks}
    table = np.zeros(len(last), STEP_DTYPE)
    for row, step in zip(table, last.values(), strict=True):
        for name in ("first_sample", "n_samples", "settle_samples", "fade_samples", "gamma"):
            row[name] = getattr(step, name)
    return table


def drive_all(sequencer: Sequencer, block: int, stop_at: int | None = None, how: Stop = Stop.RAMP_DOWN) -> np.ndarray:
    """Everything the sequencer plays, in blocks, with a stop before the block that reaches ``stop_at``."""
    pieces = []
    while not sequencer.done:
        if stop_at is not None and sequencer.position >= stop_at:
            sequencer.stop(how)
        pieces.append(sequencer.take(block))
    return np.concatenate(pieces)


def test_table_leads_everywhere_and_out() -> None:
    """Every state but the last has a way on, every state is reached, and no stop is ever undefined."""
    for state in State:
        assert ((state, Event.STOP) in TRANSITIONS and (state, Event.CUT) in TRANSITIONS) or state is State.STOPPING
        assert state is State.DONE or any(s is state and after is not state for (s, _), after in TRANSITIONS.items())
    assert set(TRANSITIONS.values()) == set(State)
    stopped = {TRANSITIONS[state, Event.STOP] for state in State}
    assert stopped <= {State.STOPPING, State.RESTING, State.DONE}


@settings(max_examples=25, deadline=None)
@given(block=st.integers(1, 700))
def test_blocks_do_not_show(three_steps: Profile, block: int) -> None:
    """A whole run is the same, bit for bit, in blocks of any size."""
    sequencer, reference = (fresh(three_steps) for _ in range(2))
    whole = drive_all(reference, 4096)
    run = drive_all(sequencer, block)
    n = min(len(whole), len(run))
    assert np.array_equal(run[:n], whole[:n])
    assert not np.any(run[n:]) and not np.any(whole[n:])
    assert rows(sequencer.marks).tolist() == rows(reference.marks).tolist()


@pytest.fixture(scope="session")
def three_steps(make_profile: Callable[..., Profile]) -> Profile:
    """The tests' profile, two tones; frozen, so that examples may share it."""
    return make_profile(ratio=2)


def fresh(profile: Profile) -> Sequencer:
    """A new run of the profile."""
    return Sequencer(plan(profile), profile)


@settings(max_examples=40, deadline=None)
@given(stop_at=st.integers(0, 2600), block=st.integers(1, 19), how=st.sampled_from([Stop.RAMP_DOWN, Stop.NOW]))
def test_stop_anywhere_ends_at_zero_and_is_reproduced(
    three_steps: Profile, stop_at: int, block: int, how: Stop
) -> None:
    """From a stop at any sample: zero within two cycles, no jump, and the table alone gives every sample again."""
    sequencer = fresh(three_steps)
    run = drive_all(sequencer, block, stop_at, how)
    clock = sequencer.programme.clock
    asked = -(-stop_at // block) * block
    zero_from = asked if how is Stop.NOW else None
    by_steps = fades_of_steps(three_steps, rows(sequencer.marks), zero_from=zero_from)
    by_changes = fades_of_changes(three_steps, change_rows(three_steps, sequencer.fades))
    for fades in (by_steps, by_changes):
        assert np.array_equal(commanded(three_steps, fades, 0, len(run)), run)
        assert np.array_equal(commanded(three_steps, fades, 333, 500), np.pad(run, (0, 900))[333:833])
    if asked < sequencer.programme.n_samples:
        assert not np.any(run[asked + clock.cycle_start(2) :])
    if how is Stop.RAMP_DOWN:
        steepest = np.abs(np.diff(drive_all(fresh(three_steps), 64))).max()
        assert np.abs(np.diff(run)).max() <= 2.0 * steepest


def test_finish_step_holds_to_its_end(three_steps: Profile) -> None:
    """A gentle stop completes the step under way and begins no other."""
    sequencer = fresh(three_steps)
    first = sequencer.programme.steps[0]
    drive_all(sequencer, 8, first.first_sample + 5, Stop.FINISH_STEP)
    table = rows(sequencer.marks)
    assert table["n_samples"].tolist() == [first.n_samples]
    assert sequencer.step.index == 0


def test_marks_say_when_a_step_begins_and_how_it_ended(three_steps: Profile) -> None:
    """A whole run marks each step twice: as planned at its first sample, as driven at its last."""
    sequencer = fresh(three_steps)
    drive_all(sequencer, 33)
    assert sequencer.marks == [step for step in sequencer.programme.steps for _ in range(2)]


def test_no_settling_and_a_second_stop(three_steps: Profile) -> None:
    """A state of no length is passed through, and asking twice changes nothing."""
    short = three_steps.model_copy(update={"ramp": three_steps.ramp.model_copy(update={"settle_cycles": 0})})
    sequencer = Sequencer(plan(short), short)
    sequencer.take(sequencer.step.settle_samples + 1)
    assert sequencer.state is State.HOLDING
    sequencer.stop(Stop.RAMP_DOWN)
    sequencer.take(3)
    sequencer.stop(Stop.RAMP_DOWN)
    rest = np.concatenate([sequencer.take(50) for _ in range(10)])
    assert sequencer.done and not np.any(rest[stop_fade_samples(sequencer.programme.clock) - 3 :])


def test_block_size_leaves_time_to_stop(make_profile) -> None:
    """Blocks are short enough that noticing a stop and fading take two cycles at most."""
    for frequency in ("25.37", "40.0", "20.0"):
        clock = plan(make_profile(("25.37", frequency))).clock
        block = largest_block(clock, 1024)
        assert block * BLOCKS_PER_CYCLE * clock.num <= clock.den
        assert 2 * block + stop_fade_samples(clock) <= 2 * clock.den / clock.num


@settings(max_examples=20, deadline=None)
@given(block=st.integers(1, 60), waits=st.lists(st.integers(0, 400), min_size=6, max_size=6))
def test_controlled_settling(three_steps: Profile, block: int, waits: list[int]) -> None:
    """Under control a step settles until told, whatever is changed meanwhile; the changes alone give every sample."""
    sequencer = Sequencer(plan(three_steps), three_steps, controlled=True)
    clock, pieces, fades_end = sequencer.programme.clock, [], 0
    while not sequencer.done:
        pieces.append(sequencer.take(block))
        if sequencer.state is State.SETTLING and sequencer.position >= fades_end and waits:
            if waits.pop() % 2:
                fades_end = sequencer.retarget(tuple(1.1 * v for v in sequencer.amplitudes), 3)
            else:
                sequencer.settled()
        elif sequencer.state is State.SETTLING and not waits:
            sequencer.settled()
    run = np.concatenate(pieces)
    fades = fades_of_changes(three_steps, change_rows(three_steps, sequencer.fades))
    assert np.array_equal(commanded(three_steps, fades, 0, len(run)), run)
    ended = [step for i, step in enumerate(sequencer.marks) if i % 2]
    assert len(ended) == 3
    for step in ended:
        hold_from = step.first_sample + step.settle_samples
        assert clock.cycle_start(clock.cycle_after(hold_from)) == hold_from
        assert step.end_sample == clock.cycle_start(clock.cycle_after(hold_from) + step.hold_cycles)


def test_only_settling_may_be_retargeted(three_steps: Profile) -> None:
    """A hold is never disturbed."""
    sequencer = fresh(three_steps)
    with pytest.raises(ValueError, match="while fading"):
        sequencer.retarget(sequencer.amplitudes, 2)


def test_pause_keeps_the_amplitude_and_goes_on_with_a_cycle(three_steps: Profile) -> None:
    """Asked to pause: the step ends as planned, its amplitude stays, and the next step begins with a whole cycle."""
    sequencer, clock = fresh(three_steps), fresh(three_steps).programme.clock
    sequencer.pause(True)
    pieces = []
    while sequencer.state is not State.PAUSED:
        pieces.append(sequencer.take(10))
    pieces += [sequencer.take(10) for _ in range(50)]
    assert sequencer.state is State.PAUSED and np.max(np.abs(pieces[-9:])) > 0.0
    sequencer.pause(False)
    pieces.append(drive_all(sequencer, 10))
    table = rows(sequencer.marks)
    assert len(table) == 3 and table[1]["first_sample"] > table[0]["first_sample"] + table[0]["n_samples"] + 400
    assert table[1]["first_sample"] == clock.cycle_start(clock.cycle_after(int(table[1]["first_sample"])))
    run = np.concatenate(pieces)
    assert np.array_equal(run, commanded(three_steps, fades_of_steps(three_steps, table), 0, len(run)))


@pytest.mark.parametrize("how", list(Stop))
def test_every_stop_ends_a_pause(three_steps: Profile, how: Stop) -> None:
    """A paused run heeds every stop, finishing the step included, and ends at zero."""
    sequencer = fresh(three_steps)
    sequencer.pause(True)
    while sequencer.state is not State.PAUSED:
        sequencer.take(10)
    sequencer.take(100)
    sequencer.stop(how)
    run = drive_all(sequencer, 10)
    assert sequencer.done and not np.any(run[-10:]) and len(rows(sequencer.marks)) == 1


def test_pause_that_nobody_ends_is_a_stop(three_steps: Profile, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run left alone in a pause ramps down."""
    monkeypatch.setattr("rig.programme.sequencer.LONGEST_PAUSE_S", 0.5)
    sequencer = fresh(three_steps)
    sequencer.pause(True)
    drive_all(sequencer, 10)
    assert len(rows(sequencer.marks)) == 1


def test_steering_takes_the_place_of_the_programmes_fades(make_profile) -> None:
    """Orders are carried out at their sample, steps keep their length, and after a release the drive is the plan's."""
    profile = make_profile()
    programme = plan(profile)
    sequencer, other = Sequencer(programme, profile), Sequencer(programme, profile)
    played = [sequencer.take(20) for _ in range(10)]
    sequencer.steer(205, 7, (0.1 + 0.05j,))
    with pytest.raises(ValueError, match="waiting"):
        sequencer.steer(300, 7, (0.1 + 0j,))
    second = programme.steps[1].first_sample
    while sequencer.position < second + 40:
        played.append(sequencer.take(20))
    assert sequencer.planned(sequencer.position) != sequencer.amplitudes  # the step fades, as planned
    sequencer.release(2)
    played.append(drive_all(sequencer, 20))
    whole, plain = np.concatenate(played), drive_all(other, 20)
    assert len(whole) == len(plain)
    np.testing.assert_array_equal(whole[:205], plain[:205])
    again = commanded(profile, fades_of_changes(profile, change_rows(profile, sequencer.fades)), 0, len(whole))
    np.testing.assert_array_equal(whole, again)
    steered = [fade for fade in sequencer.fades if fade.first_sample == 205]
    assert steered[0].end == (0.1 + 0.05j,)
    late = programme.steps[2].first_sample
    np.testing.assert_allclose(whole[late:], plain[late:], rtol=0, atol=1e-12)
