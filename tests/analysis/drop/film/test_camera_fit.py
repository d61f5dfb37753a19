"""Tracked positions and films of known truth."""

from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest

from analysis.drop.film.camera_fit import CameraFit, fit_camera
from analysis.drop.film.outcome import Units, of_camera
from analysis.drop.film.track import Clip, ball_of
from analysis.drop.film.tracking import track_film
from analysis.drop.film.video import open_film
from analysis.drop.laws import choose
from daq.setup.errors import InputError

SCALE_M = 1.5e-4


def _clip(synthetic: ModuleType, truth: object, fps: float, seconds: float, seed: int) -> Clip:
    frames = np.arange(int(seconds * fps), dtype=float)
    heights, _ = synthetic.path(truth, frames / fps, 2e-5)
    rng = np.random.default_rng(seed)
    track = ball_of(frames, np.zeros(len(frames)), -heights / SCALE_M + rng.normal(0.0, 0.1, len(frames)), "x")
    return Clip("x", track.clock, track.height, track.acceleration)


@pytest.fixture(scope="module")
def rubbed(synthetic: ModuleType) -> CameraFit:
    """A drop with friction at the paper's conditions, 1000 frames a second."""
    truth = synthetic.Truth(e0=0.514, friction=0.3)
    return fit_camera([_clip(synthetic, truth, 1000.0, 0.4, 1)], np.random.default_rng(0))


@pytest.fixture(scope="module")
def free(synthetic: ModuleType) -> CameraFit:
    """A drop without friction, 500 frames a second."""
    truth = synthetic.Truth(e0=0.6, hold_s=0.02)
    return fit_camera([_clip(synthetic, truth, 500.0, 0.45, 2)], np.random.default_rng(0))


def test_friction_and_restitution_at_the_papers_conditions(rubbed: CameraFit) -> None:
    """At 1000 frames a second friction comes back to 0.01 g and restitution to 0.005, and friction is named."""
    ties = choose(rubbed.candidates)
    candidate = next(r for r in rubbed.candidates if r.model.name == ties[0])
    assert ties == ("coulomb_friction",)
    assert rubbed.shapes["friction"].values[1] == pytest.approx(0.3, abs=0.01)
    assert candidate.fit.theta[0] == pytest.approx(0.514, abs=0.005)


def test_a_strong_drag_makes_no_gravity_larger(rubbed: CameraFit) -> None:
    """Flights of a few frames are straight lines under any gravity with drag enough; no shape is fitted so."""
    true = rubbed.shapes["friction"].law.g_mps2
    assert all(0.5 * true < shape.law.g_mps2 < 1.5 * true for shape in rubbed.shapes.values())


def test_no_friction_is_not_made_up(synthetic: ModuleType, free: CameraFit) -> None:
    """Free fall with a constant restitution stays at the lowest candidate, with gravity measured and impacts timed."""
    result = of_camera(["x"], free, Units(1 / 500.0, SCALE_M, 9.80665), np.random.default_rng(0)).payload
    _, impacts = synthetic.path(synthetic.Truth(e0=0.6, hold_s=0.02), np.array([0.45]), 2e-5)
    assert result["chosen"] == "constant_restitution"
    assert result["impacts_s"] == pytest.approx(impacts[: len(result["impacts_s"])], abs=3e-4)
    assert result["g_mps2"]["low"] < 9.80665 < result["g_mps2"]["high"]
    assert result["drop_height_m"]["value"] == pytest.approx(0.06, rel=0.01)


def test_a_wrong_frame_rate_is_refused(free: CameraFit) -> None:
    """With a scale, a frame rate off by two makes gravity four times wrong, and the error proposes the right one."""
    with pytest.raises(InputError, match=r"the frame rate 1000 or the scale .* is wrong; (499|50[0-9])"):
        of_camera(["x"], free, Units(1 / 1000.0, SCALE_M, 9.80665), np.random.default_rng(0))


def test_without_a_frame_rate_only_ratios_are_given(free: CameraFit) -> None:
    """Frames alone give restitution and friction; times, speeds and heights are withheld, in words too."""
    result = of_camera(["x"], free, Units(None, None, 9.80665), np.random.default_rng(0))
    assert result.payload["impacts_s"] == [] and result.payload["drop_height_m"]["value"] is None
    assert result.payload["restitution"][0]["restitution"]["value"] == pytest.approx(0.6, abs=0.01)
    assert any("No frame rate" in sentence for sentence in result.sentences)


def test_the_ball_is_the_track_that_falls(synthetic: ModuleType) -> None:
    """A still mark, a swinging hand and a ball whose number changes: the ball is chosen and joined."""
    frames = np.arange(200.0)
    heights, _ = synthetic.path(synthetic.Truth(e0=0.6), frames / 500.0, 2e-5)
    ball = -heights / SCALE_M
    hand = -300.0 + 80.0 * np.sin(frames / 25.0)
    clock = np.concatenate([frames, frames, frames])
    x = np.concatenate([np.full(200, 50.0), np.full(200, 90.0), np.full(200, 140.0)])
    y = np.concatenate([ball, np.full(200, -10.0), hand])
    order = np.argsort(clock, kind="stable")
    track = ball_of(clock[order], x[order], y[order], "x")
    assert np.median(track.x) == 50.0
    assert len(track.clock) > 150


