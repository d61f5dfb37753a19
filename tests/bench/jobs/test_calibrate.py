"""`bench calibrate`: what it writes is what the rig hides, and nothing else of the profile changes."""

from __future__ import annotations

import cmath
import datetime
import difflib
import json
import math
from pathlib import Path

import pytest
from typer.testing import CliRunner

from bench.cli import app
from bench.jobs.calibrate import contact, drive
from bench.jobs.run_ramp import make_backend
from bench.profiles.edit import write_into
from bench.profiles.find import load, shipped_folder
from daq.setup.errors import InputError
from daq.setup.setup import calibration_warnings
from daq.setup.values import MeasuredValue
from rig.backends.simulated import SimulatedBackend
from rig.profile import Profile
from rig.sim.scenario import Scenario

F_HZ, LAG_S, GAIN = 25.37, 8e-4, 2.2
SCENARIO = """
name = "hidden"
[effects.drive_gain]
relative = 0.1
[effects.phase_lag]
time_constant_s = 8e-4
[effects.accelerometer_gain]
relative = 0.03
[effects.accelerometer_offset]
offset_g = 0.1
[effects.contact_latency]
delay_s = 4e-4
"""
HIDDEN = {
    "drive_gain": {"relative": 0.1}, "phase_lag": {"time_constant_s": LAG_S}, "contact_latency": {"delay_s": 4e-4},
}  # fmt: skip
DAY = datetime.date(2026, 1, 2)
runner = CliRunner()


def copied(tmp_path: Path, name: str = "simulated") -> Path:
    """A shipped profile of one's own."""
    path = tmp_path / "mine.toml"
    path.write_text((shipped_folder() / f"{name}.toml").read_text(encoding="utf-8"), encoding="utf-8")
    return path


def truth(multiple: int) -> complex:
    """The response that the scenario hides, in g a volt."""
    return GAIN / (1 + 2j * math.pi * multiple * F_HZ * LAG_S)


def backend(profile: Profile, seed: int) -> SimulatedBackend:
    """The rig that hides it."""
    return SimulatedBackend(profile.sampling.rate_hz, Scenario("hidden", HIDDEN), seed)


def pulls(found: list[MeasuredValue], known: list[float]) -> list[float]:
    """Errors over uncertainties."""
    return [(one.value - value) / one.uncertainty for one, value in zip(found, known, strict=True)]


@pytest.mark.parametrize("name", ["simulated", "c2", "c3"])
def test_drive_is_the_hidden_response_at_every_tone(name: str) -> None:
    """Gain and phase of each tone over three seeds: within 3.5 uncertainties, their rms below two."""
    profile, _ = load(name)
    tones = dict.fromkeys((1, profile.forcing.ratio))
    known = [x for m in tones for x in (abs(truth(m)), math.degrees(cmath.phase(truth(m))))]
    every = [pull for seed in range(3) for pull in pulls(drive(profile, backend(profile, seed)), known)]
    assert max(map(abs, every)) < 3.5 and math.sqrt(sum(p * p for p in every) / len(every)) < 2.0


@pytest.mark.parametrize("name", ["simulated", "c2"])
def test_contact_levels_and_delay_are_the_hidden_ones(name: str) -> None:
    """Levels and delay over two seeds within three uncertainties; the delay is known to microseconds."""
    profile, _ = load(name)
    for seed in range(2):
        found = contact(profile, backend(profile, seed))
        assert max(map(abs, pulls(found, [0.0, 5.0, 4e-4]))) < 3.0
        assert found[2].uncertainty < 1e-5


def test_a_late_accelerometer_makes_no_early_contact() -> None:
    """Behind a filter impacts come late: the latency is 0 to within that, and the source says so."""
    profile, _ = load("simulated")
    rig = SimulatedBackend(
        profile.sampling.rate_hz, Scenario("slow", {"accelerometer_lag": {"time_constant_s": 2e-4}}), 1
    )
    latency = contact(profile, rig)[2]
    assert latency.value == 0.0
    assert 1e-5 < latency.uncertainty < 2e-4
    assert "us later" in latency.source


def test_only_the_measured_lines_of_a_profile_change(tmp_path: Path) -> None:
    """All three kinds by the command line: only the measured lines change, to what the rig hides."""
    path, hidden = copied(tmp_path), tmp_path / "hidden.toml"
    hidden.write_text(SCENARIO, encoding="utf-8")
    before = path.read_text(encoding="utf-8").splitlines()
    for kind in ("accelerometer", "drive", "contact"):
        out = runner.invoke(
            app, ["calibrate", kind, "--into", str(path), "--scenario", str(hidden), "--seed", "5", "--json", "-"]
        )
        assert out.exit_code == 0, out.output
        assert {"key", "value", "uncertainty", "source"} <= set(json.loads(out.stdout)["measured"][0])
    after = path.read_text(encoding="utf-8").splitlines()
    changed = [line for line in difflib.ndiff(before, after) if line[:2] in ("- ", "+ ") and line[2:].strip()]
    keys = ("sensitivity", "offset_v", "g_per_volt", "phase_deg = {", "open_v", "closed_v", "[declared.contact_")
    keys = (*keys, "delay_s")
    assert all(line[2:].startswith(keys) for line in changed)
    profile, _ = load(path)
    today = datetime.date.today()
    assert profile.channels.accelerometer.sensitivity.date == today and profile.declared["contact_latency"]
    assert profile.channels.accelerometer.sensitivity.value == pytest.approx(0.103, rel=1e-3)
    assert profile.drive.response(1) == pytest.approx(truth(1), rel=3e-3)
    assert calibration_warnings(profile, today) == []


