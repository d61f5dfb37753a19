"""Causes of what free fall leaves, tried on drops that they were not fitted to."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace

import numpy as np
from scipy import stats

from analysis.drop.falls.fit import (
    AXIS,
    OWN_AXIS,
    Fall,
    FallFit,
    Noise,
    Setting,
    Sizes,
    Values,
    axis_of,
    fit_falls,
    heights_m,
)
from analysis.drop.laws import BounceModel, Candidate, Verdict, beyond_zero, choose, worth_of
from analysis.drop.outcome import Interval, around
from analysis.drop.thresholds import LARGEST_MISFIT, LEVEL_SIGMAS
from analysis.statistics import mad_sigma
from kernels.arrays import Floats

# What each cause adds to free fall, by its name in words and in the JSON.
CAUSES = {
    "quadratic_drag": ("k_per_m",), "linear_drag": ("c_per_s",), "axis_distortion": (*AXIS, *OWN_AXIS),
    "release_speed": ("below_m",), "steady_wind": ("wind_mps",),
}  # fmt: skip
FREE_FALL = BounceModel("free_fall", ())
_TOGETHER = (
    ("quadratic_drag",), ("linear_drag",), ("axis_distortion",), ("quadratic_drag", "axis_distortion"),
    ("linear_drag", "axis_distortion"), ("quadratic_drag", "axis_distortion", "release_speed"),
    ("quadratic_drag", "axis_distortion", "steady_wind"),
)  # fmt: skip
_RICHEST = ("k_per_m", *AXIS, *OWN_AXIS)
_OPEN = (*_RICHEST, "wind_mps")  # what an interval of a drag leaves open
_OWN_AXES = (0.0, 0.01, 0.02, 0.03, 0.05, 0.08)  # by how much axes of drops may differ; each as likely beforehand


@dataclass(frozen=True)
class FallCandidate(Candidate[FallFit]):
    """A combination of causes, fitted to all falls."""

    _: KW_ONLY
    noise: Noise
    own: tuple[str, ...]  # parameters that are a drop's own, beyond its release
    shared: list[Values | None]  # of each fall: what the other falls say; None where its ball was dropped once
    held_out: list[Floats]  # of each fall: read less predicted with that, what is its own fitted to all of it, m


@dataclass(frozen=True)
class Judged:
    """Falls with everything that was fitted to them."""

    falls: list[Fall]
    setting: Setting
    noise: Noise
    verdict: Verdict[FallCandidate]
    # `held_out` of the model chosen where a drop's own axis comes from every other stretch of it: the error of the
    # stretches between
    between: list[Floats]
    uncalibrated: list[Floats]  # the same where only the release is the drop's own
    # Fits of drag with the distortion of the axis, and how likely each is: `_OWN_AXES` one after the other.
    fits: list[FallFit]
    odds: Floats
    gravity: tuple[float, float] | None  # g with its standard deviation; None: cannot be measured
    strays: int  # heights that were left out

    @property
    def best(self) -> FallCandidate:
        """The model chosen."""
        return self.verdict.candidate(self.verdict.best)

    @property
    def level(self) -> float:
        """Half of a 95 % interval in standard deviations: how axes of drops differ is known from so many drops only."""
        return float(stats.t.ppf(0.975, len(self.falls)))

    def estimate(self, name: str, owner: str = "") -> tuple[float, float]:
        """A parameter with its standard deviation, whatever the drops' own axes are."""
        return _mixed(self.fits, self.odds, name, owner)

    def interval(self, value: float, sigma: float) -> Interval:
        """A value with its 95 % interval."""
        return around(value, self.level * sigma)


def _mixed(fits: Sequence[FallFit], odds: Floats, name: str, owner: str) -> tuple[float, float]:
    """Mean and standard deviation of a parameter over fits of given odds."""
    value, sigma = np.array([(one.values[name][owner], one.sigmas[name][owner]) for one in fits]).T
    mean = float(odds @ value)
    return mean, float(np.sqrt(odds @ (sigma**2 + (value - mean) ** 2)))


