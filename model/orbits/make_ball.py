"""The fastest ball that knows every effect asked for, and the integrated one, which knows all.

The integrated ball is SI inside, dimensionless outside. The integration has a tolerance, so an orbit is closed where
the take-off phase from rest repeats within `REPEATS`, not exactly.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kernels.arrays import Floats
from kernels.errors import InputError
from model.effects.base import COMPILED_HOOKS
from model.effects.registry import effect, resolve
from model.flight.branches import TWO_PI
from model.flight.numerics import FrictionRestitution
from model.integrator import one_step
from model.integrator.flight import LONGEST_PERIODS
from model.integrator.problem import Law, tones_for_kernel
from model.orbits.attractor import Ball, LockedCycle, Path, State, locked_cycle
from model.orbits.exact_ball import FrictionBall, IdealBall, resting
from model.tones import STANDARD_GRAVITY_MPS2, Forcing, Plate

REPEATS = 1e-6  # phase
TANGENT = 1e-5  # shift of phase and speed by which the Jacobian is measured


@dataclass(frozen=True)
class IntegratedBall:
    """A ball on ``forcing`` at ``frequency_hz`` with ``effects`` by name and parameter."""

    forcing: Forcing
    effects: Mapping[str, Mapping[str, float]]
    frequency_hz: float
    g_mps2: float

    @property
    def omega_radps(self) -> float:
        """Angular frequency of the first tone."""
        return TWO_PI * self.frequency_hz

    @property
    def bounces(self) -> bool:
        """Whether an impact can throw it back."""
        return "restitution" in self.effects

    def _simulate(self, gamma: float, phase: float, launch: float, flights: int) -> one_step.Orbit:
        n, b, _ = self.forcing.tones.T
        most = 0.5 * TWO_PI * LONGEST_PERIODS / float(np.sum(n * b))
        if not gamma <= most:
            raise InputError(
                f"gamma = {gamma:g}: with these effects a flight is followed for {LONGEST_PERIODS:g} periods of the "
                f"forcing, which is enough up to gamma = {most:.4g} on this plate"
            )
        w = self.omega_radps
        tones = self._tones * (1.0, gamma, gamma)
        # the kernel starts at an impact: the speed v whose rebound e0 v - e1 v^2 is the launch
        e0 = self.effects.get("restitution", {}).get("e0", 0.0)
        e1 = self.effects.get("restitution", {}).get("e1_s_per_m", 0.0) * self.g_mps2 / self.omega_radps
        impact = 0.0
        if launch > 0.0 and e0 > 0.0:
            root = e0 * e0 - 4.0 * e1 * launch
            impact = launch / e0 if e1 == 0.0 else (e0 - math.sqrt(max(root, 0.0))) / (2.0 * e1)
        start = (phase / w, impact * self.g_mps2 / w)
        return one_step.flown(self._law, tones, 1.0 / self.frequency_hz, flights, start)

    @cached_property
    def _law(self) -> Law:
        return one_step.law_of(self.effects, self.g_mps2)

    @cached_property
    def _tones(self) -> Floats:
        """The plate's tones at gamma 1, as the integrator takes them."""
        n, b, p = self.forcing.tones.T
        plate = Plate(n * self.omega_radps, 1j * self.g_mps2 * n**2 * b * np.exp(1j * p))
        return tones_for_kernel(plate.omega_radps, plate.acceleration)

    def fly(self, gamma: float, start: State, max_flights: int) -> Path:
        """See `model.orbits.attractor.Ball.fly`."""
        w, speed_unit = self.omega_radps, self.g_mps2 / self.omega_radps
        # each flight costs an integration
        found = self._simulate(gamma, start.phase, start.speed, min(max_flights, 300))
        count = found.takeoff_s.size
        if count == 0:
            return resting(start)
        takeoff, landing = found.takeoff_s * w, found.landing_s * w
        phase, reset = np.mod(takeoff, TWO_PI), found.after_rest
        chatter = np.zeros(count, dtype=bool)
        chatter[:-1] = reset[1:] & self.bounces
        first, stop = _closes(phase, reset)
        periods = round((takeoff[stop] - takeoff[first]) / TWO_PI) if first >= 0 else 0
        done = slice(0, stop)
        launch = found.launch_mps[stop] / speed_unit if stop < count else 0.0
        last = State(float(landing[stop - 1] % TWO_PI), float(launch))
        return Path(
            (landing - takeoff)[done],
            phase[done],
            found.impact_mps[done] / speed_unit,
            reset[done],
            chatter[done],
            first,
            periods,
            last,
        )

    def close(self, gamma: float, near: State, n: int) -> LockedCycle | None:
        """See `model.orbits.attractor.Ball.close`: Newton with a measured Jacobian."""
        x = np.array([near.phase, near.speed])
        size = 2 if self.bounces else 1
        for _ in range(12):
            here = self._after(gamma, x, n)
            if here is None:
                return None
            jacobian = np.zeros((size, size))
            for j in range(size):
                shift = TANGENT * np.eye(2)[j]
                ahead, behind = self._after(gamma, x + shift, n), self._after(gamma, x - shift, n)
                if ahead is None:
                    return None
                # just beyond a threshold a ball shifted back would rest: there one side has to do
                span = TANGENT if behind is None else 2.0 * TANGENT
                jacobian[:, j] = _difference(ahead, here if behind is None else behind)[:size] / span
            miss = _difference(here, x)[:size]
            step = np.linalg.solve(np.eye(size) - jacobian, miss)
            x[:size] += step
            if np.max(np.abs(step)) < 1e-9:
                return self._cycle(gamma, x, n, jacobian)
        return None

    def _after(self, gamma: float, state: np.ndarray, n: int) -> np.ndarray | None:
        """State after ``n`` flights that do not rest."""
        found = self._simulate(gamma, float(state[0]), float(state[1]), n + 1)
        if found.takeoff_s.size < n + 1 or found.after_rest.any():
            return None
        w = self.omega_radps
        return np.array([found.takeoff_s[n] * w, found.launch_mps[n] * w / self.g_mps2])

    def _cycle(self, gamma: float, state: np.ndarray, n: int, jacobian: np.ndarray) -> LockedCycle | None:
        found = self._simulate(gamma, float(state[0]), float(state[1]), n + 1)
        w = self.omega_radps
        tau = (found.landing_s - found.takeoff_s)[:n] * w
        speeds = np.array([found.impact_mps[:n], found.launch_mps[:n]]) * w / self.g_mps2
        periods = round((found.takeoff_s[n] - found.takeoff_s[0]) * self.frequency_hz)
        return locked_cycle(
            np.array([tau, found.takeoff_s[:n] * w, *speeds]), periods, np.linalg.eigvals(jacobian).tolist()
        )


