"""Lack of fit of a drop test, in words: more scatter than a ball on a flat plate has, structure left over, or a camera
or floor that moved.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats

from analysis.drop import thresholds
from analysis.drop.film.track import LEAST_SAMPLES, Clip, Flight, jitter
from analysis.drop.times.model_fit import Fit, Rows
from kernels.arrays import Floats, Integers


def of_times(fit: Fit, rows: Rows, g_mps2: float) -> list[str]:
    """Things that a model of impact times leaves unexplained; empty where the residuals are noise of a usual size.

    ``fit`` is the model fitted to ``rows``.
    """
    words = []
    e0, half = float(fit.theta[0]), float(fit.half_width()[0])
    slow = fast = e0
    before = rows.before_s[rows.flights]
    if len(before):  # restitution at the slowest and at the fastest impact that was fitted
        law = fit.model.law(fit.theta, g_mps2)
        speeds = law.return_speed_mps(law.takeoff_speed_mps(np.array([before.min(), before.max()])))
        slow, fast = (float(e) for e in fit.model.rebound_mps(fit.theta, speeds) / speeds)
    if e0 - half > 1.0:
        words.append(f"a restitution of {e0:.3f} +- {half:.3f} would gain energy at each impact")
    elif max(slow, fast) > 1.0:
        words.append(f"a restitution of {max(slow, fast):.3f} at some of the speeds seen would gain energy")
    elif fast - slow > thresholds.LARGEST_RISE * e0:
        words.append(
            f"the restitution would rise from {slow:.3f} at the slowest impact to {fast:.3f} at the fastest; a ball's "
            "falls with the speed: taps of a hand, a plate that gives way, or wrong impacts"
        )
    relative = fit.widths.scatter / max(e0, 0.05)
    if relative > thresholds.LARGEST_SCATTER:
        words.append(
            f"the restitution scatters by {100 * relative:.1f} % from bounce to bounce, more than a ball on a flat "
            "plate does: a rough ball, a tilted or soft plate, or wrong impacts"
        )
    if fit.widths.jitter_s > thresholds.LARGEST_JITTER_S:
        words.append(f"impact times scatter by {1e3 * fit.widths.jitter_s:.1f} ms, more than any detector's do")
    chance = _chance_of_trend(fit, rows)
    if chance < thresholds.STRUCTURE_CHANCE:
        words.append(f"what is left over changes steadily with the length of the flight (chance {chance:.1g})")
    return words


def _chance_of_trend(fit: Fit, rows: Rows) -> float:
    """Probability by chance of the trend of the whitened residuals with flight duration (F test; 1 where too few)."""
    from_flight = ~rows.from_height[rows.valid]
    white, length = fit.white[from_flight], np.log(rows.before_s[rows.valid])[from_flight]
    n = len(white)
    if n < 8 or float(np.ptp(length)) < 1e-9:  # of residuals in which a trend is looked for
        return 1.0
    basis = np.vander((length - length.mean()) / float(np.ptp(length)), 3)
    left = white - basis @ np.linalg.lstsq(basis, white, rcond=None)[0]
    explained = float((white**2).sum() - (left**2).sum()) / 3.0
    return float(stats.f.sf(explained / max(float((left**2).sum()) / (n - 3), 1e-300), 3, n - 3))


def of_restitutions(ratio: Floats, sigma: Floats) -> str:
    """Restitutions (n,) with errors that no law follows, in words."""
    shown = ", ".join(f"{e:.3f} +- {s:.3f}" for e, s in list(zip(ratio, sigma, strict=True))[:8])
    low, high = int(np.argmin(ratio)), int(np.argmax(ratio))
    distance = (ratio[high] - ratio[low]) / max(float(np.hypot(sigma[high], sigma[low])), 1e-9)
    few = "" if len(ratio) > 3 else f"; {len(ratio)} bounces cannot tell a dependence on speed from irregular bounces"
    return (
        f"the restitution is not constant: {shown} (one standard deviation), up to {distance:.0f} sigma apart, and no "
        f"law here with fewer parameters than bounces follows it{few}"
    )


def of_camera(clip: Clip, flights: Sequence[Flight]) -> str | None:
    """A camera that moved, where the ball wanders sideways far beyond its jitter: no fall accelerates sideways.

    None also where other things in the film show that the camera stood still, or nothing is known of the ball's place
    across.
    """
    if clip.watched or clip.across is None:
        return None
    squares, noise = [np.empty(0)], []
    for flight in flights:
        inside = (clip.frame >= flight.frame[0]) & (clip.frame <= flight.frame[-1])
        frame, across = clip.frame[inside], clip.across[inside]
        if len(frame) >= LEAST_SAMPLES + 2:
            left = across - np.polynomial.Polynomial.fit(frame, across, 1)(frame)
            squares.append(left**2 * len(frame) / (len(frame) - 2))
            noise.append(jitter(across))
    if not noise:
        return None
    wander, usual = float(np.sqrt(np.concatenate(squares).mean())), float(np.median(noise))
    # less than three times the usual jitter, or than 0.15 px, is no wander
    if wander < max(0.15, 3.0 * usual):
        return None
    return (
        f"the ball wanders sideways by {wander:.2f} px within its flights, where places are good to {usual:.2f}: the "
        "camera moved, and nothing in the picture shows by how much; fix the camera, or let a floor or something with "
        "texture be seen"
    )


def of_floor(clip: Integers, floor: Floats, draws: Floats, fall: float) -> str | None:
    """A floor or camera that moved: impacts of one clip at heights that differ by far more than their errors.

    Parameters
    ----------
    clip, floor : (n,)
        Clip and height of each impact.
    draws : (m, n) float64
    fall : float
        Height of the fall, in the unit of ``floor``.
    """
    for number in np.unique(clip):
        own = (clip == number) & np.isfinite(floor)
        if own.sum() < 2:
            continue
        heights, sigma = floor[own], np.maximum(draws[:, own].std(axis=0), 1e-12)
        mean = float(np.average(heights, weights=sigma**-2.0))
        chance = float(stats.chi2.sf((((heights - mean) / sigma) ** 2).sum(), len(heights) - 1))
        step = float(np.ptp(heights))
        if chance < thresholds.UNEVEN_CHANCE and step > thresholds.LARGEST_STEP * fall:
            return (
                f"the impacts are at heights that differ by {100.0 * step / fall:.1f} % of the fall, far more than "
                "their errors: the camera or the floor moved"
            )
    return None