def judge_falls(falls: Sequence[Fall], g_mps2: float, sizes: Sizes) -> Judged:
    """Fit every combination of causes and choose.

    Mass and diameter of a ball say how much air it displaces, and how much drag it may have.
    """
    count = sum(len(fall.time_s) for fall in falls)
    setting = Setting(axis_of(falls), g_mps2, sizes)
    noise = Noise(axis=_OWN_AXES[-1])
    first = fit_falls(falls, ("k_per_m",), setting, noise)  # from far away a distorted axis may stand for a strong drag
    for _ in range(3):  # residuals are correlated from sample to sample: how much one is worth sets what a prior weighs
        first = fit_falls(falls, _with_bulk(_RICHEST, falls, setting), setting, noise, near=first)
        # a height more than six standard deviations off is none of the ball's
        limit = 6.0 * max(mad_sigma(np.concatenate(first.left)), 0.02 * first.sigma_m)
        inside = [np.abs(left) < limit for left in first.left]
        falls = [replace(f, time_s=f.time_s[i], height_m=f.height_m[i]) for f, i in zip(falls, inside, strict=True)]
        left = [own[i] for own, i in zip(first.left, inside, strict=True)]
        spread = float(np.sqrt(np.mean(np.concatenate(left) ** 2)))
        noise = replace(noise, sigma_m=max(first.sigma_m * spread / first.rms_m, 1e-9), worth=worth_of(left))
    fits, odds = _over_axes(falls, _OPEN, setting, noise, first)
    noise = replace(noise, axis=_OWN_AXES[int(odds.argmax())])
    near = fits[int(odds.argmax())]
    candidates = [_candidate(FREE_FALL, falls, setting, noise, None)]
    for causes in _TOGETHER:
        names = tuple(name for cause in causes for name in CAUSES[cause])
        candidates.append(_candidate(BounceModel("+".join(causes), names), falls, setting, noise, near))
    # beyond 1 m/s no ball that can be seen has a linear drag in air: a millimetre has Reynolds number 70
    fast = max(float(np.ptp(f.height_m) / np.ptp(f.time_s)) for f in falls) > 1.0
    verdict = Verdict(tuple(candidates), choose([c for c in candidates if not (fast and "c_per_s" in c.fit.names)]))
    best = verdict.candidate(verdict.best)
    tall = float(np.median([np.ptp(f.height_m) for f in falls]))
    doubts: tuple[str, ...] = ()
    if best.fit.rms_m > LARGEST_MISFIT * tall:
        doubts = (f"the best law leaves {best.fit.rms_m:.2f} m of falls of {tall:.1f} m",)
    gravity = None
    if len({f.ball for f in falls}) > 2:  # one ball's drag, its scale and the distortion take up any gravity
        free = _over_axes(falls, (*_OPEN, "g_mps2"), setting, noise, near)
        value, sigma = _mixed(*free, "g_mps2", "")
        bend = _mixed(*free, "bend", "")[0]
        # Nothing shows at which place of a distorted axis its scale is right: anywhere along it.
        gravity = value, float(np.hypot(sigma, value * 2.0 * abs(bend) / np.sqrt(3.0)))
    strays = count - sum(len(fall.time_s) for fall in falls)
    between = [_between(fall, best, shared, setting) for fall, shared in zip(falls, best.shared, strict=True)]
    bare = [
        np.empty(0) if shared is None else fit_falls([fall], (), setting, best.noise, shared, best.fit).left[0]
        for fall, shared in zip(falls, best.shared, strict=True)
    ]
    verdict = replace(verdict, doubts=doubts)
    return Judged(list(falls), setting, noise, verdict, between, bare, fits, odds, gravity, strays)


def _with_bulk(names: Sequence[str], falls: Sequence[Fall], setting: Setting) -> tuple[str, ...]:
    """Parameters with the air that balls of unknown size displace, where their drag is fitted."""
    is_open = "k_per_m" in names and any(fall.ball not in setting.sizes for fall in falls)
    return (*names, "bulk_m") if is_open else tuple(names)


