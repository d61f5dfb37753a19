"""The command `bench drop`: its JSON, its pictures, its errors, and the profile it writes into."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import wavfile
from typer.testing import CliRunner

from bench.cli import app
from rig.profile import load_profile

RUNNER = CliRunner()
ROOT = Path(__file__).parents[3]


def _events(folder: Path, name: str = "times.csv", ratio: float = 0.9, seed: int = 0) -> Path:
    rng = np.random.default_rng(seed)
    times = 1.0 + np.concatenate(([0.0], np.cumsum(0.4 * ratio ** np.arange(12)))) + 1e-4 * rng.standard_normal(13)
    rows = [f"{t:.6f},{d:.6f}" for t, d in zip(times, np.append(np.diff(times), 0.0), strict=True)]
    (folder / name).write_text("Event time (s),Interval (s)\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return folder / name


def _path(folder: Path) -> Path:
    """Two parabolas: a fall of 0.1 m and a bounce with restitution 0.6, at 500 frames a second, in millimetres."""
    g, e = 9.80665, 0.6
    hit = np.sqrt(0.2 / g)
    out = e * np.sqrt(0.2 * g)
    t = np.arange(0, int(500 * (hit + 2 * out / g + 2 * e * out / g))) / 500.0
    first, second = t - hit, t - hit - 2 * out / g
    y = np.where(first < 0, 0.1 - 0.5 * g * t**2, out * first - 0.5 * g * first**2)
    y = np.where(second < 0, y, e * out * second - 0.5 * g * second**2)
    y = np.maximum(y, 0.0) * 1e3 + np.random.default_rng(1).normal(0.0, 0.02, len(t))
    target = folder / "path.csv"
    lines = "".join(f"{a:.5f};{b:.4f}\n" for a, b in zip(t, y, strict=True))
    target.write_text("t (s);y (mm)\n" + lines, encoding="utf-8")
    return target


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A table of thirteen impact times, and what `bench drop --json -` writes of it."""
    file = _events(tmp_path_factory.mktemp("whole"))
    run = RUNNER.invoke(app, ["drop", str(file), "--json", "-", "--no-pictures"])
    assert run.exit_code == 0, run.output
    return file, json.loads(run.stdout)


def test_json_of_impact_times(whole: tuple[Path, dict[str, Any]]) -> None:
    """The JSON has the agreed keys, alone on standard output, and the numbers that were put in."""
    result = whole[1]
    assert {"impacts_s", "models", "chosen", "tie_set", "drop_height_m"} <= set(result)
    assert len(result["impacts_s"]) == 13
    model = result["models"][0]
    assert model["name"] == result["chosen"] == result["tie_set"][0] == "constant_restitution"
    assert model["parameters"]["e0"]["low"] < 0.9 < model["parameters"]["e0"]["high"]
    assert 0.0 < model["rms_ms"] <= 2.0 * model["held_out_rms_ms"]
    height = result["drop_height_m"]
    assert height["low"] < 9.80665 * 0.4**2 / 8 / 0.81 < height["high"]


def test_json_of_a_path_and_its_picture(tmp_path: Path) -> None:
    """A table of positions gives the same keys, gravity from its unit, and a picture in the folder asked for."""
    where = ["--json", str(tmp_path / "o.json"), "--out", str(tmp_path / "out")]
    run = RUNNER.invoke(app, ["drop", str(_path(tmp_path)), *where])
    assert run.exit_code == 0, run.output
    result = json.loads((tmp_path / "o.json").read_text(encoding="utf-8"))
    assert result["restitution"][0]["restitution"]["value"] == pytest.approx(0.6, abs=0.005)
    assert result["g_mps2"]["value"] == pytest.approx(9.80665, rel=0.01)
    assert result["impacts_s"][0] == pytest.approx(np.sqrt(0.2 / 9.80665), abs=2e-4)
    assert result["drop_height_m"]["value"] == pytest.approx(0.1, abs=0.001)
    assert (tmp_path / "out" / "path-residuals.png").stat().st_size > 10_000


def test_several_drops_are_fitted_together(tmp_path: Path) -> None:
    """Files given in one call are one fit, each with its own impacts and height check."""
    files = [str(_events(tmp_path, f"{k}.csv", seed=k)) for k in range(4)]
    run = RUNNER.invoke(app, ["drop", *files, "--drop-height", "0.242", "--json", "-", "--no-pictures"])
    result = json.loads(run.stdout)
    assert len(result["drops"]) == 4
    assert all(abs(drop["stated_height_m"]["sigmas_off"]) < 3.0 for drop in result["drops"])


