"""Doubts: what contradicts the profile is found at the import, and nothing is in a sound recording."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis.flights.scan import plate_of
from benchmarks.plants import other_plant
from benchmarks.plants.instrument import Instrument as Chain
from daq.importers.formats.open import open_source
from daq.importers.import_recording import ImportOptions, ImportSummary, import_recording
from daq.instrument.instrument import Instrument, instrument_of, refuse_doubtful
from daq.recording import open_recording
from daq.setup.errors import InputError
from kernels.arrays import Floats
from rig.profile import parse_profile

Volts = dict[str, Floats]
Spoil = Callable[[Volts], None]
GAMMAS = {1: (0.6, 2.4), 2: (0.3, 1.4), 3: (0.15, 0.75)}
STRONG = (
    "coulomb_friction", "restitution", "accelerometer_lag", "contact_latency", "adhesion", "harmonic_distortion",
    "table_resonance", "accelerometer_offset", "accelerometer_high_pass", "drive_gain", "upper_stop", "mains_hum",
)  # fmt: skip


def run_of(c: int, *effects: str, rate_hz: float = 20000.0, reads_gravity: bool = False) -> other_plant.Run:
    """Ten steps of fourteen cycles."""
    hidden = {k: v for effect in effects for k, v in other_plant.hidden_by(effect, "strong").items()}
    gammas = np.random.default_rng(c).permutation(np.round(np.linspace(*GAMMAS[c], 10), 4))
    return other_plant.Run(
        c=c, gammas=tuple(gammas.tolist()), cycles=14, rate_hz=rate_hz, reads_gravity=reads_gravity, spikes=True,
        hidden=hidden, seed=c,
    )  # fmt: skip


def handed_over(run: other_plant.Run) -> Volts:
    """Times and volts of a run, and nothing of its truth."""
    return {k: v for k, v in other_plant.simulate(run).items() if k == "time_s" or k.endswith("_v")}


@functools.cache
def _simulated(c: int, effects: tuple[str, ...], reads_gravity: bool) -> Volts:
    return handed_over(run_of(c, *effects, reads_gravity=reads_gravity))


def bring_in(volts: Volts, profile: str, folder: Path, rate_hz: float | None = None) -> ImportSummary:
    """Volts and a profile as somebody hands them over."""
    np.savez(folder / "raw.npz", allow_pickle=False, **volts)
    setup = parse_profile(profile, "p.toml").setup()
    source, out = open_source(folder / "raw.npz"), folder / "r.h5"
    return import_recording(source, out, setup, profile, ImportOptions(rate_hz=rate_hz))


def inverted(v: Volts) -> None:
    """The accelerometer upside down."""
    v["accelerometer_v"] = -v["accelerometer_v"]


def biased(v: Volts) -> None:
    """An IEPE supply's bias."""
    v["accelerometer_v"] = v["accelerometer_v"] + 2.5


def contact_inverted(v: Volts) -> None:
    """High in contact, low in flight."""
    v["continuity_v"] = 5.0 - v["continuity_v"]


def both_inverted(v: Volts) -> None:
    """Accelerometer and contact."""
    inverted(v)
    contact_inverted(v)


def drive_inverted(v: Volts) -> None:
    """Reversed leads."""
    v["drive_v"] = -v["drive_v"]


def in_millivolts(v: Volts) -> None:
    """A unit that nobody stated."""
    v["accelerometer_v"] = 1e-3 * v["accelerometer_v"]


def resampled(v: Volts) -> None:
    """Brought to 44.1 kHz by straight lines."""
    t = v["time_s"]
    new = np.arange(0.0, t[-1], 1.0 / 44100.0)
    v.update({name: np.interp(new, t, v[name]) for name in ("continuity_v", "accelerometer_v", "drive_v")}, time_s=new)


def cut_off(v: Volts) -> None:
    """A sensor of 0.1 V/g that ends at 4 g, with noise behind it."""
    noise = 3e-4 * np.random.default_rng(8).standard_normal(v["accelerometer_v"].size)
    v["accelerometer_v"] = np.clip(v["accelerometer_v"], -0.4, 0.4) + noise


def drive_cut_off(v: Volts) -> None:
    """A converter whose range ends below the drive's largest volts."""
    end = 0.85 * np.abs(v["drive_v"]).max()
    v["drive_v"] = np.clip(v["drive_v"], -end, end)


