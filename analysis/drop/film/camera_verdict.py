"""Choice among the camera's models, and the refusal of motion that is no drop."""

from __future__ import annotations

import numpy as np

from analysis.drop import lack_of_fit, thresholds
from analysis.drop.film.camera_fit import CameraCandidate, CameraFit
from analysis.drop.laws.choice import Verdict, choose, gain_of
from daq.setup.errors import InputError


def judge_camera(fit: CameraFit) -> Verdict[CameraCandidate]:
    """Choose among the models of ``fit``; a law of restitution that the bounces contradict is not chosen."""
    verdict = Verdict(fit.candidates, choose(fit.candidates))
    best = verdict.candidate(verdict.best)
    if not _is_contradicted(best):
        return verdict
    able = [one for one in fit.candidates if one is not best and one.significant and _holds(one)]
    holding = next((one for one in able if one.shape == best.shape), None)
    if holding is not None:
        rivals = [one for one in fit.candidates if one.significant and _holds(one) and not gain_of(holding, one)[1]]
        names = [one.model.name for one in rivals if one is not holding]
        return Verdict(fit.candidates, (holding.model.name, *names))
    names = [one.model.name for one in fit.candidates if one is not best and not _is_contradicted(one)]
    doubt = lack_of_fit.of_restitutions(*fit.impacts[best.shape].restitution())
    return Verdict(fit.candidates, (best.model.name, *names), (doubt,))


def _is_contradicted(candidate: CameraCandidate) -> bool:
    """Whether the bounces differ by far more than their errors, and by more than a ball on a flat plate does."""
    law = candidate.law
    return law.chance < thresholds.UNEVEN_CHANCE and law.relative_scatter > thresholds.LARGEST_SCATTER


def _holds(candidate: CameraCandidate) -> bool:
    """Whether the law has been tested, and leaves errors or an ordinary scatter."""
    law = candidate.law
    followed = law.chance > thresholds.FOLLOWED_CHANCE or law.relative_scatter <= thresholds.LARGEST_SCATTER
    return law.freedom > 0 and followed


def refuse_other_motion(fit: CameraFit, where: str) -> None:
    """Raise `InputError` where the motion is no fall with bounces: a hand, a pendulum, a ball that is thrown.

    Raises
    ------
    InputError
        No rebound, one that gains energy, or flights that no law of free flight comes near.
    """
    ratios, sigmas = fit.impacts["parabola"].restitution()
    if not len(ratios):
        raise InputError(f"{where}: no impact with a measured speed on both sides; the film must show fall and bounce")
    tall = float(np.median([np.ptp(flight.height) for flight in fit.flights]))
    misfit = min(shape.sigma for shape in fit.shapes.values()) / max(tall, 1e-12)
    if misfit > thresholds.LARGEST_MISFIT:
        raise InputError(
            f"{where}: what moves is no fall with bounces: the best curve of free flight misses it by "
            f"{100 * misfit:.0f} % of the height of its arcs; film one drop, nothing else moving, or choose its part "
            "with --region, --from and --until"
        )
    ratio, sigma = float(np.median(ratios)), float(np.median(sigmas))
    if ratio < max(thresholds.LEAST_REBOUND, 3.0 * sigma):
        raise InputError(f"{where}: no rebound: speed after over before the impact is {ratio:.3f} +- {sigma:.3f}")
    if ratio > thresholds.MOST_REBOUND:
        raise InputError(
            f"{where}: the speed after an impact is {ratio:.3f} times that before: no ball bounces on a plate at rest "
            "like this; is the film upside down, does the plate move, or is it a hand?"
        )