def test_the_result_goes_into_a_profile_and_into_words(tmp_path: Path) -> None:
    """--into declares value, uncertainty, date and source, and the profile still loads with its comments.

    The restitution stands in a sentence with its interval; options, covariance and flights in the JSON.
    """
    profile = tmp_path / "mine.toml"
    text = (ROOT / "rig_profiles" / "simulated.toml").read_text(encoding="utf-8")
    profile.write_text(text, encoding="utf-8")
    where = ["--into", str(profile), "--json", str(tmp_path / "o.json")]
    run = RUNNER.invoke(app, ["drop", str(_events(tmp_path)), *where, "--no-pictures"])
    assert run.exit_code == 0, run.output
    assert "restitution e0 = 0.9" in run.stdout
    result = json.loads((tmp_path / "o.json").read_text(encoding="utf-8"))
    assert result["options"]["gravity_mps2"] == 9.80665
    assert len(result["drops"][0]["flights"]) == 12
    assert result["models"][0]["covariance"]["of"] == ["e0"]
    loaded, _ = load_profile(profile)
    e0 = loaded.declared["restitution"]["e0"]
    assert e0.value == pytest.approx(0.9, abs=0.01) and e0.uncertainty > 0.0 and e0.date is not None
    assert "times.csv" in e0.source
    assert profile.read_text(encoding="utf-8").startswith(text.rstrip())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere.csv"], "no such file"),
        (["{events}", "--fps", "-3"], "--fps"),
        (["{events}", "--use-height", "maybe"], "expected check or data"),
        (["{events}", "--use-height", "data"], "no height to use"),
        (["{path}", "--use-height", "data", "--drop-height", "0.1"], "measures the height itself"),
        (["{events}", "--mass", "0.01"], "give both"),
        (["{events}", "--from", "2", "--until", "1"], "nothing is left"),
        (["{path}", "--region", "1,2,3"], "LEFT,TOP,RIGHT,BOTTOM"),
        (["{events}", "--drop-height", "0.2", "--drop-height", "0.3"], "2 heights for 1 files"),
        (["{events}", "--drop-height", "nan"], "expected positive metres"),
        (["{events}", "--axis", "nan"], "--axis: expected numbers"),
        (["{events}", "--add", "inf"], "--add: expected numbers"),
        (["{events}", "--scale-uncertainty", "nan"], "expected parts of one"),
        (["{events}", "{path}"], "one kind at a time"),
        (["{path}", "--scale", "0.1"], "times gravity"),
        (["{song}"], "only WAV is read"),
        (["{empty}"], "empty"),
        (["{renamed}"], "starts with RIFF"),
        (["{phone}"], "only WAV is read"),
        (["{prose}"], "no table with numbers"),
        (["{masses}"], "no columns but the impacts'"),
        (["{still}"], "no motion"),
        (["{quiet}"], "stands out"),
    ],
)
def test_wrong_calls_are_refused(tmp_path: Path, arguments: list[str], words: str) -> None:
    """A wrong call ends with status 2 and a line that says what is wrong."""
    (tmp_path / "song.mp3").write_bytes(b"ID3" + bytes(100))
    (tmp_path / "empty.csv").write_bytes(b"")
    (tmp_path / "renamed.wav").write_text("only words\n", encoding="utf-8")
    (tmp_path / "phone.wav").write_bytes(b"\0\0\0\x20ftypM4A \0\0\0\0" + bytes(100))
    (tmp_path / "prose.xlsx").write_text("hello;world\n", encoding="utf-8")
    (tmp_path / "masses.csv").write_text("name,mass\na,1\nb,5\nc,2\nd,4\n", encoding="utf-8")
    (tmp_path / "still.csv").write_text(
        "t (s),y (m)\n" + "".join(f"{k / 100},0.5\n" for k in range(50)), encoding="utf-8"
    )
    noise = np.random.default_rng(1).normal(0.0, 300.0, 88200).astype(np.int16)
    wavfile.write(tmp_path / "quiet.wav", 44100, noise)
    names = {
        **{file.stem: file for file in tmp_path.iterdir()},
        "events": _events(tmp_path),
        "path": _path(tmp_path),
        "song": tmp_path / "song.mp3",
        "empty": tmp_path / "empty.csv",
    }
    run = RUNNER.invoke(app, ["drop", *(a.format(**names) for a in arguments), "--no-pictures"])
    assert run.exit_code == 2
    assert words in run.stderr


def test_the_same_recording_twice_is_refused(tmp_path: Path) -> None:
    """One drop given twice, under one name or as a copy, would count twice."""
    first = _events(tmp_path)
    copy = tmp_path / "copy.csv"
    copy.write_bytes(first.read_bytes())
    for other in (first, copy):
        run = RUNNER.invoke(app, ["drop", str(first), str(other), "--no-pictures"])
        assert run.exit_code == 2 and "counts twice" in run.stderr


def test_corrections_by_hand(whole: tuple[Path, dict[str, Any]]) -> None:
    """--from, --until and --ignore leave events out, and the JSON keeps them."""
    file, all_of_it = whole
    last, third = all_of_it["impacts_s"][-1], all_of_it["impacts_s"][2]
    part = ["--from", "1.1", "--until", str(last - 0.01), "--ignore", str(third)]
    result = json.loads(RUNNER.invoke(app, ["drop", str(file), "--no-pictures", "--json", "-", *part]).stdout)
    assert len(result["impacts_s"]) == len(all_of_it["impacts_s"]) - 3
    assert third not in result["impacts_s"] and min(result["impacts_s"]) > 1.1
    assert result["options"]["corrections"][0]["ignore_s"] == [third]


