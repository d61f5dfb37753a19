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
_RELEASE = ("top_m", "release_s")
# Priors (value, standard deviation): a drop is nearer to the camera or farther than the ruler, a hand gives a speed
# of a few m/s, air rises or sinks by as much. Without them noise would set the release and the scale of a heavy ball.
PRIORS = {"scale": (1.0, 0.05), "lead_s": (0.0, 0.2), "wind_mps": (0.0, 2.0)}


@dataclass(frozen=True)
class FallFit:
    """A joint fit."""

    names: tuple[str, ...]  # of the parameters beyond the releases
    values: dict[str, dict[str, float]]  # parameter -> owner -> value; the owner of what is common is ""
    sigmas: dict[str, dict[str, float]]  # standard deviations, residuals taken as independent
    left: list[Floats]  # of each fall: read less predicted, m
    sigma_m: float  # rms residual over the degrees of freedom

    @property
    def rms_m(self) -> float:
        """Root mean square of all residuals, m."""
        return float(np.sqrt(np.mean(np.concatenate(self.left) ** 2)))


class FallModel:
    """Heights of falls as a function of a vector of parameters, with its derivatives by differences."""

    def __init__(
        self,
        falls: Sequence[Fall],
        axis: Axis,
        names: Sequence[str],
        known: Mapping[str, Mapping[str, float]],
        g_mps2: float,
        prior_m: float,
    ) -> None:
        self.falls, self.axis, self.known, self.g_mps2 = falls, axis, known, g_mps2
        self.names, self.prior_m = (*names, *_RELEASE), prior_m
        self.slots: list[tuple[str, str]] = []  # (parameter, owner) of each number of the vector
        for name in self.names:
            self.slots += [(name, owner) for owner in self._owners(name)]
        self.at = {slot: k for k, slot in enumerate(self.slots)}
        self.bounds = np.cumsum([0, *(len(f.time_s) for f in falls)])
        self.priors = dict(PRIORS)
        if "scale" in names:  # else nothing else says how large g is
            self.priors["g_mps2"] = (g_mps2, PRIORS["scale"][1] * g_mps2)
        self.judged = [k for k, (name, _) in enumerate(self.slots) if name in self.priors]
        usual = [self.priors[self.slots[k][0]] for k in self.judged]
        self.usual, self.width = np.array(usual).reshape(-1, 2).T

    def _owners(self, name: str) -> list[str]:
        if OWNER[name] == COMMON:
            return [""]
        return list(dict.fromkeys(f.ball if OWNER[name] == BALL else f.name for f in self.falls))

    def _value(self, vector: Floats, name: str, fall: Fall, default: float) -> float:
        owner = {COMMON: "", BALL: fall.ball, DROP: fall.name}[OWNER[name]]
        k = self.at.get((name, owner))
        return float(vector[k]) if k is not None else float(self.known.get(name, {}).get(owner, default))

    def height_m(self, vector: Floats, fall: Fall, time_s: Floats) -> Floats:
        """Height read for one fall at ``time_s`` (n,)."""

        def value(name: str, default: float = 0.0) -> float:
            return self._value(vector, name, fall, default)

        g = value("g_mps2", self.g_mps2) * value("scale", 1.0) * value("share", 1.0)
        # Held until its release; a lead makes the release earlier or later than the rest in still air.
        since = np.maximum(time_s - value("release_s"), value("lead_s"))
        wind = value("wind_mps") * (since - value("lead_s"))
        height = value("top_m") - fallen_m(since, g, value("k_per_m"), value("c_per_s")) + wind
        return self.axis.seen_m(height, value("bend"))

    def left(self, vector: Floats) -> Floats:
        """Read less predicted, of all samples, m; then what the priors say."""
        parts = [f.height_m - self.height_m(vector, f, f.time_s) for f in self.falls]
        return np.concatenate([*parts, (vector[self.judged] - self.usual) / self.width * self.prior_m])

    def slopes(self, vector: Floats) -> Floats:
        """Derivatives of `left`, all owners of one parameter moved at once: no sample knows two of them."""
        here, out = self.left(vector), np.zeros((self.bounds[-1] + len(self.judged), len(vector)))
        for name in self.names:
            own = [k for k, (n, _) in enumerate(self.slots) if n == name]
            moved = vector.copy()
            moved[own] += 1e-6
            change = (self.left(moved) - here) / 1e-6
            for k in own:
                owner = self.slots[k][1]
                for i, fall in enumerate(self.falls):
                    if owner in ("", {BALL: fall.ball, DROP: fall.name}.get(OWNER[name])):
                        out[self.bounds[i] : self.bounds[i + 1], k] = change[self.bounds[i] : self.bounds[i + 1]]
        for row, k in enumerate(self.judged):
            out[self.bounds[-1] + row, k] = self.prior_m / self.width[row]
        return out

    def start(self, near: FallFit | None) -> Floats:
        """Free fall from the first height with the drag of a light ball; or what a fit to nearly the same has."""
        usual = {"g_mps2": self.g_mps2, "k_per_m": 0.01, "c_per_s": 0.1, "scale": 1.0}
        first = {f.name: f for f in self.falls}
        values = []
        for name, owner in self.slots:
            if near is not None and owner in near.values.get(name, {}):
                values.append(near.values[name][owner])
            elif name == "top_m":
                values.append(float(first[owner].height_m.max()))
            elif name == "release_s":
                values.append(float(first[owner].time_s[0]))
            else:
                values.append(usual.get(name, 0.0))
        return np.array(values)


def fit_falls(
    falls: Sequence[Fall],
    axis: Axis,
    names: Sequence[str],
    g_mps2: float,
    known: Mapping[str, Mapping[str, float]] | None = None,
    prior_m: float = 0.1,
    near: FallFit | None = None,
) -> FallFit:
    """Least squares of all falls.

    Parameters
    ----------
    names
        Parameters of `OWNER` to be fitted beyond each release.
    known
        Values of further parameters: parameter -> owner -> value.
    prior_m
        Residual that counts as one standard deviation against a prior.
    near
        A fit to start from.
    """
    model = FallModel(falls, axis, names, known or {}, g_mps2, prior_m)
    found = least_squares(model.left, model.start(near), jac=model.slopes, x_scale="jac", max_nfev=60, ftol=1e-6)
    samples = int(model.bounds[-1])
    freedom = max(samples - len(found.x) + len(model.judged), 1)
    sigma = float(np.sqrt(found.fun @ found.fun / freedom))
    slopes = model.slopes(found.x)
    wide = np.sqrt(np.maximum(np.diag(np.linalg.pinv(slopes.T @ slopes)), 0.0)) * sigma
    values: dict[str, dict[str, float]] = {name: {} for name in model.names}
    sigmas: dict[str, dict[str, float]] = {name: {} for name in model.names}
    for (name, owner), value, width in zip(model.slots, found.x.tolist(), wide.tolist(), strict=True):
        values[name][owner], sigmas[name][owner] = value, width
    left = np.split(found.fun[:samples], model.bounds[1:-1])
    return FallFit(tuple(names), values, sigmas, left, sigma)


def predicted_m(fit: FallFit, axis: Axis, g_mps2: float, fall: Fall, time_s: Floats) -> Floats:
    """Height that a fit predicts for one of its falls at ``time_s`` (n,)."""
    model = FallModel([fall], axis, (), fit.values, g_mps2, 0.0)
    vector = np.array([fit.values[name][owner] for name, owner in model.slots])
    return model.height_m(vector, fall, time_s)
