"""Films that lead a tracker astray: tall blocks, rolled or moving cameras, repeated frames, and what is no drop."""

from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from analysis.drop.corrections import Corrections
from analysis.drop.film.camera_fit import CameraFit, fit_camera
from analysis.drop.film.outcome import Units, judge_camera, of_camera, refuse_other_motion
from analysis.drop.film.track import Clip, ball_of
from analysis.drop.film.tracking import track_film
from analysis.drop.outcome import Outcome
from daq.setup.errors import InputError

TRUTH = {"height_m": 0.045, "e0": 0.6, "hold_s": 0.03}


def _measured(clip: Clip, units: Units) -> Outcome:
    return of_camera([clip.name], fit_camera([clip], np.random.default_rng(1)), units, np.random.default_rng(1))


def _restitution(fit: CameraFit) -> float:
    verdict = judge_camera(fit)
    return float(verdict.candidate(verdict.best).fit.theta[0])


def _frames(path: Path) -> list[np.ndarray]:
    reader = cv2.VideoCapture(str(path))
    pictures = []
    while (got := reader.read())[0]:
        pictures.append(got[1])
    reader.release()
    return pictures


def _write(path: Path, pictures: list[np.ndarray]) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30.0, pictures[0].shape[1::-1])
    for picture in pictures:
        writer.write(picture)
    writer.release()
    return path


def test_a_block_taller_than_its_rebound(synthetic: ModuleType, tmp_path: Path) -> None:
    """The resting block does not stay behind in the background: 0.1 pixel rms, none lost, and the right restitution."""
    target, camera = tmp_path / "tall.avi", synthetic.Camera(fps=300.0, block=(60, 134))
    rows = synthetic.film(target, synthetic.Truth(**TRUTH), camera, 0.42, np.random.default_rng(3))
    tracked = track_film(target)
    off = tracked.y_px - rows[tracked.track.clock.astype(int)]
    assert len(tracked.lost) == 0 and len(off) >= 115
    assert np.sqrt((off**2).mean()) < 0.1
    track = tracked.track
    fit = fit_camera([Clip("x", track.clock, track.height, track.acceleration)], np.random.default_rng(1))
    assert _restitution(fit) == pytest.approx(0.6, abs=0.005)


