"""The programme: steps on cycle boundaries, bounded slew, peaks, limits."""

from __future__ import annotations

import numpy as np
import pytest

from daq.setup.errors import InputError
from rig.programme.ramp import forbidden, peaks, plan


def test_steps_follow_one_another_on_cycle_boundaries(make_profile) -> None:
    """Each step begins where the one before ends, at the first sample of a cycle, and counts its parts in cycles."""
    programme = plan(make_profile())
    clock = programme.clock
    assert programme.steps[0].first_sample == 0
    for before, step in zip(programme.steps, programme.steps[1:], strict=False):
        assert step.first_sample == before.end_sample
    for step in programme.steps:
        assert clock.cycle_start(clock.cycle_after(step.first_sample)) == step.first_sample
        hold = step.n_samples - step.settle_samples
        assert abs(hold * clock.num / clock.den - step.hold_cycles) < clock.num / clock.den
    assert [step.direction for step in programme.steps] == [1, 1, -1]
    assert programme.n_samples == programme.steps[-1].end_sample


@pytest.mark.parametrize("slew", [0.01, 0.05, 0.3])
def test_slew_is_bounded(make_profile, slew: float) -> None:
    """No fade changes gamma faster than the profile's slew, at its steepest."""
    profile = make_profile(("settle_cycles = 2", f"settle_cycles = 2\nslew_per_cycle = {slew}"))
    programme = plan(profile)
    before = 0.0
    for step in programme.steps:
        cycles = step.fade_samples * programme.clock.num / programme.clock.den
        assert 1.5 * abs(step.gamma - before) / cycles <= slew * (1 + programme.clock.num / programme.clock.den)
        before = step.gamma


@pytest.mark.parametrize(("ratio", "gamma_peak"), [(1, 2.0), (2, 4.3934), (3, 10.0)])
def test_gamma_peak(make_profile, ratio: int, gamma_peak: float) -> None:
    """gamma_peak is max(sin + c^2 sin c) at gamma = 1; at c = 1 twice gamma, at c = 3 found by brute force."""
    profile = make_profile(ratio=ratio)
    phi = np.linspace(0, 2 * np.pi, 2_000_001)
    brute = float(np.max(np.sin(phi) + ratio**2 * np.sin(ratio * phi)))
    found = peaks(profile, 1.0).gamma_peak
    assert found == pytest.approx(brute, rel=1e-8)
    assert ratio == 3 or found == pytest.approx(gamma_peak, abs=0.5)


def test_peaks_of_one_sine_by_hand(make_profile) -> None:
    """At c = 1 every peak follows from A = gamma g / w^2 by hand, doubled by the two tones."""
    profile = make_profile()
    w, g = 2 * np.pi * 25.37, 9.80665
    asked = peaks(profile, 0.5)
    assert asked.gamma_peak == pytest.approx(1.0)
    assert asked.acceleration_mps2 == pytest.approx(g)
    assert asked.velocity_mps == pytest.approx(g / w)
    assert asked.displacement_m == pytest.approx(g / w**2)
    assert asked.drive_v == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("limit", "name"),
    [("drive_v = 9.5", "drive_v"), ("plate_mps2 = 120.0", "plate_mps2"), ("displacement_m = 0.02", "displacement_m"),
     ("velocity_mps = 2.0", "velocity_mps")],
)  # fmt: skip
def test_each_limit_forbids(make_profile, limit: str, name: str) -> None:
    """Each limit, when low, forbids every step by its own name; when high, none."""
    quiet = ("[ramp]", "[backend]\nmarker_v = 1e-6\n[ramp]")  # a louder marker is refused with the profile
    low = make_profile((limit, f"{name} = 1e-5"), quiet)
    lines = [line for step in plan(low).steps for line in forbidden(low.limits, step, peaks(low, step.gamma))]
    assert len(lines) == 3
    assert all(f"limits.{name} allows 1e-05" in line for line in lines)
    assert "step 1 (gamma 0.5)" in lines[1]
    fine = make_profile()
    assert not [x for step in plan(fine).steps for x in forbidden(fine.limits, step, peaks(fine, step.gamma))]


@pytest.mark.parametrize("slew", ["1e-9", "1e-300"])
def test_a_ramp_of_years_is_refused(make_profile, slew: str) -> None:
    """A slew mistyped by powers of ten makes a ramp of years, which is refused with its length and the longest."""
    with pytest.raises(InputError, match=r"would end after .* a run lasts at most 30 days"):
        plan(make_profile(("settle_cycles = 2", f"settle_cycles = 2\nslew_per_cycle = {slew}")))


def test_a_forcing_too_slow_for_its_clock_is_refused(make_profile) -> None:
    """A frequency of which a sample is no measurable part is bad input, said in one line."""
    profile = make_profile()
    slow = profile.model_copy(update={"forcing": profile.forcing.model_copy(update={"frequency_hz": 1e-300})})
    with pytest.raises(InputError, match="no usable phase clock"):
        plan(slow)


def test_peaks_grow_with_gamma(make_profile) -> None:
    """Every peak at gamma = 2.5 is two and a half times that at 1."""
    profile = make_profile()
    one, more = peaks(profile, 1.0), peaks(profile, 2.5)
    for name in ("gamma_peak", "drive_v", "acceleration_mps2", "velocity_mps", "displacement_m"):
        assert getattr(more, name) == pytest.approx(2.5 * getattr(one, name), rel=1e-14)
