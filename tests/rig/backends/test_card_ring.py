"""The two rings behind a card's callback: places, skips, late drive."""

from __future__ import annotations

import numpy as np
import pytest

from daq.files.tables import BlockFlag
from rig.backends.portaudio import CardRing

RATE_HZ = 1000.0
N = 32


class Driver:
    """Calls back as a driver would: heard frames count up, the counter is the driver's own."""

    def __init__(self, ring: CardRing, first: int = 0) -> None:
        self.ring, self.counter, self.heard = ring, first, 0
        self.played: list[np.ndarray] = []

    def call(self, *, skipped: int = 0, late: int = 0, counts: bool = True) -> None:
        """One callback, after ``skipped`` frames that were left out, its count read ``late`` frames later."""
        self.counter += skipped
        self.heard += skipped
        heard = np.arange(self.heard, self.heard + N, dtype=np.float32)[:, np.newaxis]
        out = np.full(N, 9.0, np.float32)
        self.ring.exchange(heard, out, (self.counter + late) % 2**32 if counts else None)
        self.played.append(out)
        self.counter += N
        self.heard += N


@pytest.fixture
def ring() -> CardRing:
    """One input."""
    return CardRing(RATE_HZ, 1)


@pytest.mark.parametrize("pieces", [[7] * 100, [350, 350], [1, 699]])
def test_what_is_written_is_played_in_order_and_as_far_ahead_as_asked(ring: CardRing, pieces: list[int]) -> None:
    """However the drive is cut, it comes out whole, ``ahead`` frames after it was begun."""
    driver = Driver(ring)
    driver.call()
    drive = np.linspace(0.1, 0.9, 700).astype(np.float32)
    ring.begin(50)
    for piece in np.split(drive, np.cumsum(pieces)[:-1]):
        ring.write(piece)
        while ring.written >= ring.at + N:
            driver.call()
    while ring.at < ring.written:
        driver.call()
    played = np.concatenate(driver.played[1:])
    assert np.array_equal(played[50:750], drive) and not played[:50].any()


def test_frames_go_round_the_ring_unharmed(ring: CardRing) -> None:
    """Far more frames than the ring holds come out in order, none twice."""
    driver = Driver(ring)
    driver.call()
    due = ring.begin(N)
    for k in range(3 * ring.size // N):
        driver.call()
        due += N
        lost, frames, flags = ring.take(due)
        assert lost == flags == 0 and np.array_equal(frames[:, 0], np.arange(N * (k + 1), N * (k + 2)))


@pytest.mark.parametrize("first", [0, 2**32 - 5 * N])
def test_skipped_frames_are_declared_where_they_are_missing(ring: CardRing, first: int) -> None:
    """One skip, then two close together, also where the driver's count goes over 2^32: numbers and places are exact.

    The period after each skip is flagged, and no other: there a late callback would have looked the same.
    """
    driver = Driver(ring, first)
    driver.call()
    due = ring.begin(N)
    got: list[tuple[int, np.ndarray, int]] = []
    for k in range(60):
        driver.call(skipped={10: 2 * N, 30: N, 32: 3 * N}.get(k, 0))
        got.append(ring.take(due + driver.heard - N))
    place, lost_in_all = N, 0
    flagged: list[int] = []
    for lost, frames, flags in got:
        place += lost
        lost_in_all += lost
        flagged += [place // N] if flags else []
        assert np.array_equal(frames[:, 0], np.arange(place, place + len(frames)))
        place += len(frames)
    assert lost_in_all == 6 * N == ring.lost and place == driver.heard
    assert flagged == [13, 34, 39]


def test_a_late_callback_is_no_loss(ring: CardRing) -> None:
    """Callbacks that read the count too late, the first of all among them, lose nothing."""
    driver = Driver(ring)
    driver.call(late=N)
    due = ring.begin(N)
    frames = 0
    for k in range(40):
        driver.call(late=N if k in (3, 4, 9, 20, 21, 22) else 0)
        lost, got, flags = ring.take(due + N * (k + 1))
        assert lost == flags == 0
        frames += len(got)
    assert frames == 40 * N and ring.lost == 0


def test_frames_of_unsure_place_are_flagged(ring: CardRing) -> None:
    """A callback that reads the count late, and is then left out: the loss is declared a period early, and said so."""
    driver = Driver(ring)
    driver.call()
    due = ring.begin(N)
    place, wrong = N, []
    for k in range(30):
        driver.call(late=N if k == 9 else 0, skipped=N if k == 10 else 0)
        lost, frames, flags = ring.take(due + driver.heard - N)
        place += lost
        right = np.array_equal(frames[:, 0], np.arange(place, place + len(frames)))
        wrong += [] if right else [flags]
        place += len(frames)
    assert wrong == [BlockFlag.FILLED] and place == driver.heard and ring.lost == N


def test_drive_that_comes_too_late_is_left_out_and_keeps_its_phase(ring: CardRing) -> None:
    """Nothing handed over: soft to zero, flagged; what comes then is played where it belongs, its late part never."""
    driver = Driver(ring)
    driver.call()
    ring.begin(0)
    drive = np.full(N, 0.5, np.float32)
    ring.write(drive)
    driver.call()
    driver.call()  # nothing there
    assert driver.played[-1][0] < 0.5 and driver.played[-1][-1] == 0.0
    assert np.all(np.diff(driver.played[-1]) <= 0.0)
    _, frames, flags = ring.take(ring.at)
    assert len(frames) and flags == BlockFlag.UNDERFLOW
    ring.write(np.arange(2 * N, dtype=np.float32))
    driver.call()
    assert np.array_equal(driver.played[-1], np.arange(N, 2 * N))


def test_the_end_fades_to_zero_without_a_step(ring: CardRing) -> None:
    """After a fade no sample jumps by more than the drive itself did, and zero stays."""
    driver = Driver(ring)
    driver.call()
    ring.begin(0)
    drive = np.sin(2 * np.pi * 0.02 * np.arange(160)).astype(np.float32)
    ring.write(drive)
    ring.fade_out(100)
    while ring.at < ring.written + N:
        driver.call()
    played = np.concatenate(driver.played[1:])
    assert np.array_equal(played[:160], drive)
    assert np.abs(np.diff(played)).max() < 1.1 * np.abs(np.diff(drive)).max()
    assert not played[260:].any()


def test_frozen_inputs_are_seen_only_while_the_drive_moves(ring: CardRing) -> None:
    """Inputs frozen to the last bit mean a dead card where the drive moves, and nothing where it rests."""
    silent = np.zeros((N, 1), np.float32)
    ring.begin(0)
    for moving in (False, True):
        for _ in range(4):
            ring.write(np.linspace(0, 0.1 if moving else 0.0, N).astype(np.float32))
            ring.exchange(silent, np.zeros(N, np.float32), None)
        assert ring.still(3 * N, 0.01) == moving
