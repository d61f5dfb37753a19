"""Falls without a bounce: read, fitted, and judged by the other drop of each ball."""

from pathlib import Path

import numpy as np
import pytest

from analysis.drop.falls.fit import Axis, Fall, Setting, fallen_m, heights_m, is_fall, with_balls
from analysis.drop.falls.outcome import judge_falls, of_falls
from analysis.drop.load import load_all
from analysis.drop.read.balls import read_balls

G = 9.80665


def falls_of(
    drags: dict[str, float], bend: float, rng: np.random.Generator, tall: float = 36.0, own: float = 0.0
) -> list[Fall]:
    """Two drops a ball, 15 samples a second at uneven times, noise of 4 cm, each seen along an axis of its own."""
    axis = Axis(0.5 * tall, 0.5 * tall)
    found = []
    for ball, k in drags.items():
        for number in (1, 2):
            time = np.arange(0.0, 4.0, 1.0 / 15.0) + rng.uniform(0.0, 0.002, 60)
            height = tall - fallen_m(np.maximum(time - 0.1, 0.0), G, k, 0.0)
            height = height[height > 0.0]
            wrong = np.array([0.0, bend, 0.0]) + own * rng.standard_normal(3)
            seen = height + axis.terms_m(height) @ wrong + 0.04 * rng.standard_normal(len(height))
            found.append(Fall(f"{ball} {number}", ball, time[: len(height)], seen))
    return found


@pytest.mark.parametrize(("k", "c"), [(0.02, 0.0), (-0.01, 0.0), (0.0, 0.3)])
def test_way_down_solves_the_equation_of_motion(k: float, c: float) -> None:
    """The closed form's acceleration is gravity less the drag at its own speed."""
    t = np.linspace(0.05, 2.0, 2001)
    way = fallen_m(t, G, k, c)
    speed = np.gradient(way, t)
    acceleration = np.gradient(speed, t)
    inside = slice(5, -5)
    assert np.allclose(acceleration[inside], (G - k * speed**2 - c * speed)[inside], atol=1e-3)


def test_only_a_fall_counts_as_one() -> None:
    """A fall is recognised whichever way its heights are counted; bounces and a steady descent are none."""
    t = np.arange(20) / 15.0
    assert is_fall(t, 40.0 - 0.5 * G * t**2) == 1
    assert is_fall(t, 0.5 * G * t**2) == -1
    assert is_fall(t, 40.0 - 3.0 * t) == 0
    assert is_fall(t, np.abs(np.cos(3.0 * t))) == 0


@pytest.mark.parametrize("n", [0, 1, 5])
def test_too_few_heights_are_no_fall_and_stay_as_they_are(n: int) -> None:
    """A table of a few rows is judged without a change of its heights, and an empty one too."""
    time = np.arange(n) / 10.0
    height = 40.0 - 0.5 * G * time**2
    before = height.copy()
    assert is_fall(time, height) == 0 and np.array_equal(height, before)


def test_drops_are_grouped_by_ball() -> None:
    """Sheets with numbered drops, and numbered files, are drops of one ball; balls that have a number keep it."""
    t = np.arange(9.0)
    names = ["b.xlsx (Ball 1, drop 1)", "b.xlsx (Ball 1, drop 2)", "b.xlsx (Ball 2, drop 1)", "b.xlsx (Ball 2, drop 2)"]
    assert [f.ball for f in with_balls([Fall(n, "", t, t) for n in names])] == ["Ball 1", "Ball 1", "Ball 2", "Ball 2"]
    assert [f.ball for f in with_balls([Fall(n, "", t, t) for n in ("golf-1.csv", "golf-2.csv")])] == ["golf", "golf"]


def test_a_ball_of_unknown_size_displaces_air_by_its_drag() -> None:
    """A beach ball falls alike with its mass and size, and with the drag and the bulk that these give."""
    axis, time = Axis(18.0, 18.0), np.linspace(0.0, 3.0, 20)
    sized, bare = (Setting(axis, G, sizes) for sizes in ({"beach": (0.1, 0.35)}, {}))
    drag = 0.5 * (sized.drag_per_m("beach") or 0.0)
    values = {"k_per_m": {"beach": drag}, "bulk_m": {"beach": sized.air("beach") / drag},
              "top_m": {"one": 36.0}, "release_s": {"one": 0.0}}  # fmt: skip
    fall = Fall("one", "beach", time, time)
    known, open_ = (heights_m(values, setting, [fall], [time]) for setting in (sized, bare))
    assert np.allclose(known, open_, rtol=0.0, atol=1e-9) and known[-1] > 36.0 - fallen_m(time[-1:], 0.8 * G, drag, 0.0)


@pytest.mark.parametrize("own", [0.0, 0.03])
def test_drag_and_distortion_are_found_and_a_heavy_balls_drag_is_not(own: float) -> None:
    """Both causes are named, the drags lie in their intervals, gravity holds its truth, a heavy ball's drag is open."""
    drags = {"light": 0.05, "middle": 0.02, "heavy": 0.001}
    judged = judge_falls(falls_of(drags, -0.08, np.random.default_rng(345), own=own), G, {"light": (0.028, 0.0726)})
    assert judged.verdict.best == "quadratic_drag+axis_distortion"
    payload = of_falls(judged).payload
    for one in payload["balls"]:
        k = one["k_per_m"]
        assert k["low"] <= drags[one["ball"]] <= k["high"]
        assert one["held_out_rms_m"]["after"] < 0.06
    assert payload["balls"][2]["drag"] == "cannot be told"
    assert payload["balls"][0]["drag"] == "measured"
    assert payload["g_mps2"]["low"] < G < payload["g_mps2"]["high"]
    assert payload["balls"][0]["drag_coefficient"]["low"] > (0.2 if own else 0.3)


