"""The model's predictions: orbits, diagrams and bifurcations, dimensionless as in the paper (gamma = A w^2 / g)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from bench.predict.profile_ramp import ramp_json, with_profile
from bench.predict.request import GivenProfile, Request, gamma_peak_over_gamma
from model.bifurcations.events import find_bifurcations
from model.orbits import make_ball as balls
from model.orbits.attractor import Attractor, Ball
from model.orbits.attractor import attractor as attractor_at
from model.surveys.diagram import KINDS, Rows, swept
from model.surveys.diagram import diagram as rows_at
from model.tones import STANDARD_GRAVITY_MPS2, Forcing
from shakerbench.tables import Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class PredictedBall:
    """A ball on its plate, at any gamma.

    Parameters
    ----------
    ball : model.orbits.attractor.Ball
        Ideal, with friction and restitution, or integrated with any effects.
    forcing : model.tones.Forcing
        The plate's tones, of amplitude 1.
    c : int
        Second tone's multiple of the first.
    frequency_hz : float or None
        First tone, Hz.
    """

    ball: Ball
    forcing: Forcing
    c: int
    frequency_hz: float | None


@dataclass(frozen=True, repr=False)
class Diagram(Table):
    """A bifurcation diagram, one attractor a row; ``rows.tau`` holds every flight time (n, 64), in 1/w, else NaN."""

    rows: Rows | None = None
    ball: PredictedBall | None = None

    def to_xarray(self) -> Any:
        """The diagram as an `xarray.Dataset`, every flight time (1/w) as ``tau`` of (gamma, flight)."""
        data = super().to_xarray()
        if self.rows is not None:
            most = max(int(np.isfinite(self.rows.tau).sum(axis=1).max(initial=0)), 1)
            data["tau"] = ((self.row, "flight"), self.rows.tau[:, :most], {"units": "1/w"})
        return data.set_coords("gamma").swap_dims({self.row: "gamma"})

    def plot(self, ax: Axes, **style: Any) -> Axes:
        """Flight times against gamma, drawn on ``ax``: in s where the frequency is known, else in forcing periods.

        Parameters
        ----------
        ax : matplotlib.axes.Axes
            Drawn on, and returned.
        **style
            Of the dots, as `Axes.plot` takes them.
        """
        if self.rows is None:
            return ax
        hz = self.ball.frequency_hz if self.ball is not None else None
        unit = 1.0 / (2.0 * math.pi * (hz or 1.0))
        gammas = np.repeat(self.rows.gamma, self.rows.tau.shape[1])
        look: dict[str, Any] = {"ms": 1.5, "color": "#16324f"} | style
        ax.plot(gammas, unit * self.rows.tau.ravel(), ".", **look)
        ax.set_xlabel("gamma")
        ax.set_ylabel("flight time (s)" if hz else "flight time (forcing periods)")
        return ax


def make_ball(
    c: int = 1,
    effects: Mapping[str, Mapping[str, float]] | None = None,
    *,
    frequency_hz: float | None = None,
    phase_deg: float = 0.0,
    g_mps2: float = STANDARD_GRAVITY_MPS2,
) -> PredictedBall:
    """A ball on a plate that moves as ``sin(wt) + sin(c wt + phase)``, to be predicted at any gamma.

    Parameters
    ----------
    c : int
        Second tone's multiple of the first; 1 is one sine.
    effects : mapping of str to mapping, optional
        Values in SI units by effect and parameter, ``{"restitution": {"e0": 0.3}}``; none: completely inelastic.
    frequency_hz : float, optional
        First tone, Hz; needed by effects that have a scale of their own.
    phase_deg : float
        Phase of the second tone, degrees.
    g_mps2 : float
        Local gravity, m/s^2.

    Returns
    -------
    PredictedBall

    Raises
    ------
    ValueError
        For unknown effects or parameters, values out of bounds, or a missing frequency.

    Examples
    --------
    >>> make_ball(c=2, effects={"restitution": {"e0": 0.3}}).c
    2
    """
    forcing = Forcing.superposition(c, phase_rad=(0.0, math.radians(phase_deg)))
    ball = balls.make_ball(forcing, effects or {}, frequency_hz=frequency_hz, g_mps2=g_mps2)
    return PredictedBall(ball, forcing, c, frequency_hz)


def attractor(ball: PredictedBall, gamma: float) -> Attractor:
    """The motion that the orbit from rest ends in.

    Parameters
    ----------
    ball : PredictedBall
        See `make_ball`.
    gamma : float
        ``A w^2 / g`` of one tone, dimensionless.

    Returns
    -------
    Attractor
        ``label``, ``period`` (forcing periods), ``tau`` (flight times, in 1/w), ``speed`` (of impact, in g/w), ...

    Raises
    ------
    ValueError
        Where gamma is negative or not finite.

    Examples
    --------
    >>> attractor(make_ball(c=2), 1.28).flights
    3
    """
    return attractor_at(ball.ball, gamma)


def diagram(ball: PredictedBall, gammas: ArrayLike, *, carried: bool = False) -> Diagram:
    """The bifurcation diagram over ``gammas``.

    Parameters
    ----------
    ball : PredictedBall
        See `make_ball`.
    gammas : array_like, shape (n,)
        Dimensionless.
    carried : bool
        Carry the state from gamma to gamma, as a bench does, instead of beginning at rest.

    Returns
    -------
    Diagram
        Columns gamma, kind, period (forcing periods; 0: chaotic), flights, resets, locked; ``plot(ax)`` draws it.

    Raises
    ------
    ValueError
        Where a gamma is negative or not finite.

    Examples
    --------
    >>> diagram(make_ball(), [0.4, 1.0])["period"]
    array([1, 1], dtype=int32)
    """
    values = np.atleast_1d(np.asarray(gammas, dtype=np.float64))
    rows = swept(ball.ball, values) if carried else rows_at(ball.ball, values)
    names = ("gamma", "kind", "period", "flights", "resets", "locked")
    columns: dict[str, Any] = {name: getattr(rows, name) for name in names} | {"kind": np.array(KINDS)[rows.kind]}
    units = {name: "1" for name in columns} | {"kind": "", "locked": ""}
    return Diagram(columns, units, {"c": ball.c}, "gamma_index", rows, ball)


def bifurcations(ball: PredictedBall, low: float, high: float, *, narrowest: float | None = None) -> Table:
    """Every bifurcation of the motion reached from rest, between two gammas.

    Parameters
    ----------
    ball : PredictedBall
        See `make_ball`.
    low, high : float
        Range of gamma, dimensionless.
    narrowest : float, optional
        Width in gamma of the narrowest window looked for; by default 1e-6, with restitution 1e-3.

    Returns
    -------
    Table
        Columns gamma, gamma_peak, type, period_before, period_after (forcing periods; 0: none).

    Raises
    ------
    ValueError
        Where the range is empty, negative or not finite.

    Examples
    --------
    >>> bifurcations(make_ball(), 0.4, 1.0)["type"].tolist()
    ['take-off']
    """
    found = [b for b in find_bifurcations(ball.ball, low, high, narrowest=narrowest) if b.gamma > low]
    gammas = np.array([b.gamma for b in found])
    columns: dict[str, Any] = {
        "gamma": gammas,
        "gamma_peak": gammas * gamma_peak_over_gamma(ball.forcing),
        "type": np.array([b.type for b in found], dtype=np.str_),
        "period_before": np.array([b.before.period or 0 for b in found], dtype=np.int64),
        "period_after": np.array([b.after.period or 0 for b in found], dtype=np.int64),
    }
    return Table(columns, {name: "1" for name in columns} | {"type": ""}, {"c": ball.c}, "bifurcation")


def predict(profile: str | Path) -> Table:
    """The motion in each step of a profile's ramp, in its order, the state carried along.

    Parameters
    ----------
    profile : str or Path
        Shipped name or path; its forcing, gravity and declared effects are used.

    Returns
    -------
    Table
        Columns step, asked_gamma, gamma (of the plate), kind, period (forcing periods; 0: chaotic), flights,
        mean_flight_time_s (s; NaN at rest).

    Raises
    ------
    InputError
        Where there is no such profile, or it has no ramp.

    Examples
    --------
    >>> predict("simulated").units["mean_flight_time_s"]  # doctest: +SKIP
    's'
    """
    given = GivenProfile(str(profile))
    rows = ramp_json(with_profile(Request(), given), given)
    names = ("step", "asked_gamma", "gamma", "kind", "period", "flights")
    columns: dict[str, Any] = {name: np.array([row[name] or 0 for row in rows]) for name in names}
    times = [row["flight_time_s"] or [math.nan] for row in rows]
    columns["mean_flight_time_s"] = np.array([float(np.mean(t)) for t in times])
    units = {name: "1" for name in columns} | {"kind": "", "mean_flight_time_s": "s"}
    return Table(columns, units, {"profile": str(profile)}, "step")
