"""Choice among the camera's models, what none of them accounts for, and the refusal of motion that is no drop."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from analysis.drop.film.camera_fit import CameraCandidate, CameraFit
from analysis.drop.laws.choice import UNEXPLAINED, choose, gain_of
from daq.setup.errors import InputError

LARGEST_SCATTER = 0.04  # of the restitution, relative, from bounce to bounce
_CHANCE = 1e-6  # of measuring errors alone, five sigma
_FITS = 1e-3
_LARGEST_MISFIT = 0.03  # rms over the height of the flights: a fall and bounces leave a hundredth
_LEAST_REBOUND = 0.02
_MOST_REBOUND = 0.985  # of steel on steel: no ball keeps more of its speed


@dataclass(frozen=True)
class CameraVerdict:
    """The choice.

    Attributes
    ----------
    chosen : str
        A model's name, or "unexplained".
    best : CameraCandidate
        The model that describes the data best: the chosen one, where there is one.
    tie_set : tuple of str
        Models that the data cannot tell apart, the best first.
    doubts : tuple of str
        What no model accounts for, in words.
    """

    chosen: str
    best: CameraCandidate
    tie_set: tuple[str, ...]
    doubts: tuple[str, ...]


def judge_camera(fit: CameraFit) -> CameraVerdict:
    """Choose among the models of ``fit``; a law of restitution that the bounces contradict is not chosen."""
    name, ties = choose(fit.candidates)
    best = _named(fit, name)
    doubts: list[str] = []
    if _contradicted(best):
        tested = [r for r in fit.candidates if r.shape == best.shape and r is not best and r.significant and _holds(r)]
        if tested:
            best = tested[0]
            ties = (best.model.name, *(r.model.name for r in fit.candidates if _rival(r, best)))
        else:
            doubts.append(_scatter_in_words(fit, best))
            ties = (name, *(r.model.name for r in fit.candidates if r.model.name != name and not _contradicted(r)))
    return CameraVerdict(UNEXPLAINED if doubts else best.model.name, best, ties, tuple(doubts))


def _named(fit: CameraFit, name: str) -> CameraCandidate:
    return next(r for r in fit.candidates if r.model.name == name)


def _contradicted(candidate: CameraCandidate) -> bool:
    """Whether the bounces differ by far more than their errors, and by more than a ball on a flat plate does."""
    return candidate.law.chance < _CHANCE and candidate.law.relative_scatter > LARGEST_SCATTER


def _rival(candidate: CameraCandidate, best: CameraCandidate) -> bool:
    """Whether another model holds as well, and is not beaten."""
    return candidate is not best and candidate.significant and _holds(candidate) and not gain_of(best, candidate)[1]


def _holds(candidate: CameraCandidate) -> bool:
    """Whether the law has been tested, and leaves errors or an ordinary scatter."""
    law = candidate.law
    return law.freedom > 0 and (law.chance > _FITS or law.relative_scatter <= LARGEST_SCATTER)


def _scatter_in_words(fit: CameraFit, candidate: CameraCandidate) -> str:
    seen = fit.impacts[candidate.shape]
    index = np.flatnonzero(seen.bounced)
    ratio = seen.speed_out[index] / seen.speed_in[index]
    sigma = (seen.out_draws[:, index] / seen.in_draws[:, index]).std(axis=0)
    shown = ", ".join(f"{e:.3f} +- {s:.3f}" for e, s in list(zip(ratio, sigma, strict=True))[:8])
    low, high = int(np.argmin(ratio)), int(np.argmax(ratio))
    apart = (ratio[high] - ratio[low]) / max(float(np.hypot(sigma[high], sigma[low])), 1e-9)
    few = "" if len(ratio) > 3 else f"; {len(ratio)} bounces cannot tell a dependence on speed from irregular bounces"
    return (
        f"the restitution is not constant: {shown} (one standard deviation), up to {apart:.0f} sigma apart, and no law "
        f"here with fewer parameters than bounces follows it{few}"
    )


def refuse_other_motion(fit: CameraFit, where: str) -> None:
    """Raise `InputError` where the motion is no fall with bounces: a hand, a pendulum, a ball that is thrown.

    Raises
    ------
    InputError
        No rebound, one that gains energy, or flights that no law of free flight comes near.
    """
    seen = fit.impacts["parabola"]
    index = np.flatnonzero(seen.bounced)
    if not len(index):
        raise InputError(f"{where}: no impact with a measured speed on both sides; the film must show fall and bounce")
    tall = float(np.median([np.ptp(flight.height) for flight in fit.flights]))
    misfit = min(shape.sigma for shape in fit.shapes.values()) / max(tall, 1e-12)
    if misfit > _LARGEST_MISFIT:
        raise InputError(
            f"{where}: what moves is no fall with bounces: the best curve of free flight misses it by "
            f"{100 * misfit:.0f} % of the height of its arcs; film one drop, nothing else moving, or choose its part "
            "with --region, --from and --until"
        )
    ratio = float(np.median(seen.speed_out[index] / seen.speed_in[index]))
    sigma = float(np.median((seen.out_draws[:, index] / seen.in_draws[:, index]).std(axis=0)))
    if ratio < max(_LEAST_REBOUND, 3.0 * sigma):
        raise InputError(f"{where}: no rebound: speed after over before the impact is {ratio:.3f} +- {sigma:.3f}")
    if ratio > _MOST_REBOUND:
        raise InputError(
            f"{where}: the speed after an impact is {ratio:.3f} times that before: no ball bounces on a plate at rest "
            "like this; is the film upside down, does the plate move, or is it a hand?"
        )


def with_doubts(verdict: CameraVerdict, doubts: list[str]) -> CameraVerdict:
    """The verdict with further doubts; unexplained where there is any."""
    if not doubts:
        return verdict
    return replace(verdict, chosen=UNEXPLAINED, doubts=(*verdict.doubts, *doubts))