def test_axes_of_drops_are_found_and_the_error_without_them_is_said() -> None:
    """Drops seen along axes that differ by 5 %: the error where only the release is fitted is larger, and said."""
    drags = {"light": 0.045, "middle": 0.015, "heavy": 0.005}
    result = of_falls(judge_falls(falls_of(drags, 0.0, np.random.default_rng(390), own=0.05), G, {}))
    assert result.payload["axis"]["own"] >= 0.02
    for one in result.payload["balls"]:
        errors = one["held_out_rms_m"]
        assert errors["after"] < errors["after_between"] < 0.08 < errors["after_uncalibrated"]
    assert any("only the release is fitted" in words for words in result.sentences)


def test_what_is_known_of_spheres_is_no_measurement() -> None:
    """Of a bowling ball, whose fall drag hardly changes, mass and size give a drag with its interval: not measured."""
    falls = falls_of({"bowling": 0.0016, "light": 0.05}, -0.05, np.random.default_rng(455), own=0.03)
    ball = of_falls(judge_falls(falls, G, {"bowling": (6.0, 0.217)})).payload["balls"][0]
    assert ball["drag"] == "cannot be told"
    assert ball["k_per_m"]["low"] <= 0.0016 <= ball["k_per_m"]["high"] < 0.005


def test_a_throw_is_distinguished_from_a_release_at_rest() -> None:
    """A release with 2 m/s downward is named, one from rest is not."""
    for speed_s in (0.2, 0.0):
        falls = falls_of({"a": 0.02, "b": 0.01}, 0.0, np.random.default_rng(456))
        thrown = []
        for fall in falls:
            late = fall.time_s > 0.1 + speed_s
            held = np.arange(-4, 0) / 15.0 + fall.time_s[late][0]
            start = fall.height_m[late][0]
            heights = np.concatenate([np.full(4, start), fall.height_m[late]])
            thrown.append(Fall(fall.name, fall.ball, np.concatenate([held, fall.time_s[late]]), heights))
        named = judge_falls(thrown, G, {}).verdict.best
        assert ("release_speed" in named) == bool(speed_s)


def test_free_fall_is_enough_for_a_heavy_ball_on_a_true_axis() -> None:
    """Nothing is named where nothing is left."""
    judged = judge_falls(falls_of({"heavy": 0.0}, 0.0, np.random.default_rng(2), tall=10.0), G, {})
    assert judged.verdict.best == "free_fall"


def test_a_ball_dropped_once_names_no_cause() -> None:
    """Without another drop of the same ball nothing can be borne out."""
    judged = judge_falls(falls_of({"light": 0.05}, 0.0, np.random.default_rng(3))[:1], G, {})
    assert judged.verdict.best == "free_fall"
    assert any("dropped twice" in words for words in of_falls(judged).sentences)


def test_a_ball_far_beyond_the_others_is_fitted() -> None:
    """A ball that falls at 5 m/s, of unknown size, next to two heavier ones: its drag is found, not a bent axis."""
    falls = falls_of({"beach": 0.35, "tennis": 0.02, "hockey": 0.008}, 0.0, np.random.default_rng(459))
    judged = judge_falls(falls, G, {})
    assert judged.verdict.best.startswith("quadratic_drag")
    k = next(one for one in of_falls(judged).payload["balls"] if one["ball"] == "beach")["k_per_m"]
    assert k["low"] <= 0.35 <= k["high"]


def test_single_wrong_heights_are_left_out() -> None:
    """Of a drop with one height 5 m off and another 2 m off it is still a fall; both are left out, and it is said."""
    falls = falls_of({"light": 0.05, "heavy": 0.005}, 0.0, np.random.default_rng(458))
    falls[0].height_m[20] += 5.0
    falls[2].height_m[30] -= 2.0
    assert all(is_fall(fall.time_s, fall.height_m) == 1 for fall in falls)
    result = of_falls(judge_falls(falls, G, {}))
    assert any(words.startswith("2 height(s)") for words in result.sentences)
    assert all(one["rms_m"]["after"] < 0.06 for one in result.payload["balls"])


def test_balls_of_another_number_are_another_ball(tmp_path: Path) -> None:
    """The second whiffle ball has no mass where the table names the first only."""
    table = tmp_path / "balls.csv"
    table.write_text("ball,mass (g),diameter (mm)\nwiffleball1,28,73\n")
    assert read_balls(table, ["Whiffle Ball 2"]) == {}


def test_masses_and_sizes_are_found_by_name(tmp_path: Path) -> None:
    """Ounces and circumferences are converted, and a name spelt slightly otherwise is found."""
    table = tmp_path / "balls.csv"
    table.write_text("ball,weight (oz),circumference (cm)\nwiffleball1,1,22.8\ngolfball,1.62,13.4\n")
    found = read_balls(table, ["Whiffle Ball 1", "Bowling Ball"])
    assert found == {"Whiffle Ball 1": pytest.approx((0.02835, 0.22 * 22.8 / 22.0 / np.pi), rel=1e-3)}
    assert Setting(Axis(0.0, 1.0), G, found).air("Whiffle Ball 1") == pytest.approx(0.0087, abs=0.001)


def test_measured_falls_are_read_with_their_own_times(data: Path) -> None:
    """Ten drops of five balls made by others, with time stamps that jitter."""
    book = data / "tracked" / "falls" / "five_balls.xlsx"
    if not book.exists():
        pytest.skip(f"other people's measurements are not at {book}")
    read = load_all(book)
    assert len(read) == 10
    assert all(item.fall is not None and len(item.fall[0]) > 40 for item in read)
    assert read[0].fall[0][-1] == pytest.approx(2.83666666666)