def test_a_stated_height_that_contradicts_is_said(tmp_path: Path) -> None:
    """A height taken as data that the impacts contradict, in a way friction cannot explain, is not believed."""
    where = ["--drop-height", "0.12", "--height-uncertainty", "0.002", "--use-height", "data"]
    run = RUNNER.invoke(app, ["drop", str(_events(tmp_path)), *where, "--no-pictures", "--json", "-"])
    result = json.loads(run.stdout)
    assert result["chosen"] == "unexplained"
    assert any("stated height" in reason for reason in result["unexplained_because"])


def test_a_drag_that_no_such_ball_has_is_not_believed(tmp_path: Path) -> None:
    """Bounces that call for ten times the drag of the ball's mass and size: something else is wrong, and said."""
    flights = [0.6]
    for _ in range(16):
        flights.append(flights[-1] * 0.93 / (1.0 + 0.5 * 9.80665 * flights[-1] ** 2 / 8.0))
    times = np.concatenate(([0.0], np.cumsum(flights)))
    file = tmp_path / "drag.csv"
    file.write_text("Time (s)\n" + "".join(f"{t:.6f}\n" for t in times), encoding="utf-8")
    ball = ["--mass", "0.05", "--diameter", "0.03"]
    run = RUNNER.invoke(app, ["drop", str(file), *ball, "--no-pictures", "--json", "-"])
    result = json.loads(run.stdout)
    assert result["chosen"] != "quadratic_drag"


def _profile(tmp_path: Path, more: str = "") -> Path:
    profile = tmp_path / "mine.toml"
    text = (ROOT / "rig_profiles" / "simulated.toml").read_text(encoding="utf-8")
    profile.write_text(text + more, encoding="utf-8")
    return profile


def test_a_stale_friction_is_asked_about(tmp_path: Path) -> None:
    """A declared friction beside a restitution measured without it: nothing is written unless said which."""
    profile = _profile(tmp_path, "\n[declared.coulomb_friction]\nmu_up = 0.1\nmu_down = 0.1\n")
    before = profile.read_text(encoding="utf-8")
    arguments = ["drop", str(_events(tmp_path)), "--into", str(profile), "--no-pictures"]
    run = RUNNER.invoke(app, arguments)
    assert run.exit_code == 2 and "--stale" in run.stderr
    assert profile.read_text(encoding="utf-8") == before
    assert RUNNER.invoke(app, [*arguments, "--stale", "remove"]).exit_code == 0
    assert set(load_profile(profile)[0].declared) == {"restitution"}


def test_what_is_unexplained_goes_into_no_profile(tmp_path: Path) -> None:
    """Bounces that scatter by a tenth end unexplained, and the profile stays as it was."""
    rng = np.random.default_rng(2)
    flights = 0.6 * np.cumprod(0.8 * (1.0 + 0.08 * rng.standard_normal(9)))
    file = tmp_path / "wild.csv"
    times = np.concatenate(([0.0], np.cumsum(flights)))
    file.write_text("Time (s)\n" + "".join(f"{t:.6f}\n" for t in times), encoding="utf-8")
    profile = _profile(tmp_path)
    before = profile.read_text(encoding="utf-8")
    run = RUNNER.invoke(app, ["drop", str(file), "--into", str(profile), "--no-pictures"])
    assert run.exit_code == 2 and "Unexplained" in run.stdout
    assert profile.read_text(encoding="utf-8") == before


def test_a_drop_that_is_no_fall_is_left_out_of_a_table_of_falls(tmp_path: Path) -> None:
    """Of three drops in one table the one that bounces is named and left out, and the falls are measured."""
    rng, t = np.random.default_rng(458), np.arange(0.0, 1.4, 1.0 / 30.0)
    fall = 10.0 - 0.5 * 9.80665 * t**2
    bounce = np.where(fall > 4.0, fall, 4.0 + np.abs(np.sin(6.0 * t)))
    rows = [f"{n},{a:.5f},{b:.4f}" for n, y in ((1, fall), (2, fall), (3, bounce))
            for a, b in zip(t, y + 0.01 * rng.standard_normal(len(t)), strict=True)]  # fmt: skip
    table = tmp_path / "ball.csv"
    table.write_text("drop,time (s),height (m)\n" + "\n".join(rows) + "\n", encoding="utf-8")
    result = RUNNER.invoke(app, ["drop", str(table), "--no-pictures", "--json", "-"])
    assert result.exit_code == 0, result.output
    payload = json.loads(result.output)
    assert payload["kind"] == "falls" and len(payload["files"]) == 2
    assert any("drop 3" in words for words in payload["not_read"])
