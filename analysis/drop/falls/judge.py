"""Causes of what free fall leaves, tried on drops that they were not fitted to."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from analysis.drop.falls.fall import Fall, axis_of
from analysis.drop.falls.fit import DROP, OWNER, PRIORS, FallFit, Setting, fit_falls
from analysis.drop.laws.bounce_law import BounceModel
from analysis.drop.laws.choice import Candidate, Verdict, choose, worth_of
from analysis.drop.thresholds import LARGEST_MISFIT, LEAST_GAIN_NATS, LEVEL_SIGMAS
from kernels.arrays import Floats

# What each cause adds to free fall, by its name in words and in the JSON.
CAUSES = {
    "quadratic_drag": "k_per_m", "linear_drag": "c_per_s", "axis_distortion": "bend", "axis_scale": "scale",
    "release_speed": "lead_s", "steady_wind": "wind_mps",
}  # fmt: skip
FREE_FALL = BounceModel("free_fall", ())
_TOGETHER = (
    ("quadratic_drag",), ("linear_drag",), ("axis_distortion",), ("quadratic_drag", "axis_distortion"),
    ("linear_drag", "axis_distortion"), ("quadratic_drag", "axis_distortion", "release_speed"),
    ("quadratic_drag", "axis_distortion", "steady_wind"),
)  # fmt: skip
_RICHEST = ("quadratic_drag", "axis_distortion")
_STOKES_MPS = 1.0  # beyond which no ball that can be seen has a linear drag in air: a millimetre has Reynolds number 70


@dataclass(frozen=True)
class FallCandidate(Candidate):
    """A combination of causes, fitted to all falls."""

    fit: FallFit
    # held_out, unscaled: of each fall, read less predicted with what the other falls say, m; empty without others. A
    # drop's release is its own in both; its scale only in the first
    held_out: list[Floats]
    unscaled: list[Floats]
    worth: float  # independent samples per sample

    def half(self, name: str, owner: str) -> float:
        """Half of the 95 % interval of one parameter."""
        return LEVEL_SIGMAS * self.fit.sigmas[name][owner] / float(np.sqrt(self.worth))

    @property
    def plausible(self) -> bool:
        """Whether each drop's scale is one that its distance from the camera may have made: within three sigma."""
        usual, width = PRIORS["scale"]
        return all(abs(s - usual) < 3.0 * width for s in self.fit.values.get("scale", {}).values())

    @property
    def significant(self) -> bool:
        """Whether each cause is beyond zero for one ball at least; a drag below zero is none.

        What is each drop's own has a prior, and is judged by the drops not fitted to.
        """
        for name in (name for name in self.fit.names if OWNER[name] != DROP):
            away = [(v, self.half(name, owner)) for owner, v in self.fit.values[name].items()]
            if not any(v > half or (name not in ("k_per_m", "c_per_s") and -v > half) for v, half in away):
                return False
        return True


@dataclass(frozen=True)
class Judged:
    """Falls with everything that was fitted to them."""

    falls: list[Fall]
    setting: Setting
    verdict: Verdict[FallCandidate]
    wide: FallFit  # drag, distortion, scales and gravity together: what each leaves open of the others
    by_ball: dict[str, FallFit]  # the same of each ball by itself
    gravity: tuple[float, float] | None  # g with half of its 95 % interval; None: cannot be measured
    worth: float

    @property
    def best(self) -> FallCandidate:
        """The model chosen."""
        return self.verdict.candidate(self.verdict.best)

    def drag_of(self, ball: str) -> tuple[float, float, float]:
        """A ball's drag with its 95 % interval, 1/m: that of all balls together, and of this ball by itself.

        Together, the distortion of the axis is better known; by itself, no other ball's errors enter. Both must hold
        it.
        """
        together = self.best.fit.values["k_per_m"][ball]
        ends = [together]
        for fit in (self.wide, self.by_ball[ball]):
            half = LEVEL_SIGMAS * fit.sigmas["k_per_m"][ball] / float(np.sqrt(self.worth))
            ends += [fit.values["k_per_m"][ball] - half, fit.values["k_per_m"][ball] + half]
        return together, min(ends), max(ends)


