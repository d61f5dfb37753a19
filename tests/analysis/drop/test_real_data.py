"""Measurements made by others: what must come out of them, with intervals."""

from pathlib import Path

import numpy as np
import pytest

from analysis.drop.film.camera_fit import fit_camera
from analysis.drop.laws import Verdict
from analysis.drop.load import Path2D, load_all
from analysis.drop.times.model_fit import Drop
from analysis.drop.times.outcome import Judged, judge, of_times

G = 9.80665
pytestmark = pytest.mark.data


def _judged(files: list[Path]) -> tuple[list[Drop], Verdict[Judged]]:
    drops = [load_all(file)[0] for file in files]
    assert all(isinstance(drop, Drop) for drop in drops)
    return drops, judge(drops, G, np.random.default_rng(1))


def test_the_table_tennis_ball_meets_the_air(data: Path) -> None:
    """All thirty drops together need drag, of a coefficient near 0.5, and it halves the held-out error at least."""
    drops, verdict = _judged(sorted((data / "phyphox" / "pingpong_ball").iterdir()))
    drag, constant = verdict.candidate("quadratic_drag"), verdict.candidate("constant_restitution")
    assert len(drops) == 30 and verdict.chosen == "quadratic_drag"
    coefficient = drag.fit.theta[1] * 2 * 2.7e-3 / (1.2 * np.pi * 0.02**2)  # 2.7 g, 40 mm, air at 20 degrees
    assert 0.4 < coefficient < 0.6
    assert drag.held_out_rms < 0.5 * constant.held_out_rms


@pytest.mark.parametrize("height_cm", [8, 10, 15, 18, 30])
def test_table_tennis_heights_come_back(data: Path, height_cm: int) -> None:
    """The height stated in the file's name comes back from the impact times to 1.5 cm (it says not of which point)."""
    drops, verdict = _judged(sorted((data / "phyphox" / "pingpong_ball").glob(f"*,{height_cm}cm.xlsx")))
    height = of_times(drops, verdict, G, [None] * 6, np.random.default_rng(1)).payload["drop_height_m"]
    assert height["value"] == pytest.approx(height_cm / 100, abs=0.015)


def test_the_blue_ball_needs_no_air(data: Path) -> None:
    """Thirty drops of a heavier ball: restitution 0.88, no added effect beyond doubt."""
    drops, verdict = _judged(sorted((data / "phyphox" / "blue_ball").iterdir()))
    assert len(drops) == 30 and verdict.chosen == "constant_restitution"
    assert verdict.candidate("constant_restitution").fit.theta[0] == pytest.approx(0.88, abs=0.01)


def test_the_sound_holds_at_least_sixteen_impacts(data: Path) -> None:
    """The recording's impacts shrink steadily, and a constant restitution is not enough."""
    drops, verdict = _judged([data / "audio" / "alessia_rimbalzi.wav"])
    assert len(drops[0].bounces.impacts_s) >= 16
    assert drops[0].bounces.impacts_s[:4] == pytest.approx([0.5884, 1.5551, 2.4068, 3.1715], abs=2e-3)
    assert verdict.chosen != "constant_restitution" and len(verdict.tie_set) > 1


def test_every_tracked_table_gives_a_restitution(data: Path) -> None:
    """All 94 tables, in every dialect: one acceleration per set-up, and a first restitution below 1."""
    accelerations: dict[str, list[float]] = {}
    for file in sorted((data / "tracked").rglob("*.csv")):
        path = load_all(file)[0]
        assert isinstance(path, Path2D), file
        accelerations.setdefault(file.parent.name, []).append(path.clip.acceleration)
    assert {name: len(found) for name, found in accelerations.items()} == {"A4": 68, "HT": 8, "vacuum": 18}
    assert np.array(accelerations["A4"]) == pytest.approx(0.305, rel=0.06)
    assert np.array(accelerations["HT"]) == pytest.approx(0.300, rel=0.06)


@pytest.mark.parametrize(
    ("name", "e"),
    [
        ("A4/1-55-M.csv", 0.558),
        ("A4/2-14-M.csv", 0.388),
        ("HT/HT-3-K.csv", 0.439),
        ("vacuum/22-7_Results_5_30mbar.csv", 0.427),
    ],
)
def test_restitution_of_the_first_bounce(data: Path, name: str, e: float) -> None:
    """The first bounce's restitution, from the speeds on both sides, is that of the square root of the heights."""
    path = load_all(data / "tracked" / name)[0]
    fit = fit_camera([path.clip], np.random.default_rng(1))
    seen = fit.impacts["parabola"]
    assert seen.speed_out[0] / seen.speed_in[0] == pytest.approx(e, abs=0.012)


def test_the_green_ball_is_followed(data: Path) -> None:
    """The film: one ball among hands, shadows and a person walking in; three bounces near restitution 0.7."""
    path = load_all(data / "video" / "arza_bounceAmeen.avi")[0]
    assert 65 <= path.clip.frame[0] <= 70 and len(path.clip.frame) > 40
    fit = fit_camera([path.clip], np.random.default_rng(1))
    seen = fit.impacts["drag"]
    ratios = (seen.speed_out / seen.speed_in)[seen.bounced]
    assert ratios[:3] == pytest.approx([0.73, 0.74, 0.73], abs=0.05)
