"""All falls of one camera fitted together: what all share, what a ball's drops share, and each drop's release."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from analysis.drop.falls.fall import Axis, Fall, fallen_m
from kernels.arrays import Floats

# Every parameter and whose it is. A drop's release is always its own: its height and its time.
COMMON, BALL, DROP = "common", "ball", "drop"
OWNER = {
    "g_mps2": COMMON, "bend": COMMON, "wind_mps": COMMON, "k_per_m": BALL, "c_per_s": BALL, "share": BALL,
    "scale": DROP, "lead_s": DROP, "top_m": DROP, "release_s": DROP,
}  # fmt: skip
# Priors (value, standard deviation): a drop is nearer to the camera or farther than the ruler, a hand gives a speed
# of a few m/s, air rises or sinks by as much. Without them noise would set the release and the scale of a heavy ball.
PRIORS = {"scale": (1.0, 0.05), "lead_s": (0.0, 0.2), "wind_mps": (0.0, 2.0)}

Values = Mapping[str, Mapping[str, float]]  # parameter -> owner -> value; the owner of what is common is ""


@dataclass(frozen=True)
class Setting:
    """What every fit of the same falls shares."""

    axis: Axis
    g_mps2: float
    share: Mapping[str, float]  # of a ball's weight, what buoyancy and the air that moves with it leave
    prior_m: float = 0.1  # residual that counts as one standard deviation against a prior


@dataclass(frozen=True)
class FallFit:
    """A joint fit."""

    names: tuple[str, ...]  # of the parameters beyond the releases
    values: dict[str, dict[str, float]]  # as `Values`
    sigmas: dict[str, dict[str, float]]  # standard deviations, residuals taken as independent
    left: list[Floats]  # of each fall: read less predicted, m
    sigma_m: float  # rms residual over the degrees of freedom

    @property
    def rms_m(self) -> float:
        """Root mean square of all residuals, m."""
        return float(np.sqrt(np.mean(np.concatenate(self.left) ** 2)))


def owner_of(name: str, fall: Fall) -> str:
    """Whose value of a parameter a fall takes."""
    return {COMMON: "", BALL: fall.ball, DROP: fall.name}[OWNER[name]]


def height_m(values: Values, setting: Setting, fall: Fall, time_s: Floats) -> Floats:
    """Height read for one fall at ``time_s`` (n,); parameters that ``values`` lacks are those of free fall."""

    def value(name: str, default: float = 0.0) -> float:
        return float(values.get(name, {}).get(owner_of(name, fall), default))

    share = setting.share.get(fall.ball, 1.0)
    g = value("g_mps2", setting.g_mps2) * value("scale", 1.0) * share
    # Held until its release; a lead makes the release earlier or later than the rest in still air.
    since = np.maximum(time_s - value("release_s"), value("lead_s"))
    wind = value("wind_mps") * (since - value("lead_s"))
    fallen = fallen_m(since, g, value("k_per_m"), value("c_per_s"))
    return setting.axis.seen_m(value("top_m") - fallen + wind, value("bend"))


def _start(slots: Sequence[tuple[str, str]], falls: Sequence[Fall], setting: Setting, near: FallFit | None) -> Floats:
    """Free fall from the first height with the drag of a light ball; or what a fit to nearly the same has."""
    first = {fall.name: fall for fall in falls}
    usual = {"g_mps2": setting.g_mps2, "k_per_m": 0.01, "c_per_s": 0.1, "scale": 1.0}
    out = []
    for name, owner in slots:
        value = usual.get(name, 0.0)
        if name == "top_m":
            value = float(first[owner].height_m.max())
        elif name == "release_s":
            value = float(first[owner].time_s[0])
        out.append(near.values.get(name, {}).get(owner, value) if near is not None else value)
    return np.array(out)


def fit_falls(
    falls: Sequence[Fall],
    names: Sequence[str],
    setting: Setting,
    known: Values | None = None,
    near: FallFit | None = None,
) -> FallFit:
    """Least squares of all falls.

    Parameters
    ----------
    names
        Parameters of `OWNER` to be fitted beyond each release.
    known
        Values of further parameters.
    near
        A fit to start from.
    """
    fitted = (*names, "top_m", "release_s")
    slots = list(dict.fromkeys((name, owner_of(name, fall)) for name in fitted for fall in falls))
    bounds = np.cumsum([0, *(len(fall.time_s) for fall in falls)])
    priors = dict(PRIORS)
    if "scale" in names:  # else nothing else says how large g is
        priors["g_mps2"] = (setting.g_mps2, PRIORS["scale"][1] * setting.g_mps2)
    judged = [k for k, (name, _) in enumerate(slots) if name in priors]
    usual, width = np.array([priors[slots[k][0]] for k in judged]).reshape(-1, 2).T

    def named(vector: Floats) -> dict[str, dict[str, float]]:
        out: dict[str, dict[str, float]] = {name: {} for name in fitted}
        for (name, owner), value in zip(slots, vector.tolist(), strict=True):
            out[name][owner] = value
        return out

    def left(vector: Floats) -> Floats:
        values = {**(known or {}), **named(vector)}
        parts = [fall.height_m - height_m(values, setting, fall, fall.time_s) for fall in falls]
        return np.concatenate([*parts, (vector[judged] - usual) / width * setting.prior_m])

    def slopes(vector: Floats) -> Floats:
        """Derivatives of `left`; all owners of one parameter are moved at once, for no sample knows two of them."""
        here, out = left(vector), np.zeros((bounds[-1] + len(judged), len(vector)))
        for name in fitted:
            own = [k for k, slot in enumerate(slots) if slot[0] == name]
            moved = vector.copy()
            moved[own] += 1e-6
            change = (left(moved) - here) / 1e-6
            for fall, start, stop in zip(falls, bounds[:-1], bounds[1:], strict=True):
                out[start:stop, slots.index((name, owner_of(name, fall)))] = change[start:stop]
        out[np.arange(len(judged)) + bounds[-1], judged] = setting.prior_m / width
        return out

    # MINPACK uses one thread: of matrices as small as these, several only wait for each other.
    found = least_squares(
        left, _start(slots, falls, setting, near), jac=slopes, method="lm", x_scale="jac", max_nfev=60, ftol=1e-6
    )
    sigma = float(np.sqrt(found.fun @ found.fun / max(int(bounds[-1]) - len(found.x) + len(judged), 1)))
    steep = slopes(found.x)
    wide = np.sqrt(np.maximum(np.diag(np.linalg.pinv(steep.T @ steep)), 0.0)) * sigma
    residuals = np.split(found.fun[: bounds[-1]], bounds[1:-1])
    return FallFit(tuple(names), named(found.x), named(wide), residuals, sigma)
