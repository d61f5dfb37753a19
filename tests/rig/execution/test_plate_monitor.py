"""The motion watch: the plate's peaks without the impacts, and the samples that ring."""

from __future__ import annotations

import numpy as np
import pytest

from rig.execution.plate_monitor import MotionWatch

RATE_HZ, F_HZ, SCALE = 20000.0, 25.37, 0.03


def codes(gravity: float = 0.0, hits: tuple[int, ...] = (), seed: int = 0) -> np.ndarray:
    """Two seconds of 20 m/s^2 at the forcing, fading in, with noise, an offset, and ringing at ``hits``."""
    n = np.arange(40000)
    a = 20.0 * np.minimum(n / 8000, 1.0) * np.sin(2 * np.pi * F_HZ * n / RATE_HZ)
    for hit in hits:
        since = n - hit
        a += np.where(since >= 0, 60.0 * np.exp(-np.maximum(since, 0) / 20.0) * np.sin(0.53 * since), 0.0)
    a += gravity + np.random.default_rng(seed).normal(0.0, 0.3, n.size)
    return np.rint(a / SCALE).astype(np.int16)


def watch(make_profile) -> MotionWatch:
    """A watch at 20 kHz."""
    return MotionWatch(make_profile(("rate_hz = 2000", "rate_hz = 20000")), SCALE)


@pytest.mark.parametrize("gravity", [0.0, 9.81, -9.81])
def test_peaks_of_a_steady_sine(make_profile, gravity: float) -> None:
    """Acceleration, velocity and displacement of a sine come out within a tenth, whatever gravity or offset is read."""
    follower, signal = watch(make_profile), codes(gravity)
    follower.update(signal[:20000])
    motion = follower.update(signal[20000:])
    w = 2 * np.pi * F_HZ
    assert motion.acceleration_mps2 == pytest.approx(20.0, rel=0.08)
    assert motion.velocity_mps == pytest.approx(20.0 / w, rel=0.1)
    assert motion.displacement_m == pytest.approx(20.0 / w**2, rel=0.1)


def test_impacts_are_marked_and_kept_out_of_the_peak(make_profile) -> None:
    """Ringing three times as high as the motion leaves the peak alone, and every sample that rings is marked."""
    hits = (15000, 20345, 31111)
    motion, clean = (watch(make_profile).update(codes(hits=h)) for h in (hits, ()))
    assert motion.acceleration_mps2 == pytest.approx(clean.acceleration_mps2, rel=0.1)
    for hit in hits:
        assert not motion.quiet[hit + 1 : hit + 60].any()
    assert motion.quiet.mean() > 0.98
    assert 40000 - 31111 - 60 < motion.since_impact < 40000 - 31111


def test_no_impact_is_invented(make_profile) -> None:
    """Noise and motion alone are never taken for an impact, and hardly a sample is lost."""
    for seed in range(5):
        motion = watch(make_profile).update(codes(seed=seed))
        assert motion.since_impact >= 40000
        assert motion.quiet.mean() > 0.998


def test_blocks_do_not_show(make_profile) -> None:
    """The same peaks and impacts come out in blocks as in one piece."""
    signal = codes(hits=(15000, 31111))
    whole = watch(make_profile).update(signal)
    other = watch(make_profile)
    pieces = [other.update(piece) for piece in np.split(signal, [100, 350, 9000, 25000])]
    assert max(p.acceleration_mps2 for p in pieces) == pytest.approx(whole.acceleration_mps2, rel=1e-3)
    assert pieces[-1].since_impact == whole.since_impact


def test_a_landing_too_soft_to_hear_is_marked_by_the_contact(make_profile) -> None:
    """Where the contact circuit closed, two milliseconds are marked although nothing rings."""
    landed = np.zeros(40000, bool)
    landed[25000] = True
    motion = watch(make_profile).update(codes(), landed)
    assert not motion.quiet[25000:25040].any() and motion.quiet[25045]
    assert 40000 - 25000 - 60 < motion.since_impact <= 40000 - 25000


def test_lost_samples_are_no_jump_of_the_plate(make_profile) -> None:
    """A third of a cycle missing: displacement and velocity stay what they were, where a hole would make them jump."""
    signal = codes()
    cycle = round(20000 / 25.37)
    whole = watch(make_profile)
    usual = [whole.update(piece) for piece in np.split(signal, 20)][-1]
    holed, blind = watch(make_profile), watch(make_profile)
    before, after = signal[:30000], signal[30000 + cycle // 3 :]
    for other in (holed, blind):
        other.update(before)
    bridged = holed.update(after[: 2 * cycle], lost=cycle // 3)
    jumped = blind.update(after[: 2 * cycle])
    assert bridged.displacement_m < 1.1 * usual.displacement_m < jumped.displacement_m