def test_two_movers_and_no_motion_are_refused(synthetic: ModuleType) -> None:
    """Two balls falling at once, and a ball that never moves, are errors of their own."""
    frames = np.arange(200.0)
    one, _ = synthetic.path(synthetic.Truth(e0=0.6), frames / 500.0, 2e-5)
    two, _ = synthetic.path(synthetic.Truth(e0=0.7, height_m=0.05), frames / 500.0, 2e-5)
    clock, x = np.repeat(frames, 2), np.tile([50.0, 250.0], 200)
    y = np.column_stack([-one / SCALE_M, -two / SCALE_M]).ravel()
    with pytest.raises(InputError, match="two movers"):
        ball_of(clock, x, y, "x")
    with pytest.raises(InputError, match="no motion"):
        ball_of(frames, np.zeros(200), np.full(200, 3.0), "x")


@pytest.mark.parametrize("codec", ["MJPG", "mp4v"])
def test_a_film_is_tracked_to_a_tenth_of_a_pixel(
    synthetic: ModuleType, plain_film: tuple[Path, np.ndarray], tmp_path: Path, codec: str
) -> None:
    """Through a real codec, with blur, flicker, noise, a rod and up to 20 pixels a frame: 0.1 pixel rms."""
    target, rows = plain_film
    if codec == "mp4v":
        target, truth, camera = tmp_path / "drop.mp4", synthetic.Truth(friction=0.3), synthetic.Camera(fps=300.0)
        rows = synthetic.film(target, truth, camera, 0.4, np.random.default_rng(3), codec)
    tracked = track_film(target)
    found = -tracked.track.height
    off = found - rows[tracked.track.clock.astype(int)]
    assert np.abs(np.diff(rows)).max() > 15.0
    assert len(found) >= 110 and len(tracked.lost) == 0
    assert np.sqrt((off**2).mean()) < 0.1


def test_a_block_that_lingers_is_not_taken_for_background(synthetic: ModuleType, tmp_path: Path) -> None:
    """A block near its resting place for most of the film, before a tilted camera, is followed to 0.1 pixel."""
    target = tmp_path / "drop.avi"
    truth = synthetic.Truth(height_m=0.0486, e0=0.463, friction=0.11)
    camera = synthetic.Camera(fps=280.0, exposure=0.4, noise=1.4, flicker=0.07, perspective=0.01)
    rows = synthetic.film(target, truth, camera, 0.38, np.random.default_rng(5))
    tracked = track_film(target)
    off = -tracked.track.height - rows[tracked.track.clock.astype(int)]
    assert len(tracked.track.clock) >= 100 and np.sqrt((off**2).mean()) < 0.1


def test_a_short_last_flight_does_not_call_for_drag(synthetic: ModuleType) -> None:
    """Where the film ends early in a flight, that flight hardly has an apex; it must not decide on the shape."""
    rng = np.random.default_rng(5)
    frames = np.arange(216.0)
    heights, _ = synthetic.path(synthetic.Truth(height_m=0.5, e0=0.75, hold_s=0.05), frames / 240.0, 2e-5)
    track = ball_of(frames, np.zeros(216), heights + rng.normal(0.0, 3e-4, 216), "x")
    fit = fit_camera([Clip("x", track.clock, track.height, track.acceleration)], np.random.default_rng(1))
    assert choose(fit.candidates)[0] == "constant_restitution"


def _write(target: Path, pictures: list[np.ndarray]) -> None:
    writer = cv2.VideoWriter(str(target), cv2.VideoWriter_fourcc(*"MJPG"), 30.0, pictures[0].shape[1::-1])
    for picture in pictures:
        writer.write(picture)
    writer.release()


def test_a_still_film_a_cut_film_and_a_damaged_film_are_refused(tmp_path: Path) -> None:
    """Each fault of a film has its own error."""
    rng = np.random.default_rng(1)
    scenes = [np.kron(rng.integers(0, 255, (12, 16, 3)), np.ones((10, 10, 1))).astype(np.uint8) for _ in range(2)]
    _write(tmp_path / "still.avi", [scenes[0]] * 30)
    _write(tmp_path / "cut.avi", [scenes[0]] * 15 + [scenes[1]] * 15)
    (tmp_path / "bad.avi").write_bytes((tmp_path / "cut.avi").read_bytes()[:300])
    faults = {"still": "no motion", "cut": "a cut in the film between frames 14 and 15", "bad": "cannot be read"}
    for name, words in faults.items():
        with pytest.raises(InputError, match=words):
            track_film(tmp_path / f"{name}.avi")


def test_a_folder_of_frames_is_a_film(plain_film: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    """Pictures in a folder are read in their numbers' order, not their names', and state no frame rate."""
    film = list(open_film(plain_film[0]).frames())[:14]
    for k, picture in enumerate(film):
        (tmp_path / f"frame{k}.png").write_bytes(cv2.imencode(".png", picture)[1].tobytes())
    folder = open_film(tmp_path)
    assert folder.fps is None and folder.count == 14
    assert all(np.array_equal(a, b) for a, b in zip(folder.frames(), film, strict=True))