def judge_falls(falls: Sequence[Fall], g_mps2: float, share: Mapping[str, float]) -> Judged:
    """Fit every combination of causes and choose.

    Parameters
    ----------
    share
        Of its weight, what buoyancy and the air that moves with it leave of a ball's acceleration, where its mass and
        size are known.
    """
    setting = Setting(axis_of(falls), g_mps2, share)
    richest = ("k_per_m", "bend", "scale")
    # Residuals are correlated from sample to sample: how much a sample is worth, and so what weighs against a prior.
    first = fit_falls(falls, richest, setting)
    worth = worth_of(first.left)
    setting = replace(setting, prior_m=first.sigma_m / float(np.sqrt(worth)))

    def tried(*causes: str, near: FallFit | None = first) -> FallCandidate:
        model = BounceModel("+".join(causes), tuple(CAUSES[c] for c in causes))
        return _candidate(model, falls, setting, worth, near)

    # Whether each drop has a scale of its own comes first, by all the evidence: that one drop needs it and another
    # does not is no disagreement between them.
    alike, scaled = tried(*_RICHEST), tried(*_RICHEST, "axis_scale")
    more = float(scaled.scores.sum() - alike.scores.sum()) > LEAST_GAIN_NATS
    together = scaled if more else alike
    own = ("axis_scale",) if more else ()
    candidates = (
        _candidate(FREE_FALL, falls, setting, worth, None),
        *(together if c == _RICHEST else tried(*c, *own, near=together.fit) for c in _TOGETHER),
    )
    fast = max(float(np.ptp(f.height_m) / np.ptp(f.time_s)) for f in falls) > _STOKES_MPS
    able = [c for c in candidates if not (fast and "c_per_s" in c.model.parameters)]
    verdict = Verdict(candidates, choose(able))
    best = verdict.candidate(verdict.best)
    doubts = []
    tall = float(np.median([np.ptp(f.height_m) for f in falls]))
    if best.fit.rms_m > LARGEST_MISFIT * tall:
        doubts.append(f"the best law leaves {best.fit.rms_m:.2f} m of falls of {tall:.1f} m")
    free = (*richest, "g_mps2")
    wide = fit_falls(falls, free, setting)
    by_ball = {
        ball: fit_falls([f for f in falls if f.ball == ball], free, setting, near=wide)
        for ball in dict.fromkeys(f.ball for f in falls)
    }
    gravity = _gravity(falls, best, setting, worth)
    return Judged(list(falls), setting, replace(verdict, doubts=tuple(doubts)), wide, by_ball, gravity, worth)


def _candidate(
    model: BounceModel, falls: Sequence[Fall], setting: Setting, worth: float, near: FallFit | None
) -> FallCandidate:
    """A model with its error on each drop whose ball was dropped again: only what is a drop's own is fitted to it."""
    fit = fit_falls(falls, model.parameters, setting, near=near)
    drops_of = Counter(fall.ball for fall in falls)
    own = tuple(name for name in model.parameters if OWNER[name] == DROP)
    sigma, none = max(fit.sigma_m, 1e-9), np.empty(0)
    scores, held_out, unscaled = np.zeros(len(falls)), [none] * len(falls), [none] * len(falls)
    for i, fall in enumerate(falls):
        if drops_of[fall.ball] < 2:
            continue
        others = fit_falls([*falls[:i], *falls[i + 1 :]], model.parameters, setting, near=fit).values
        alone = fit_falls([fall], own, setting, others, fit)
        held_out[i] = alone.left[0]
        unscaled[i] = fit_falls([fall], (), setting, others, fit).left[0] if own else alone.left[0]
        scores[i] = -worth * (len(held_out[i]) * np.log(sigma) + 0.5 * float(held_out[i] @ held_out[i]) / sigma**2)
        # What is fitted to the held-out drop itself is no prediction: it is paid for as under its prior, by how far
        # it is from the usual, and by how much of the prior's width the drop rules out.
        for name in own:
            usual, width = PRIORS[name]
            posterior = min(alone.sigmas[name][fall.name] / float(np.sqrt(worth)), width)
            scores[i] -= 0.5 * ((alone.values[name][fall.name] - usual) / width) ** 2 + np.log(width / posterior)
    left = np.concatenate([*held_out, none])
    rms = float(np.sqrt(np.mean(left**2))) if len(left) else float("nan")
    return FallCandidate(model, scores, fit.rms_m, rms, bool(len(left)), fit, held_out, unscaled, worth)


def _gravity(falls: Sequence[Fall], best: FallCandidate, setting: Setting, worth: float) -> tuple[float, float] | None:
    """Gravity, free together with the distortion of the axis; None for fewer than three balls.

    One ball's drag, its scale and the distortion take up any gravity. The interval is the wider of the fit's and of
    the balls' left out one after the other, with where on a distorted axis its scale is right: nothing shows that.
    """
    balls = list(dict.fromkeys(f.ball for f in falls))
    if len(balls) < 3:
        return None
    names = tuple(dict.fromkeys([*(n for n in best.model.parameters if n != "scale"), "bend", "g_mps2"]))
    fit = fit_falls(falls, names, setting)
    value, bend = fit.values["g_mps2"][""], fit.values["bend"][""]
    less = [fit_falls([f for f in falls if f.ball != ball], names, setting, near=fit) for ball in balls]
    each = np.array([one.values["g_mps2"][""] for one in less])
    jackknife = float(np.sqrt((len(each) - 1) / len(each) * ((each - each.mean()) ** 2).sum()))
    sigma = max(fit.sigmas["g_mps2"][""] / float(np.sqrt(worth)), jackknife)
    somewhere = value * 2.0 * abs(bend) / float(np.sqrt(3.0))  # the scale at a place drawn evenly along the axis
    return value, LEVEL_SIGMAS * float(np.hypot(sigma, somewhere))
