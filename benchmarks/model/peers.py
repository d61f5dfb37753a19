"""The other solvers of `benchmarks/model/impacts.py`: one ideal flight each, as its practised user would write it.

A peer gets the take-off phase and returns the flight time; everything else is its own affair. A
peer that is not installed is absent, with a line that says so.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

Flight = Callable[[int, float, float], float]
LONGEST = 400.0


def height(c: int, gamma: float, phi0: float, tau: Any) -> Any:
    """The paper's eq. 4 as a script has it."""
    p = phi0 + tau
    return (
        gamma * (np.sin(phi0) + np.sin(c * phi0) - np.sin(p) - np.sin(c * p))
        + gamma * (np.cos(phi0) + c * np.cos(c * phi0)) * tau
        - tau**2 / 2
    )


def grid_brentq(c: int, gamma: float, phi0: float) -> float:
    """March a grid of 0.01 until the sign changes, then brentq."""
    tau = np.arange(0.01, 20.0, 0.01)
    for start in np.arange(0.0, LONGEST, 20.0):
        below = np.flatnonzero(height(c, gamma, phi0, start + tau) < 0)
        if below.size:
            t = start + tau[below[0]]
            lo = max(t - 0.01, 1e-9)
            return float(brentq(lambda x: height(c, gamma, phi0, x), lo, t)) if height(c, gamma, phi0, lo) > 0 else t
    return math.nan


def march_bisect(c: int, gammas: np.ndarray, phi0: np.ndarray) -> np.ndarray:
    """The numpy script: all orbits march together in steps of 0.02, then 50 bisections."""
    hi = np.full(phi0.size, 0.02)
    for _ in range(int(LONGEST / 0.02)):
        up = height(c, gammas, phi0, hi) > 0
        if not up.any():
            break
        hi[up] += 0.02
    lo = hi - 0.02
    for _ in range(50):
        middle = 0.5 * (lo + hi)
        up = height(c, gammas, phi0, middle) > 0
        lo, hi = np.where(up, middle, lo), np.where(up, hi, middle)
    return hi


def solve_ivp_flight(rtol: float) -> Flight:
    """scipy's RK45 with a terminal event."""

    def landed(t: float, y: np.ndarray, c: int, gamma: float) -> float:
        return float(y[0])

    landed.terminal = True  # type: ignore[attr-defined]
    landed.direction = -1  # type: ignore[attr-defined]

    def flight(c: int, gamma: float, phi0: float) -> float:
        def motion(t: float, y: np.ndarray, c: int, gamma: float) -> tuple[float, float]:
            return y[1], gamma * (math.sin(t) + c * c * math.sin(c * t)) - 1.0

        done = solve_ivp(
            motion, (phi0, phi0 + LONGEST), [0.0, 0.0], rtol=rtol, atol=rtol * 1e-2, events=landed, args=(c, gamma)
        )
        return float(done.t_events[0][0] - phi0) if done.t_events[0].size else math.nan

    return flight


def heyoka_flight() -> Flight:
    """heyoka's Taylor integrator with a terminal event; one integrator a ratio, reused."""
    import heyoka as hy

    made: dict[int, Any] = {}

    def build(c: int) -> Any:
        h, v = hy.make_vars("h", "v")
        plate = hy.sin(hy.time) + c * c * hy.sin(c * hy.time) if c > 1 else 2.0 * hy.sin(hy.time)
        event = hy.t_event(h, direction=hy.event_direction.negative)
        return hy.taylor_adaptive([(h, v), (v, hy.par[0] * plate - 1.0)], [0.0, 0.0], pars=[1.0], t_events=[event])

    def flight(c: int, gamma: float, phi0: float) -> float:
        if c not in made:
            made[c] = build(c)
        ta = made[c]
        ta.reset_cooldowns()
        ta.time, ta.pars[0], ta.state[:] = phi0, gamma, (0.0, 0.0)
        ta.propagate_until(phi0 + LONGEST)
        return float(ta.time - phi0)

    return flight


def diffrax_flight() -> Flight:
    """diffrax's Dopri8 with a root-finding event, compiled once a ratio."""
    import diffrax
    import jax
    import jax.numpy as jnp
    import optimistix

    jax.config.update("jax_enable_x64", True)

    def motion(t: Any, y: Any, args: Any) -> Any:
        c, gamma = args
        return jnp.array([y[1], gamma * (jnp.sin(t) + c * c * jnp.sin(c * t)) - 1.0])

    event = diffrax.Event(lambda t, y, args, **_: y[0], optimistix.Newton(1e-10, 1e-10), direction=False)

    @jax.jit  # type: ignore[untyped-decorator]
    def solve(c: Any, gamma: Any, phi0: Any) -> Any:
        done = diffrax.diffeqsolve(
            diffrax.ODETerm(motion), diffrax.Dopri8(), phi0, phi0 + LONGEST, None, jnp.zeros(2), args=(c, gamma),
            stepsize_controller=diffrax.PIDController(rtol=1e-10, atol=1e-12), event=event, max_steps=100_000,
            throw=False,
        )  # fmt: skip
        return done.ts[-1] - phi0

    return lambda c, gamma, phi0: float(solve(float(c), gamma, phi0))


