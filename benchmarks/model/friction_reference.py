"""Independent solvers of the rough, bouncing ball: event by event to 60 digits, and brute force at 50 ns in SI."""

import math

import mpmath as mp

from benchmarks.model.reference import Exact, bisect_newton
from kernels import njit


class ExactRough(Exact):
    """Friction added to the 60-digit solver: every stage split where its pull changes sign."""

    def __init__(self, forcing, gamma, mu_up, mu_down):
        super().__init__(forcing, gamma)
        self.up_level = 1 + mp.mpf(mu_up)
        self.down_level = 1 - mp.mpf(mu_down)

    def _pull(self, phi, level):
        return -self.gamma * self.derivative(2, phi) - level

    def _standstill(self, stage, rising):
        """First phase after the stage's start where h' reaches zero from the given side; None before 300."""
        phi0, level = stage[0], stage[3]
        edges = [phi0]
        for turn in range(1, 60):
            stop = phi0 + 5 * turn
            for b in [*self.crossings(level, edges[-1], stop), stop]:
                a = edges[-1]
                edges.append(b)
                v = self.motion(stage, b)[1]
                if (v > 0) == rising and v != 0:
                    return bisect_newton(lambda x: self.motion(stage, x)[1], lambda x: self.motion(stage, x)[2], a, b)
        return None

    def flight(self, phi0, v0):
        """``(landing phase, impact speed, hung)`` of the flight from ``phi0`` with relative speed ``v0``."""
        phi, h, v, hung = phi0, mp.mpf(0), mp.mpf(v0), mp.mpf(0)
        rising = True
        while True:
            stage = (phi, h, v, self.up_level if rising else self.down_level)
            stop = self._standstill(stage, rising=not rising)
            if not rising:
                reach = None if stop is None else stop - phi
                landing = self.landing(phi, 0, h, self.down_level, reach)
                if landing is not None:
                    return landing, -self.motion(stage, landing)[1], hung
            h, v = self.motion(stage, stop)[0], mp.mpf(0)
            phi, rising = self._hang(stop)
            hung += phi - stop

    def _hang(self, phi):
        """When and which way a standing ball moves on."""
        if self._pull(phi, self.up_level) > 0:
            return phi, True
        if self._pull(phi, self.down_level) < 0:
            return phi, False
        ends = [(x, True) for x in self.crossings(self.up_level, phi, phi + 7)]
        ends += [(x, False) for x in self.crossings(self.down_level, phi, phi + 7)]
        return min(ends)


@njit()
def march(tones, gamma, omega, g, mu_up, mu_down, e0, e1, phi0, v0_mps, step_s, stop_s, times, speeds):
    """Brute force in SI at a fixed step: the ball leaves the plate at phase ``phi0`` with ``v0_mps`` relative to it.

    Fills the times and relative speeds of impacts; returns their number, the time spent hanging in the air, the time
    from which the ball lay still (NaN if it did not) and the energy per mass lost on the rod by friction.
    """
    position, velocity, t = 0.0, v0_mps, 0.0
    n = 0
    hung = 0.0
    lost = 0.0
    while t < stop_s:
        phi = phi0 + omega * (t + 0.5 * step_s)
        plate = 0.0
        for j in range(tones.shape[0]):
            plate -= gamma * g * tones[j, 1] * tones[j, 0] ** 2 * math.sin(tones[j, 0] * phi + tones[j, 2])
        pull = -(g + plate)
        if position <= 0.0 and velocity == 0.0 and pull <= mu_up * g:
            return n, hung, t, lost
        if velocity > 0.0 or (velocity == 0.0 and pull > mu_up * g):
            a, may_stop = pull - mu_up * g, True
        elif velocity < 0.0 or pull < -mu_down * g:
            a, may_stop = pull + mu_down * g, True
        else:
            a, may_stop = 0.0, False
            hung += step_s
        new = velocity + a * step_s
        if may_stop and velocity != 0.0 and new * velocity < 0.0:
            new = 0.0
        moved = 0.5 * (velocity + new) * step_s
        lost += (mu_up if moved > 0.0 else mu_down) * g * abs(moved)
        position += moved
        velocity = new
        t += step_s
        if position < 0.0 and velocity < 0.0:
            at = position / velocity  # how long ago
            speed = a * at - velocity
            if n < times.size:
                times[n] = t - at
                speeds[n] = speed
            n += 1
            velocity = speed * min(max(e0 - e1 * speed, 0.0), 1.0)
            position = velocity * at
            if velocity < 1e-6:
                velocity = position = 0.0
    return n, hung, math.nan, lost