def test_repeated_frames_are_left_out(plain_film: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    """Every fifth frame shown twice: noticed, said, and heights at each time are those of the film without."""
    pictures = _frames(plain_film[0])
    doubled = [p for k, p in enumerate(pictures) for p in ([p, p] if k % 5 == 4 else [p])]
    tracked = track_film(_write(tmp_path / "doubled.avi", doubled))
    assert any("left out" in words for words in tracked.remarks)
    clock = tracked.track.clock.astype(int)  # later by what was shown again while the block was held
    moving = (clock > 15) & (clock < 90)
    off = [tracked.y_px[moving] - plain_film[1][clock[moving] - late] for late in range(4)]
    assert moving.sum() > 70 and min(float(np.sqrt((one**2).mean())) for one in off) < 0.1


def test_a_camera_held_in_the_hand_is_steadied(plain_film: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    """Frames that wander by several pixels are moved back, and it is said."""
    ground = cv2.GaussianBlur(np.random.default_rng(4).normal(0.0, 120.0, (560, 240)), (0, 0), 2.0)
    scene = (150.0 + ground)[:, :, None].repeat(3, axis=2)
    shaken = []
    for k, picture in enumerate(_frames(plain_film[0])):
        scene[20:540, 40:200] = picture
        off = 3.0 * np.array([np.sin(k / 9.0), np.cos(k / 7.0) - 1.0])
        moved = cv2.warpAffine(scene, np.array([[1.0, 0.0, off[0]], [0.0, 1.0, off[1]]]), (240, 560))
        shaken.append(np.clip(moved[10:550, 10:230], 0, 255).astype(np.uint8))
    tracked = track_film(_write(tmp_path / "hand.avi", shaken))
    assert any("moved back" in words for words in tracked.remarks)
    off = tracked.y_px - plain_film[1][tracked.track.clock.astype(int)]
    assert np.std(off) < 0.5


def test_part_of_a_film(plain_film: tuple[Path, np.ndarray]) -> None:
    """--until and --region leave the rest of the film out."""
    tracked = track_film(plain_film[0], corrections=Corrections(until_s=2.5, region=(20, 0, 140, 520)))
    assert tracked.track.clock.max() <= 75
    assert tracked.composite.shape[:2] == (520, 120)


def test_a_rolled_camera_measures_along_the_fall(synthetic: ModuleType) -> None:
    """Positions seen by a camera rolled by 12 degrees give gravity as an upright one does, and it is said."""
    frames = np.arange(250.0)
    heights, _ = synthetic.path(synthetic.Truth(e0=0.6, hold_s=0.02), frames / 500.0, 2e-5)
    noise = np.random.default_rng(1).normal(0.0, 0.1, (2, 250))
    px, turn = heights / 1.5e-4, np.radians(12.0)
    track = ball_of(frames, np.sin(turn) * px + noise[0], -np.cos(turn) * px + noise[1], "x")
    result = _measured(Clip("x", track.clock, track.height, track.acceleration), Units(1 / 500, 1.5e-4, 9.80665))
    assert result.payload["g_mps2"]["value"] == pytest.approx(9.80665, rel=0.005)
    assert "leans" in track.remarks[0]


@pytest.mark.parametrize(
    "height",
    [
        lambda t: 200.0 + 100.0 * np.cos(2 * np.pi * 1.1 * t),
        lambda t: 200.0 + 100.0 * np.abs(np.cos(2 * np.pi * 0.7 * t)),
        lambda t: 3e3 * gaussian_filter1d(np.random.default_rng(2).normal(0.0, 0.3, len(t)), 6),
    ],
    ids=["a waving hand", "a reflected swing", "a hand that wanders"],
)
def test_what_is_no_fall_is_refused(height) -> None:  # type: ignore[no-untyped-def]
    """Motion that turns as a ball's does not, or gains what it lost, ends in words and not in a restitution."""
    frames = np.arange(100.0)
    values = height(frames / 30.0) + np.random.default_rng(1).normal(0.0, 0.3, 100)
    with pytest.raises(InputError):
        track = ball_of(frames, np.zeros(100), -values, "hand.avi")
        clip = Clip("hand.avi", track.clock, track.height, track.acceleration)
        refuse_other_motion(fit_camera([clip], np.random.default_rng(1)), "hand.avi")


def test_a_forgotten_frame_rate_is_noticed(synthetic: ModuleType) -> None:
    """A film of 500 frames a second that plays at 30 would show a fall of 16 m: refused, and --fps is asked for."""
    frames = np.arange(120.0)
    heights, _ = synthetic.path(synthetic.Truth(e0=0.6), frames / 500.0, 2e-5)
    track = ball_of(frames, np.zeros(120), -heights / 1.5e-4, "x")
    clip = Clip("slow.avi", track.clock, track.height, track.acceleration)
    with pytest.raises(InputError, match=r"fall of 1[0-9]\.[0-9] m.*--fps"):
        _measured(clip, Units(1 / 30, None, 9.80665, assumed_rate=True))


def test_gravity_that_is_off_is_a_contradiction(synthetic: ModuleType) -> None:
    """A scale 3 % wrong makes gravity 3 % wrong: nothing is believed or declared, and friction is given each way."""
    frames = np.arange(250.0)
    truth = synthetic.Truth(e0=0.6, friction=0.2, hold_s=0.02)
    heights, _ = synthetic.path(truth, frames / 500.0, 2e-5)
    noise = np.random.default_rng(2).normal(0.0, 0.05, 250)
    track = ball_of(frames, np.zeros(250), -heights / 1.5e-4 + noise, "x")
    clip = Clip("x", track.clock, track.height, track.acceleration)
    fit = fit_camera([clip], np.random.default_rng(1))
    right, wrong = (
        of_camera(["x"], fit, Units(1 / 500, scale_m, 9.80665), np.random.default_rng(1))
        for scale_m in (1.5e-4, 1.545e-4)
    )
    assert right.payload["chosen"] == "coulomb_friction" and right.measured
    assert wrong.payload["chosen"] == "unexplained" and not wrong.measured
    assert any("gravity comes out" in words for words in wrong.sentences)
    assert wrong.payload["friction_up_down"]["up"]["value"] > wrong.payload["friction_up_down"]["down"]["value"] + 0.03


def test_bounces_that_differ_are_not_called_constant(synthetic: ModuleType) -> None:
    """Two bounces whose restitutions are many sigma apart: unexplained, with both values said."""
    frames = np.arange(300.0)
    truth = synthetic.Truth(height_m=0.3, e0=0.7, e1_s_per_m=0.12, hold_s=0.02)
    heights, impacts = synthetic.path(truth, frames / 240.0, 2e-5)
    stop = int(240 * impacts[2]) - 2
    noise = np.random.default_rng(2).normal(0.0, 0.1, stop)
    track = ball_of(frames[:stop], np.zeros(stop), -heights[:stop] / 5e-4 + noise, "x")
    result = _measured(Clip("x", track.clock, track.height, track.acceleration), Units(1 / 240, None, 9.80665))
    assert result.payload["chosen"] == "unexplained" and not result.measured
    assert any("not constant" in words for words in result.sentences)


@pytest.mark.parametrize(
    ("power", "decay_s"), [(0.5, 1e9), (0.5, 2.0), (0.75, 1e9), (0.75, 2.0), (1.0, 1e9), (1.0, 2.0), (1.0, 1.0)]
)
def test_a_knocking_hand_is_no_drop(power: float, decay_s: float) -> None:
    """Arcs |cos|^p at even intervals, fading or not, are refused."""
    times = np.arange(0.0, 2.2, 1 / 240)
    height = 300.0 * np.exp(-times / decay_s) * np.abs(np.cos(2.4 * np.pi / 2 * times)) ** power
    height += 0.3 * np.random.default_rng(0).standard_normal(len(times))
    frames = np.arange(len(times), dtype=float)
    with pytest.raises(InputError):
        track = ball_of(frames, np.zeros(len(frames)), -height, "hand")
        fit = fit_camera([Clip("hand", track.clock, track.height, track.acceleration)], np.random.default_rng(0))
        of_camera(["hand"], fit, Units(1 / 240, None, 9.80665), np.random.default_rng(0))