def interrupted(v: Volts) -> None:
    """A plug of the accelerometer that was loose for a quarter of the run."""
    n = v["accelerometer_v"].size
    v["accelerometer_v"] = np.where(np.abs(np.arange(n) - n // 2) < n // 8, 0.0, v["accelerometer_v"])


def without_drive(spoil: Spoil) -> Spoil:
    """The same where no drive was recorded."""

    def spoilt(v: Volts) -> None:
        spoil(v)
        del v["drive_v"]

    return spoilt


def exchanged(a: str, b: str) -> Spoil:
    """Two columns the wrong way round."""

    def spoilt(v: Volts) -> None:
        v[f"{a}_v"], v[f"{b}_v"] = v[f"{b}_v"], v[f"{a}_v"]

    return spoilt


@pytest.mark.parametrize("c", [1, 2])
@pytest.mark.parametrize(
    ("spoil", "kinds", "cure"),
    [
        (inverted, {"accelerometer_sense"}, "write sign = -1"),
        (without_drive(inverted), {"accelerometer_sense"}, "write sign = -1"),
        (biased, {"bias"}, "write offset_v = 2.5"),
        (contact_inverted, {"contact_sense"}, "write open_v = 0, closed_v = 5"),
        (both_inverted, {"contact_sense", "accelerometer_sense"}, "write sign = -1"),
        (in_millivolts, {"scale"}, "its sensitivity is wrong by far"),
        (without_drive(in_millivolts), {"scale"}, "correct sensitivity or unit"),
        (exchanged("drive", "accelerometer"), {"exchanged"}, "exchange the columns of accelerometer and drive"),
        (exchanged("continuity", "accelerometer"), {"exchanged"}, "columns of continuity and accelerometer"),
        (exchanged("continuity", "drive"), {"exchanged"}, "columns of continuity and drive"),
    ],
)
def test_what_contradicts_the_profile_is_a_doubt_with_its_cure(
    tmp_path: Path, c: int, spoil: Spoil, kinds: set[str], cure: str
) -> None:
    """Each fault of the wiring is named with what to write, and a verdict is refused by a sentence with the file."""
    volts = dict(_simulated(c, (), False))
    spoil(volts)
    summary = bring_in(volts, other_plant.profile_of(run_of(c)), tmp_path)
    doubts = summary.instrument.doubts
    assert {doubt.kind for doubt in doubts} == kinds
    assert all(doubt.makes_meaningless for doubt in doubts) and cure in doubts[-1].cure
    with pytest.raises(InputError, match=r"r\.h5: .*; --anyway"):
        refuse_doubtful([summary.path])


@pytest.mark.parametrize(
    ("level_v", "gammas", "refused"), [(5.0, (1.8, 2.2), False), (5.0, (0.4, 2.2), True), (0.0, (1.8, 2.2), True)]
)
def test_a_contact_that_never_closes_may_be_a_ball_that_is_launched_where_it_lands(
    tmp_path: Path, level_v: float, gammas: tuple[float, ...], refused: bool
) -> None:
    """An open circuit is refused where some step lets the ball rest, a closed one everywhere."""
    run = replace(run_of(1), gammas=gammas)
    volts = handed_over(run)
    volts["continuity_v"] = np.full_like(volts["continuity_v"], level_v)
    doubts = bring_in(volts, other_plant.profile_of(run), tmp_path).instrument.doubts
    assert [(doubt.kind, doubt.makes_meaningless) for doubt in doubts] == [("contact", refused)]


def test_an_amplitude_that_is_swept_is_no_ramp_of_steps(tmp_path: Path) -> None:
    """Amplitudes that grow by 1.5 % within each of the holds are refused, with what to do."""
    volts = dict(_simulated(1, (), False))
    steps = bring_in(dict(volts), other_plant.profile_of(run_of(1)), tmp_path).steps
    for a, n in zip(steps["first_sample"], steps["n_samples"], strict=True):
        for name in ("drive_v", "accelerometer_v"):
            volts[name] = volts[name].copy()
            volts[name][a : a + n] *= np.linspace(0.99, 1.01, n)
    (tmp_path / "swept").mkdir()
    (doubt,) = bring_in(volts, other_plant.profile_of(run_of(1)), tmp_path / "swept").instrument.doubts
    assert doubt.kind == "sweep" and doubt.makes_meaningless and "drive in steps" in doubt.cure


def test_a_drive_whose_phase_is_wrong_by_far_is_refused_with_the_phase_to_write(tmp_path: Path) -> None:
    """A quarter of a turn in [drive] that the plate does not have."""
    stated = other_plant.profile_of(run_of(1)).replace("phase_deg = { value = 0.0,", "phase_deg = { value = 90.0,")
    (doubt,) = bring_in(dict(_simulated(1, (), False)), stated, tmp_path).instrument.doubts
    assert doubt.kind == "drive_phase" and doubt.makes_meaningless and "write phase_deg = 0 " in doubt.cure


@pytest.mark.parametrize(("first", "second", "found"), [(100.0, 0.0, []), (0.0, 100.0, ["drive_phase"])])
def test_the_phase_of_the_strongest_tone_is_compared_with_its_own_scale(
    tmp_path: Path, first: float, second: float, found: list[str]
) -> None:
    """At c = 2 the second tone is the strongest: what [drive.second] says of it counts, and nothing of the first."""
    stated = other_plant.profile_of(run_of(2)).replace("phase_deg = { value = 0.0,", f"phase_deg = {{ value = {first},")
    own = f"[drive.second]\ng_per_volt = {{ value = {run_of(2).g_per_volt}, uncertainty = 0.008 }}\n"
    own += f"phase_deg = {{ value = {second}, uncertainty = 0.5 }}\n\n[channels.continuity]"
    stated = stated.replace("[channels.continuity]", own)
    doubts = bring_in(dict(_simulated(2, (), False)), stated, tmp_path).instrument.doubts
    assert [doubt.kind for doubt in doubts] == found and all("[drive.second]" in doubt.finding for doubt in doubts)


def test_a_slow_rig_sampled_slowly_is_brought_in(tmp_path: Path) -> None:
    """Twenty-five samples in each cycle of 2 Hz are few in a second, and no reason for an error."""
    time_s = np.arange(2000) / 50.0
    volts = (1.0 + np.floor(time_s / 8.0)) * np.sin(2.0 * np.pi * 2.0 * time_s)
    noise = 1e-3 * np.random.default_rng(3).standard_normal(len(time_s))
    stated = other_plant.profile_of(replace(run_of(1), rate_hz=50.0, frequency_hz=2.0, gammas=(0.1, 0.2)))
    given = {"time_s": time_s, "continuity_v": 0.0 * volts, "accelerometer_v": 0.01 * volts + noise, "drive_v": volts}
    summary = bring_in(given, stated, tmp_path)
    assert len(summary.steps) == 5 and (summary.instrument.noise_mps2_rthz or 0.0) > 0.0


@pytest.mark.parametrize(
    ("spoil", "kind"),
    [
        (drive_inverted, "drive_sense"),
        (resampled, "resampled"),
        (cut_off, "cut_off"),
        (drive_cut_off, "cut_off"),
        (interrupted, "dead"),
    ],
)
def test_what_a_verdict_survives_is_said_and_not_refused(tmp_path: Path, spoil: Spoil, kind: str) -> None:
    """Reversed leads, linear interpolation, an end of sensor or drive, a sensor dead for a while stop nothing."""
    volts = dict(_simulated(2, (), False))
    spoil(volts)
    summary = bring_in(volts, other_plant.profile_of(run_of(2)), tmp_path)
    assert [(doubt.kind, doubt.makes_meaningless) for doubt in summary.instrument.doubts] == [(kind, False)]
    refuse_doubtful([summary.path])


def test_a_drive_that_is_cut_off_says_nothing_of_its_steps(tmp_path: Path) -> None:
    """Steps whose drive's reading is at its end have no drive, the others the one that was recorded."""
    volts = dict(_simulated(1, (), False))
    drive_cut_off(volts)
    summary = bring_in(volts, other_plant.profile_of(run_of(1)), tmp_path)
    with open_recording(summary.path) as recording:
        known = [s is not None and s.drive is not None for s in plate_of(recording).steps]
    assert known == [gamma < 0.85 * max(run_of(1).gammas) for gamma in run_of(1).gammas]


def test_the_accelerometers_end_is_said_where_it_comes_to_it(tmp_path: Path) -> None:
    """Impacts beyond -4 g on motion of at most 3.6 g: no doubt, but that end is stated in g; none in a sound run."""
    run = replace(run_of(1), gammas=tuple(g / 1.4 for g in run_of(1).gammas), instrument=Chain(sensor_clip_g=4.0))
    found = bring_in(handed_over(run), other_plant.profile_of(run), tmp_path).instrument
    assert found.doubts == () and found.ends_g[0] == pytest.approx(-4.0, abs=0.1)
    assert any("at its end at -" in line for line in found.in_words())
    sound = tmp_path / "sound"
    sound.mkdir()
    whole = bring_in(dict(_simulated(1, (), False)), other_plant.profile_of(run_of(1)), sound).instrument
    assert whole.ends_g == (None, None)


@pytest.mark.parametrize(("c", "stated"), [(1, 2), (1, 3), (2, 1), (2, 3), (3, 1), (3, 2)])
@pytest.mark.parametrize("drive", [True, False])
def test_another_ratio_than_the_profile_s(tmp_path: Path, c: int, stated: int, drive: bool) -> None:
    """Two tones under a profile of one, one under two, and others under others are said with the ratio to write."""
    volts = dict(_simulated(c, (), False))
    if not drive:
        del volts["drive_v"]
    profile = other_plant.profile_of(run_of(c)).replace(f"ratio = {c}", f"ratio = {stated}")
    (doubt,) = bring_in(volts, profile, tmp_path).instrument.doubts
    assert doubt.kind == "tones" and doubt.makes_meaningless
    assert f"ratio = {c} in [forcing]" in doubt.cure or "correct frequency_hz and ratio" in doubt.cure


def test_an_accelerometer_that_reads_gravity_under_a_profile_that_says_no(tmp_path: Path) -> None:
    """Just 1 g of bias is named as gravity."""
    profile = other_plant.profile_of(run_of(1))
    (doubt,) = bring_in(dict(_simulated(1, (), True)), profile, tmp_path).instrument.doubts
    assert doubt.kind == "bias" and "write reads_gravity = true" in doubt.cure


def test_senses_stand_out_behind_a_late_accelerometer(tmp_path: Path) -> None:
    """Half a millisecond of delay blurs the take-offs, and senses are found all the same."""
    for spoil, kinds in ((contact_inverted, {"contact_sense"}), (inverted, {"accelerometer_sense"})):
        volts = dict(_simulated(2, ("accelerometer_lag",), False))
        spoil(volts)
        folder = tmp_path / spoil.__name__
        folder.mkdir()
        found = bring_in(volts, other_plant.profile_of(run_of(2)), folder).instrument.doubts
        assert {doubt.kind for doubt in found} == kinds


@pytest.mark.parametrize("effect", STRONG)
def test_strong_effects_are_no_doubts(tmp_path: Path, effect: str) -> None:
    """What a verdict is to find is not taken for a fault of the wiring."""
    at = STRONG.index(effect)
    run = run_of(1 + at % 3, effect, rate_hz=(20000.0, 10000.0, 48000.0)[at % 3], reads_gravity=bool(at % 2))
    found = bring_in(handed_over(run), other_plant.profile_of(run), tmp_path).instrument
    assert found.doubts == ()
    assert found.takeoff_g is not None and -2.0 < found.takeoff_g < -0.3


def test_the_instrument_stays_with_the_recording(tmp_path: Path) -> None:
    """Noise, tones, levels and doubts are stored, read without a sample, and measured anew by another profile."""
    volts, text = dict(_simulated(2, (), False)), other_plant.profile_of(run_of(2))
    inverted(volts)
    summary = bring_in(volts, text, tmp_path)
    found = summary.instrument
    assert found.noise_mps2 == pytest.approx(0.03 * 9.80665, rel=0.1) and found.bandwidth_hz is None
    assert found.tones_hz == pytest.approx((25.37, 50.74), rel=1e-5)
    assert found.tones_g == pytest.approx((1.4, 5.6), rel=0.01)
    assert found.levels_v == pytest.approx((0.03, 4.96), abs=0.03) and found.bias_v == pytest.approx(0.0, abs=1e-3)
    with open_recording(summary.path) as recording:
        recording.read_v = None  # type: ignore[assignment,method-assign]
        assert instrument_of(recording) == found
    right = parse_profile(text.replace("reads_gravity", "sign = -1\nreads_gravity"), "p.toml").setup()
    assert right.channels.accelerometer.sign == -1
    with open_recording(summary.path) as recording:
        recording.measure_with(right)
        anew = instrument_of(recording)
    assert anew is not None and anew.doubts == () and anew.takeoff_g == pytest.approx(-1.02, abs=0.05)
    refuse_doubtful([summary.path], right)
    assert any("2 tones at 25.37 Hz" in line for line in found.in_words())


def test_words_of_an_instrument_of_which_nothing_is_known() -> None:
    """A recording without motion, noise and contact has one line."""
    bare = Instrument(20000.0, 0, None, None, None, None, (), (), None, 0, None, None)
    assert bare.in_words() == ("20000 samples/s, 0 steps, no tones found",)


def test_rows_missing_without_times_are_declared_as_gaps(tmp_path: Path) -> None:
    """Rows that are missing within steps, in a file without times, are found where they are, up to whole cycles."""
    for c in (1, 2):
        volts = dict(_simulated(c, (), False))
        del volts["time_s"]
        cycle, kept = 20000.0 / 25.37, np.ones(len(volts["drive_v"]), bool)
        places = [(round(cycle * (14 * 3 + 8)), 173), (round(cycle * (14 * 7 + 9.3)), round(cycle + 60))]
        for first, count in places:
            kept[first : first + count] = False
        folder = tmp_path / str(c)
        folder.mkdir()
        cut = {name: x[kept] for name, x in volts.items()}
        summary = bring_in(cut, other_plant.profile_of(run_of(c)), folder, rate_hz=20000.0)
        found = summary.timebase.gaps
        assert found[:, 0].tolist() == pytest.approx([places[0][0], places[1][0] - 173], abs=2)
        assert found[:, 1].tolist() == pytest.approx([173, 60], abs=1)
        assert any("rows are missing where the forcing's phase jumps" in said for said in summary.remarks)
        with open_recording(summary.path) as recording:
            assert recording.gaps.tolist() == found[:, :2].tolist()


def test_no_rows_are_missing_where_a_rig_begins_each_step_anew(tmp_path: Path) -> None:
    """A forcing that does not run on from step to step tells nothing of missing rows, nor does a whole file."""
    volts, cycle = dict(_simulated(1, (), False)), 20000.0 / 25.37
    del volts["time_s"]
    whole = bring_in(volts, other_plant.profile_of(run_of(1)), tmp_path, rate_hz=20000.0)
    assert len(whole.timebase.gaps) == 0
    rng, kept = np.random.default_rng(0), np.ones(len(volts["drive_v"]), bool)
    for k in range(1, 10):
        first = round(14 * k * cycle)
        kept[first : first + rng.integers(50, 700)] = False
    whole.path.unlink()
    cut = {name: x[kept] for name, x in volts.items()}
    assert len(bring_in(cut, other_plant.profile_of(run_of(1)), tmp_path, rate_hz=20000.0).timebase.gaps) == 0


def test_steps_found_in_the_accelerometer_hold_no_fade(tmp_path: Path) -> None:
    """Without a drive no hold reaches into the fade after it, whose slow beginning drowns in the noise."""
    run = replace(run_of(1, "coulomb_friction"), fade_cycles=2, gammas=tuple(np.linspace(0.6, 1.05, 10).tolist()))
    volts = handed_over(run)
    del volts["drive_v"]
    steps = bring_in(volts, other_plant.profile_of(run), tmp_path).steps
    ends = (steps["first_sample"] + steps["n_samples"])[:-1]
    held_from = (steps["first_sample"] + steps["settle_samples"])[1:]
    fades = 20000.0 / run.frequency_hz * 14 * np.arange(1, 10)
    assert len(steps) == 10
    assert np.all(ends < fades + 40) and np.all(held_from > fades + 2 * 20000.0 / run.frequency_hz - 40)


def test_one_locked_motion_is_no_doubt(tmp_path: Path) -> None:
    """Where all steps repeat one flight, landings lie as close together as take-offs, and nothing is doubted; an
    inverted accelerometer stands out all the same."""
    run = replace(run_of(1), gammas=(0.8, 0.8, 0.8))
    volts, profile = handed_over(run), other_plant.profile_of(run)
    assert bring_in(volts, profile, tmp_path).instrument.doubts == ()
    inverted(volts)
    (tmp_path / "r.h5").unlink()
    assert [doubt.kind for doubt in bring_in(volts, profile, tmp_path).instrument.doubts] == ["accelerometer_sense"]