def test_mode_link_and_line_ends_of_a_profile_stay(tmp_path: Path) -> None:
    """A profile written on Windows, readable to the group, behind a link: all of that is as before."""
    path, link = copied(tmp_path), tmp_path / "link.toml"
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    path.chmod(0o644)
    mode = path.stat().st_mode
    try:
        link.symlink_to(path)
    except OSError:  # Windows lets only some make links
        link = path
    write_into(link, [MeasuredValue("channels.accelerometer.offset_v", 1.98765432, 0.01234, "me")], DAY)
    assert path.stat().st_mode == mode
    assert link == path or link.is_symlink()
    assert b"me" in path.read_bytes()
    assert path.read_bytes().count(b"\n") == path.read_bytes().count(b"\r\n")


def test_what_cannot_be_a_profile_is_not_written(tmp_path: Path) -> None:
    """A value that the profile refuses leaves the file as it was, with no other file beside it."""
    path = copied(tmp_path)
    text = path.read_text(encoding="utf-8")
    with pytest.raises(InputError, match="sensitivity"):
        write_into(
            path, [MeasuredValue("channels.accelerometer.sensitivity", -0.1, 1e-4, "x")], datetime.date(2026, 1, 1)
        )
    assert path.read_text(encoding="utf-8") == text and [p.name for p in tmp_path.iterdir()] == ["mine.toml"]


def test_rounding_and_comments(tmp_path: Path) -> None:
    """Values are rounded by their uncertainty; a comment on the changed line stays."""
    path = copied(tmp_path)
    text = path.read_text(encoding="utf-8").replace("offset_v = {", "offset_v = 0.0 # shorted\n#{")
    path.write_text(text, encoding="utf-8")
    write_into(path, [MeasuredValue("channels.accelerometer.offset_v", 1.98765432, 0.01234, "me")], DAY)
    line = next(line for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("offset_v"))
    assert line == 'offset_v = {value = 1.9877, uncertainty = 0.012, date = 2026-01-02, source = "me"} # shorted'


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["drives", "--into", "{path}"], "wanted one of accelerometer, drive, contact"),
        (["drive", "--into", "simulated"], "make one from a shipped one"),
    ],
)
def test_a_wrong_call_is_refused(tmp_path: Path, arguments: list[str], said: str) -> None:
    """Exit 2 and what to do; no profile of the package is ever written into by its name."""
    path = copied(tmp_path)
    out = runner.invoke(app, ["calibrate", *(word.format(path=path) for word in arguments)])
    assert out.exit_code == 2 and said in out.stderr


def test_warnings_name_what_is_missing_and_what_is_old(tmp_path: Path) -> None:
    """Undated scales are never calibrated, old ones expired by the profile's own term, fresh ones are silent."""
    profile, _ = load("simulated")
    day = datetime.date(2026, 11, 20)
    assert calibration_warnings(profile, day) == []
    short = profile.model_copy(update={"calibration_days": 30})
    assert calibration_warnings(short, day + datetime.timedelta(30)) == []
    old = calibration_warnings(short, day + datetime.timedelta(31))
    assert len(old) == 3 and all("more than 30 days" in line and "bench calibrate" in line for line in old)
    assert any("channels.accelerometer.sensitivity" in line for line in calibration_warnings(load("paper")[0], day))


def test_ramp_and_close_loop_warn(tmp_path: Path) -> None:
    """Both commands say on standard error which calibration is missing, and go on."""
    path = copied(tmp_path)
    text = path.read_text(encoding="utf-8").replace(', date = 2026-11-20, source = "by construction"', "")
    text = text.replace("{ start = 0.4, stop = 2.6, steps = 23 }", "[0.5]")
    path.write_text(text, encoding="utf-8")
    out = runner.invoke(app, ["ramp", str(path), "--out", str(tmp_path / "a.h5")])
    assert out.exit_code == 0 and "never calibrated: drive.g_per_volt" in out.stderr
    again = runner.invoke(app, ["close-loop", str(tmp_path / "a.h5")])
    assert "never calibrated: channels.accelerometer.sensitivity" in again.stderr
    assert make_backend(load(path)[0]).simulated
