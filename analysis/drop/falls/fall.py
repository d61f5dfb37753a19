"""A fall, the law it follows and the axis on which its heights were read, in closed form."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import signal

from analysis.drop.laws.flight_law import FlightLaw
from kernels.arrays import Floats

_NUMBERED = re.compile(r"[\W_]*(drop|run|trial|fall|test|lancio|versuch)?[\W_]*\d+\W*$", re.IGNORECASE)


@dataclass(frozen=True)
class Fall:
    """One drop of one ball, heights counted upward."""

    name: str
    ball: str  # drops of one ball share its drag
    time_s: Floats  # (n,) as the file has them, even or not
    height_m: Floats  # (n,)


def is_fall(time: Floats, height: Floats) -> int:
    """+1 for a fall whose heights are counted upward, -1 where they are counted downward, 0 for any other motion.

    A fall goes one way, but for its noise and single strays, and is faster at its end than at its beginning.
    """
    if len(height) < 8 or np.any(np.diff(time) <= 0.0):
        return 0
    height = signal.medfilt(height, 3)
    height[[0, -1]] = height[[1, -2]]  # the filter takes zeros beyond the ends
    span = float(np.ptp(height))
    if span <= 0.0:
        return 0
    sign = 1 if height[0] > height[-1] else -1
    down = -sign * (height - height[0])
    behind = float((np.maximum.accumulate(down) - down).max())
    gone = down[-1] - down[0]
    third = len(down) // 3
    early, late = (np.polyfit(time[part], down[part], 1)[0] for part in (slice(0, third + 1), slice(-third - 1, None)))
    # in a fall that its noise disturbs a height goes up again by no more than a twentieth of the range
    falls = behind < 0.05 * span and gone > 0.9 * span and late > 1.3 * max(early, 0.0)
    return sign if falls else 0


def with_balls(falls: Sequence[Fall]) -> list[Fall]:
    """The falls, each with its ball's name: what its own name is without the number of the drop.

    ``NAME (SHEET, drop 1)`` of a workbook is a drop of the ball SHEET, ``tennis-2.csv`` one of the ball tennis, where
    there is more than one of it: else the number may belong to the ball.
    """
    inner = [m.group(1) if (m := re.search(r"\((.*)\)$", f.name)) else "" for f in falls]
    files = {f.name.split(" (")[0] for f in falls}
    names = []
    for fall, label in zip(falls, inner, strict=True):
        parts = [part.strip() for part in label.split(",")]
        stem = fall.name.split(" (")[0].rsplit(".", 1)[0]
        own = ", ".join(parts[:-1]) if len(parts) > 1 else _NUMBERED.sub("", label)
        names.append(f"{stem} {own}".strip() if len(files) > 1 or not own else own)
    bare = [_NUMBERED.sub("", name) or name for name in names]
    several, single = Counter(bare), Counter(names)
    balls = [b if several[b] > 1 and single[n] == 1 else n for n, b in zip(names, bare, strict=True)]
    return [replace(fall, ball=ball) for fall, ball in zip(falls, balls, strict=True)]


def fallen_m(since_s: Floats, g_mps2: Floats | float, k_per_m: Floats | float, c_per_s: Floats | float) -> Floats:
    """Way down since the ball was at rest in still air, m (n,); times before that are of a ball that rises.

    Quadratic drag ``k`` (ln cosh, Rayleigh) or linear drag ``c`` (Stokes), one for all or one a time. A drag below zero
    is no ball's; it goes on smoothly so that the interval of a drag can hold zero.
    """
    if np.any(c_per_s):
        x = c_per_s * since_s
        small = np.abs(x) < 1e-3
        safe = np.where(small, 1.0, x)
        share = np.where(small, 0.5 - x / 6.0, (safe + np.expm1(-safe)) / safe**2)
        return np.asarray(g_mps2 * since_s**2 * share)
    return np.asarray(FlightLaw(g_mps2, 0.0, k_per_m).drop_m(since_s))


@dataclass(frozen=True)
class Axis:
    """Axis of the heights, m: its middle and half of its length, over all falls of one camera."""

    middle_m: float
    reach_m: float

    def terms_m(self, height_m: Floats) -> Floats:
        """Errors of heights (n, 3) that a scale, a bend and a skew of one make.

        A bend is wrong by the reach in the middle and right at both ends: the scale changes by four times as much from
        the lower to the upper end, as where a camera is tilted. A skew is right at both ends and in the middle: a lens.
        """
        h = np.clip((height_m - self.middle_m) / self.reach_m, -1.5, 1.5)
        return np.asarray(self.reach_m * np.column_stack([h, h * h - 1.0, h**3 - h]))


def axis_of(falls: Sequence[Fall]) -> Axis:
    """The axis that all falls share."""
    top, bottom = max(float(f.height_m.max()) for f in falls), min(float(f.height_m.min()) for f in falls)
    return Axis(0.5 * (top + bottom), 0.5 * (top - bottom))