def _difference(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    moved = one - other
    moved[0] -= TWO_PI * round(moved[0] / TWO_PI)
    return np.asarray(moved)


def _closes(phase: np.ndarray, reset: np.ndarray) -> tuple[int, int]:
    """First and last flight of the first stretch that ends where it began from rest; (-1, all) when there is none."""
    seen: list[int] = []
    for k in np.flatnonzero(reset):
        for other in seen:
            if abs(math.remainder(phase[k] - phase[other], TWO_PI)) < REPEATS:
                return other, int(k)
        seen.append(int(k))
    return -1, phase.size


EXACT = frozenset({"coulomb_friction", "restitution"})


def make_ball(
    forcing: Forcing,
    effects: Mapping[str, Mapping[str, float]],
    *,
    frequency_hz: float | None = None,
    g_mps2: float = STANDARD_GRAVITY_MPS2,
) -> Ball:
    """The ball on ``forcing`` with ``effects`` by name and parameter (`model.effects`).

    Raises `InputError` for an unknown effect or parameter or a value out of bounds, for an effect of the drive or of an
    instrument (the motion of the plate is given here), and where the frequency is needed and missing.

    The frequency of the first tone is needed where an effect has a scale of its own (a rate, a length, a speed).
    """
    values = resolve(effects)
    active = {}
    for name, table in values.items():
        entry = effect(name)
        if not entry.hooks.keys() & set(COMPILED_HOOKS):
            raise InputError(
                f"{name} acts on the drive or an instrument, not on the ball: a prediction at a given gamma has none"
            )
        if table != entry.effect.null_values:
            active[name] = table
    if not active:
        return IdealBall(forcing)
    scaled = sorted(set(active) - EXACT)
    if scaled and frequency_hz is None:
        raise InputError(f"{', '.join(scaled)} needs --frequency-hz, because it has a scale of its own")
    if active.keys() <= EXACT:
        return FrictionBall(forcing, *law_of(active, frequency_hz, g_mps2))
    if frequency_hz is None:
        raise InputError("effects in SI units need --frequency-hz")
    return IntegratedBall(forcing, active, frequency_hz, g_mps2)


def law_of(
    effects: Mapping[str, Mapping[str, float]], frequency_hz: float | None, g_mps2: float
) -> FrictionRestitution:
    """Friction and restitution of resolved effects, dimensionless (speeds in units of g/w).

    Raises `InputError` if restitution depends on speed and the frequency is missing, or friction holds the ball for
    ever.
    """
    friction = effects.get("coulomb_friction", {})
    bounce = effects.get("restitution", {})
    e1_s_per_m = bounce.get("e1_s_per_m", 0.0)
    if e1_s_per_m != 0.0 and frequency_hz is None:
        raise InputError("restitution.e1_s_per_m needs --frequency-hz, because it has a scale of its own")
    if not friction.get("mu_down", 0.0) < 1.0:
        raise InputError("coulomb_friction.mu_down must be less than 1: else the ball stays on the rod for ever")
    speed_mps = g_mps2 / (2.0 * math.pi * frequency_hz) if frequency_hz is not None else 0.0
    return FrictionRestitution(
        friction.get("mu_up", 0.0), friction.get("mu_down", 0.0), bounce.get("e0", 0.0), e1_s_per_m * speed_mps
    )
