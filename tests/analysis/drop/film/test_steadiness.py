"""A camera that moves: followed by what stands still, or seen by the ball's own way."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from analysis.drop.film.background import stabilised
from analysis.drop.film.camera_fit import camera_moved
from analysis.drop.film.outcome import uneven_floor
from analysis.drop.film.track import Clip, Flight
from analysis.drop.film.video import open_film


def _filmed(target: Path, floor: bool, shake_px: float) -> np.ndarray:
    """A block that falls before a bare wall, with or without a floor in sight; the camera's motion down, px."""
    rng = np.random.default_rng(5)
    writer = cv2.VideoWriter(str(target), cv2.VideoWriter_fourcc(*"MJPG"), 30.0, (240, 320))
    down = shake_px * np.sin(np.arange(40) / 5.0)
    for k, off in enumerate(down):
        picture = np.full((320, 240), 150.0)
        if floor:
            picture[280:] = 100.0
        top = 30 + int(0.13 * k**2)
        picture[top : top + 40, 90:150] = 60.0
        moved = cv2.warpAffine(picture, np.array([[1.0, 0.0, 0.0], [0.0, 1.0, off]]), (240, 320), borderMode=1)
        moved = cv2.GaussianBlur(moved, (0, 0), 1.0) + rng.normal(0.0, 1.5, moved.shape)
        writer.write(cv2.cvtColor(np.clip(moved, 0, 255).astype(np.uint8), cv2.COLOR_GRAY2BGR))
    writer.release()
    return down


def test_the_edge_of_a_floor_steadies_a_bare_wall(tmp_path: Path) -> None:
    """Without texture, the floor's edge gives the camera's motion along the fall to a quarter of a pixel."""
    down = _filmed(tmp_path / "floor.avi", floor=True, shake_px=3.0)
    film = stabilised(open_film(tmp_path / "floor.avi"))
    assert film.watched and film.shifts is not None
    assert np.std(film.shifts[:, 1] - down) < 0.25


def test_a_block_alone_steadies_nothing(tmp_path: Path) -> None:
    """Where only the block has edges, its fall is not taken for a motion of the camera."""
    _filmed(tmp_path / "bare.avi", floor=False, shake_px=0.0)
    film = stabilised(open_film(tmp_path / "bare.avi"))
    assert film.shifts is None and not film.watched


@pytest.mark.parametrize(("hand_px", "watched", "moved"), [(0.4, False, True), (0.0, False, False), (0.4, True, False)])
def test_a_fall_that_wanders_sideways(hand_px: float, watched: bool, moved: bool) -> None:
    """A ball that leaves its line shows a hand, unless edges in the picture have shown the camera's motion."""
    frame = np.arange(40.0)
    across = hand_px * np.sin(frame / 4.0) + np.random.default_rng(1).normal(0.0, 0.05, 40)
    height = -0.1 * (frame - 20.0) ** 2
    clip = Clip("x", frame, height, 0.2, across, watched)
    words = camera_moved(clip, [Flight(0, 1, frame, height, True)])
    assert (words is not None) == moved


def test_a_floor_that_moves_is_said() -> None:
    """Impacts 2 % of the fall apart contradict a camera at rest; within their errors they do not."""
    clip, draws = np.zeros(3, dtype=np.int64), np.random.default_rng(1).normal(0.0, 0.1, (300, 3))
    apart, even = np.array([0.0, 4.0, 8.0]), np.array([0.0, 0.15, -0.1])
    assert "floor moved" in str(uneven_floor(clip, apart, apart + draws, 400.0))
    assert uneven_floor(clip, even, even + draws, 400.0) is None