def numbalsoda_flight() -> Flight:
    """numbalsoda's DOP853, which has no events: a dense output of 0.01, then a cubic through the change of sign."""
    import numba as nb
    from numbalsoda import dop853, lsoda_sig

    @nb.cfunc(lsoda_sig)  # type: ignore[untyped-decorator]
    def motion(t: float, y: Any, dy: Any, p: Any) -> None:
        dy[0] = y[1]
        dy[1] = p[1] * (math.sin(t) + p[0] * p[0] * math.sin(p[0] * t)) - 1.0

    address = motion.address

    def flight(c: int, gamma: float, phi0: float) -> float:
        t = phi0 + np.arange(0.0, 60.0, 0.01)
        y, _ = dop853(address, np.zeros(2), t, data=np.array([float(c), gamma]), rtol=1e-10, atol=1e-12)
        below = np.flatnonzero(y[1:, 0] < 0)
        if not below.size:
            return math.nan
        k = int(below[0]) + 1
        return float(t[k] - phi0 - 0.01 * y[k, 0] / (y[k, 0] - y[k - 1, 0]))

    return flight


def sundials_flight() -> Flight:
    """SUNDIALS' CVODE (Adams, 1e-10) with a terminal event, through scikit-sundae."""
    from sksundae.cvode import CVODE

    def motion(t: float, y: np.ndarray, yp: np.ndarray, job: tuple[int, float]) -> None:
        yp[0], yp[1] = y[1], job[1] * (math.sin(t) + job[0] ** 2 * math.sin(job[0] * t)) - 1.0

    def landed(t: float, y: np.ndarray, events: np.ndarray, job: tuple[int, float]) -> None:
        events[0] = y[0]

    landed.terminal, landed.direction = [True], [-1]  # type: ignore[attr-defined]

    def flight(c: int, gamma: float, phi0: float) -> float:
        solver = CVODE(motion, method="Adams", rtol=1e-10, atol=1e-12, userdata=(c, gamma), eventsfn=landed,
                       num_events=1, max_num_steps=100_000)  # fmt: skip
        done = solver.solve(np.array([phi0, phi0 + LONGEST]), np.zeros(2))
        return float(done.t_events[-1] - phi0) if done.t_events is not None and len(done.t_events) else math.nan

    return flight


def torchdiffeq_flight() -> Flight:
    """torchdiffeq's dopri8 with an event function, which knows no direction: the flight starts a little above."""
    import torch
    from torchdiffeq import odeint_event

    torch.set_num_threads(1)

    def flight(c: int, gamma: float, phi0: float) -> float:
        def motion(t: Any, y: Any) -> Any:
            return torch.stack((y[1], gamma * (torch.sin(t) + c * c * torch.sin(c * t)) - 1.0))

        start = torch.tensor(phi0, dtype=torch.float64)
        above = torch.tensor([1e-12, 0.0], dtype=torch.float64)
        at, _ = odeint_event(motion, above, start, event_fn=lambda t, y: y[0], method="dopri8", rtol=1e-10, atol=1e-12)
        return float(at) - phi0

    return flight


def installed() -> tuple[dict[str, Flight], list[str]]:
    """The peers at hand by name, and a line for each that is not installed."""
    found: dict[str, Flight] = {}
    missing: list[str] = []
    for name, module, make in (
        ("heyoka (Taylor, events)", "heyoka", heyoka_flight),
        ("numbalsoda DOP853", "numbalsoda", numbalsoda_flight),
        ("diffrax Dopri8, events", "diffrax", diffrax_flight),
        ("SUNDIALS CVODE, events", "sksundae", sundials_flight),
        ("torchdiffeq dopri8, events", "torchdiffeq", torchdiffeq_flight),
    ):
        if importlib.util.find_spec(module) is None:
            missing.append(f"{name}: {module} is not installed, left out")
        else:
            found[name] = make()
    found["grid + brentq"] = grid_brentq
    found["solve_ivp RK45, 1e-8"] = solve_ivp_flight(1e-8)
    found["solve_ivp RK45, default"] = solve_ivp_flight(1e-3)
    found["march of 0.02 + bisection"] = lambda c, gamma, phi0: float(
        march_bisect(c, np.array([gamma]), np.array([phi0]))[0]
    )
    return found, missing