def _over_axes(
    falls: Sequence[Fall], names: Sequence[str], setting: Setting, noise: Noise, near: FallFit | None
) -> tuple[list[FallFit], Floats]:
    """Fits for each size of the drops' own axes, and how likely each is."""
    fits = []
    names = _with_bulk(names, falls, setting)
    for axis in _OWN_AXES:
        used = names if axis else [name for name in names if name not in OWN_AXIS]
        fits.append(fit_falls(falls, used, setting, replace(noise, axis=axis), near=near))
    evidence = np.array([one.evidence for one in fits])
    odds = np.exp(evidence - evidence.max())
    return fits, odds / odds.sum()


def _candidate(
    model: BounceModel, falls: Sequence[Fall], setting: Setting, noise: Noise, near: FallFit | None
) -> FallCandidate:
    """A model with its error on each drop whose ball was dropped again, and how well the others foretell that drop.

    The score of a drop is the probability of its heights given the other drops, every parameter integrated out: what
    is fitted to the drop itself, its own axis, is so paid for by how much of its prior the drop rules out.
    """
    names = _with_bulk([n for n in model.parameters if noise.axis or n not in OWN_AXIS], falls, setting)
    if not set(OWN_AXIS) & set(names):  # what such a law leaves is its noise
        noise = replace(noise, sigma_m=max(fit_falls(falls, names, setting, noise, near=near).sigma_m, 1e-9))
    fit = fit_falls(falls, names, setting, noise, near=near)
    drops_of = Counter(fall.ball for fall in falls)
    own = tuple(name for name in names if name in (*OWN_AXIS, "below_m"))
    scores, shared = np.zeros(len(falls)), list[Values | None]([None] * len(falls))
    held_out = [np.empty(0)] * len(falls)
    for i, fall in enumerate(falls):
        if drops_of[fall.ball] < 2:
            continue
        others = fit_falls([*falls[:i], *falls[i + 1 :]], names, setting, noise, near=fit)
        scores[i] = fit.evidence - others.evidence
        shared[i] = {name: table for name, table in others.values.items() if name not in own}
        held_out[i] = fit_falls([fall], own, setting, noise, shared[i], fit).left[0]
    left = np.concatenate(held_out)
    rms = float(np.sqrt(np.mean(left**2))) if len(left) else float("nan")
    said = {
        name: [(value, LEVEL_SIGMAS * fit.sigmas[name][owner]) for owner, value in fit.values[name].items()]
        for name in fit.names
    }
    common = {name: numbers[0] for name, numbers in said.items() if "" in fit.values[name]}
    # Each cause is beyond zero for one ball or drop at least; a distortion of the axis is judged by drops not fitted.
    judged = [name for name in fit.names if name not in (*AXIS, *OWN_AXIS, "bulk_m")]
    significant = all(any(beyond_zero({name: numbers}) for numbers in said[name]) for name in judged)
    return FallCandidate(
        model, scores, fit.rms_m, rms, bool(len(left)), fit, common, significant,
        gains_add_up=True,  # a light ball needs drag where a heavy one does not
        noise=noise, own=own, shared=shared, held_out=held_out,
    )  # fmt: skip


def _between(fall: Fall, best: FallCandidate, shared: Values | None, setting: Setting) -> Floats:
    """What is left of inner eighths of a drop whose release and own axis come from the rest of it, m.

    Not of the first and the last eighth: an axis is not foretold beyond what was seen of it.
    """
    if shared is None:
        return np.empty(0)
    part, left = np.arange(len(fall.time_s)) * 8 // len(fall.time_s), np.zeros(len(fall.time_s))
    for held in (np.isin(part, (1, 5)), np.isin(part, (2, 6)), np.isin(part, (3,)), np.isin(part, (4,))):
        seen = replace(fall, time_s=fall.time_s[~held], height_m=fall.height_m[~held])
        values = {**shared, **fit_falls([seen], best.own, setting, best.noise, shared, best.fit).values}
        left[held] = fall.height_m[held] - heights_m(values, setting, [fall], [fall.time_s[held]])
    return left[(part > 0) & (part < 7)]
