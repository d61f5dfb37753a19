"""Words of the report: what is left after a fit."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from analysis.discovery.symbolic import FORMS
from analysis.loop.result import AddedEffect
from analysis.loop.verdict import Failed
from analysis.report.narrative import headline, reasoning
from analysis.report.wording import (
    coverage_in_words,
    discovered_in_words,
    lost_in_words,
    what_is_left,
    why_this_verdict,
)
from analysis.thresholds import FROZEN
from tests.loops import changed, found_by


def left(p, ratio, **more):
    """A closed loop of which only the remainder is known."""
    return SimpleNamespace(remainder=SimpleNamespace(p_lack_of_fit=p, ratio=ratio, **more), limits=FROZEN)


def test_a_certain_remainder_is_not_called_noise():
    """With p below the threshold the size is told; only what may be noise is said to look like it."""
    assert what_is_left(left(0.3, 1.0)) == "what is left looks like noise (p = 0.3)"
    assert "hardly noise, but let pass (p = 0.00027" in what_is_left(left(2.7e-4, 1.0))
    certain = what_is_left(left(1e-12, 1.1))
    assert "noise (p" not in certain and "1.10 times the noise" in certain
    each = what_is_left(left(1e-12, 1.3, landing_ratio=0.97, p_takeoffs=0.02))
    assert "landings is 0.97 times the noise" in each and "take-offs look like noise (p = 0.02)" in each


@pytest.mark.parametrize("verdict", ["explained", "unexplained", "nothing_missing"])
def test_a_number_that_a_few_landings_make_never_contradicts_the_verdict(closed_loop, verdict):
    """3637 us beside a floor of 46: every sentence with the number says that 24 landings of 1900 make it."""
    after = replace(
        closed_loop.errors.after, landing_rms_us=3637.0, flights=1900, lost=24, landing_rms_us_without_lost=41.0
    )
    loop = changed(closed_loop, verdict=verdict, after=after, failed=())
    words = "24 of 1900 held-out landings were not as predicted; without them 41.0 us rms"
    assert lost_in_words(loop) == words
    assert words in headline(loop)
    assert f"{words}." in why_this_verdict(loop)


def test_take_offs_that_alone_are_late_lead_to_the_contact(closed_loop):
    """Landings are as predicted, take-offs are not: the sentence names the contact, not the ball."""
    failed = (Failed("flights", 2.0, FROZEN.lack_ratio),)
    for landing_ratio in (1.0, 1.9):
        remainder = replace(closed_loop.remainder, p_lack_of_fit=1e-12, ratio=2.0, landing_ratio=landing_ratio)
        loop = changed(closed_loop, verdict="unexplained", failed=failed, remainder=remainder)
        assert ("look for a contact that opens late" in why_this_verdict(loop)[0]) == (landing_ratio == 1.0)


def test_what_a_discovery_leaves_of_a_few_landings_is_said(closed_loop):
    """A law of the restitution that is right but for ten bounces: its error was 11210 us, without a word."""
    loop = found_by(closed_loop, "restitution", "plate_at_impact_mps2", FORMS[0], "1")
    after = replace(loop.errors.after, landing_rms_us=11210.0, flights=143, lost=10, landing_rms_us_without_lost=20.0)
    lines = discovered_in_words(changed(loop, discovered=replace(loop.discovered, after=after)))
    assert lines[-1] == "10 of 143 held-out landings were not as predicted; without them 20.0 us rms"
    assert discovered_in_words(closed_loop) == []


def test_landings_that_change_no_number_are_not_spoken_of(closed_loop):
    """None lost, or an error that is the same without them: no words."""
    for lost, rms, without in ((0, 10.0, 10.0), (1, 10.0, 9.5)):
        after = replace(
            closed_loop.errors.after, landing_rms_us=rms, flights=1900, lost=lost, landing_rms_us_without_lost=without
        )
        assert lost_in_words(changed(closed_loop, after=after)) == ""


def test_an_interval_comes_with_what_intervals_of_its_kind_have_held(closed_loop):
    """A modulation has a count of its own, any other effect that of all others; nothing named, nothing said."""
    said = []
    for names in (("amplitude_modulation",), ("spring",), ()):
        effects = tuple(AddedEffect(name, {}) for name in names)
        loop = changed(closed_loop, effects=effects)
        said.append(coverage_in_words(loop))
        assert all(f"{words}." in reasoning(loop) for words in said[-1])
    own, other, none = said
    assert none == [] and len(own) == len(other) == 1
    assert own[0].split("held")[1] != other[0].split("held")[1]
