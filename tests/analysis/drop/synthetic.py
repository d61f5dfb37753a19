"""A synthetic camera and a synthetic microphone: drops of known truth, filmed through a real codec or played as taps.

The truth is integrated in small time steps, with none of the closed forms of the analysis.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from kernels.arrays import Floats

G_MPS2 = 9.80665

__all__ = ["Camera", "Room", "Truth", "film", "path", "replace", "sound", "taps"]


@dataclass(frozen=True)
class Truth:
    """What really happened: physics of the drop."""

    height_m: float = 0.06
    e0: float = 0.514
    e1_s_per_m: float = 0.0
    friction: float = 0.0
    drag_per_m: float = 0.0
    hold_s: float = 0.02
    g_mps2: float = G_MPS2
    scatter: float = 0.0  # of the restitution from bounce to bounce, one standard deviation


@dataclass(frozen=True)
class Camera:
    """How it was filmed."""

    fps: float = 1000.0
    scale_m: float = 1.5e-4
    rows: int = 520
    columns: int = 160
    exposure: float = 0.5  # of the frame interval
    noise: float = 2.0
    flicker: float = 0.06
    rod: bool = True
    perspective: float = 0.0  # relative loss of scale from the floor to the top of the picture: the camera is tilted
    block: tuple[int, int] = (46, 30)  # width, height in pixels
    floor_row: float = 480.0


@dataclass(frozen=True)
class Room:
    """How it was heard."""

    rate_hz: float = 44_100.0
    noise: float = 1e-3  # rms, of full scale
    hum: float = 0.0  # of the mains and a fan, amplitude
    speech: float = 0.0  # rms of somebody talking
    clicks: int = 0  # as loud as impacts, at any time
    unheard: int = 0  # impacts that make no sound
    echo: float = 0.03  # loudness of the room's answer to a tap
    gain: float = 0.5  # peak of the first tap; above 1 the recording clips
    channels: int = 1
    start_s: float = 0.5


def path(
    truth: Truth,
    times: Floats,
    step_s: float = 1e-5,
    settle_mps: float = 0.02,
    rng: np.random.Generator | None = None,
) -> tuple[Floats, Floats]:
    """Heights (m) at ``times`` (s, increasing), and the impact times; ``rng`` for the scatter of restitution."""
    heights, impacts = np.empty(len(times)), []
    y, v, now = truth.height_m, 0.0, 0.0
    resting, next_one = False, 0
    while next_one < len(times):
        if resting or now < truth.hold_s:
            span = (truth.hold_s if now < truth.hold_s else np.inf) - now
            while next_one < len(times) and times[next_one] <= now + span:
                heights[next_one] = y
                next_one += 1
            now += span
            continue
        direction = 1.0 if v > 0 else -1.0
        a = -truth.g_mps2 - direction * truth.friction * truth.g_mps2 - truth.drag_per_m * abs(v) * v
        moved, faster = y + v * step_s + 0.5 * a * step_s**2, v + a * step_s
        if direction > 0 and faster < 0.0:  # the apex: friction turns round within the step
            part = v / -a
            y, v, now_next = y + 0.5 * v * part, 0.0, now + part
        elif moved <= 0.0 and v <= 0.0:
            part = 2 * y / (-v + np.sqrt(v * v - 2 * a * y)) if y > 0.0 else 0.0
            hit = -(v + a * part)
            impacts.append(now + part)
            own = truth.scatter * float(rng.standard_normal()) if rng is not None else 0.0
            y, v, now_next = 0.0, (truth.e0 + own - truth.e1_s_per_m * hit) * hit, now + part
            resting = v < settle_mps
        else:
            y, v, now_next = moved, faster, now + step_s
        while next_one < len(times) and times[next_one] <= now_next:
            heights[next_one] = y
            next_one += 1
        now = now_next
    return heights, np.array(impacts)


def film(
    target: Path, truth: Truth, camera: Camera, seconds: float, rng: np.random.Generator, codec: str = "MJPG"
) -> Floats:
    """Film a drop to ``target``; returns the block's true centre row in each frame (mid exposure)."""
    count, sub = int(seconds * camera.fps), 8
    offsets = (np.arange(sub) + 0.5) / sub - 0.5
    frames = np.arange(count) / camera.fps
    instants = (frames[:, None] + offsets[None] * camera.exposure / camera.fps).ravel()
    heights, _ = path(truth, np.maximum(instants, 0.0))
    block_m = camera.block[1] * camera.scale_m
    tops, bottoms = (_row_of(heights + edge, camera).reshape(count, sub) for edge in (block_m, 0.0))
    texture = rng.normal(0.0, 6.0, (camera.rows, camera.columns)).astype(np.float64)
    scene = 190.0 + cv2.GaussianBlur(texture, (0, 0), 3.0) * 4.0
    scene[int(camera.floor_row) :] -= 60.0
    middle = camera.columns // 2
    wide = camera.block[0]
    if camera.rod:
        scene[:, middle - 2 : middle + 3] = 90.0
    shade = 55.0 + 12.0 * np.sin(np.arange(wide) / 5.0)
    columns = slice(middle - wide // 2, middle - wide // 2 + wide)
    writer = cv2.VideoWriter(str(target), cv2.VideoWriter_fourcc(*codec), 30.0, (camera.columns, camera.rows))
    edges = np.arange(camera.rows)[:, None]
    for k in range(count):
        top, bottom = tops[k], bottoms[k]
        cover = np.clip(np.minimum(edges + 1, bottom) - np.maximum(edges, top), 0.0, 1.0).mean(axis=1)
        picture = scene.copy()
        picture[:, columns] = picture[:, columns] * (1 - cover[:, None]) + shade[None] * cover[:, None]
        if camera.rod:  # the rod passes in front of the block
            picture[:, middle - 2 : middle + 3] = 90.0
        picture *= 1.0 + camera.flicker * np.sin(2 * np.pi * 100.0 * k / camera.fps)
        picture += rng.normal(0.0, camera.noise, picture.shape)
        writer.write(cv2.cvtColor(np.clip(picture, 0, 255).astype(np.uint8), cv2.COLOR_GRAY2BGR))
    writer.release()
    return 0.5 * (tops + bottoms).mean(axis=1) - 0.5  # pixel centres count from 0


def _row_of(heights: Floats, camera: Camera) -> Floats:
    """Rows at which points at these heights above the floor are seen by a tilted pinhole camera."""
    up = heights / camera.scale_m
    return camera.floor_row - up / (1.0 + camera.perspective * up / (2.0 * camera.rows))


def taps(
    truth: Truth, seconds: float, rate_hz: float, rng: np.random.Generator, noise: float = 2e-3
) -> tuple[Floats, Floats]:
    """Sound of a drop: ringing taps of falling loudness in noise; and the true impact times on the sample grid."""
    _, impacts = path(truth, np.array([seconds]), settle_mps=0.15)
    impacts = impacts[impacts < seconds - 0.1]
    sound = rng.normal(0.0, noise, int(seconds * rate_hz))
    ring = np.arange(int(0.08 * rate_hz)) / rate_hz
    for k, when in enumerate(impacts):
        first = int(np.ceil(when * rate_hz))
        tone = np.sin(2 * np.pi * 2100.0 * ring) + 0.6 * np.sin(2 * np.pi * 5300.0 * ring + 1.0)
        loud = 0.5 * 0.9**k
        stretch = sound[first : first + len(ring)]
        stretch += (loud * tone * np.exp(-ring / 0.012))[: len(stretch)]
    return sound, impacts


def sound(truth: Truth, room: Room, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """A microphone recording (samples, channels) of a drop, its impact times, and the loudness of each (peak, or 0)."""
    _, impacts = path(truth, np.array([20.0]), 1e-4, settle_mps=0.05, rng=rng)
    impacts = impacts + room.start_s
    seconds = float(impacts[-1]) + 0.5
    n = int(seconds * room.rate_hz)
    clock = np.arange(n) / room.rate_hz
    flights = np.diff(impacts, prepend=impacts[0] - 2.0 * np.sqrt(2.0 * truth.height_m / truth.g_mps2))
    loud = room.gain * (flights / flights[0]) ** rng.uniform(1.0, 1.6) * rng.lognormal(0.0, 0.25, len(impacts))
    loud[rng.choice(np.arange(1, len(impacts)), min(room.unheard, len(impacts) - 1), replace=False)] = 0.0
    modes = rng.uniform(500.0, min(9000.0, 0.4 * room.rate_hz), 4), rng.uniform(0.003, 0.02, 4), rng.uniform(0.2, 1, 4)
    taps_only = np.zeros(n)
    for when, peak in zip(impacts, loud, strict=True):
        _add_tap(taps_only, when, peak, room, modes, rng)
    for when in rng.uniform(0.0, seconds, room.clicks):
        _add_tap(taps_only, when, room.gain * rng.uniform(0.05, 0.6), room, modes, rng)
    out = np.empty((n, room.channels))
    for channel in range(room.channels):
        background = room.noise * rng.standard_normal(n) + room.hum * np.sin(2 * np.pi * 50.0 * clock)
        background += 0.3 * room.hum * np.sin(2 * np.pi * 230.0 * clock)
        out[:, channel] = taps_only * rng.uniform(0.6, 1.0) + background + room.speech * _talk(clock, rng)
    return np.clip(out, -1.0, 1.0), impacts, loud


def _add_tap(
    out: Floats, when: float, peak: float, room: Room, modes: tuple[Floats, Floats, Floats], rng: np.random.Generator
) -> None:
    first = int(np.ceil(when * room.rate_hz))
    since = np.arange(int(0.15 * room.rate_hz)) / room.rate_hz + (first / room.rate_hz - when)
    tap = np.zeros(len(since))
    for pitch, decay, share in zip(*modes, strict=True):
        tap += share * np.sin(2 * np.pi * pitch * since) * np.exp(-since / decay)
    tap /= np.abs(tap).max()
    delayed = since > 0.002
    tap += room.echo * rng.standard_normal(len(since)) * np.exp(-since / 0.05) * delayed
    stretch = out[first : first + len(tap)]
    stretch += peak * tap[: len(stretch)]


def _talk(clock: Floats, rng: np.random.Generator) -> Floats:
    """Harmonics of a voice that comes and goes a few times a second, of unit rms while it speaks."""
    pitch = 2 * np.pi * np.cumsum(120.0 + 25.0 * np.sin(2 * np.pi * 0.7 * clock + rng.uniform(0, 6))) * clock[1]
    voice = sum(np.sin(k * pitch + rng.uniform(0, 6)) / k**0.8 for k in range(1, 20))
    syllables = np.clip(np.sin(2 * np.pi * 3.5 * clock + rng.uniform(0, 6)) + rng.uniform(-0.3, 0.3), 0.0, 1.0)
    return np.asarray(voice / np.std(voice) * syllables)
