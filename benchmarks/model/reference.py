"""Independent solvers that the compiled kernels are held against: 60 digits with mpmath, and brute force.

Nothing of `model` is used but the forcing's plain numbers. The 60-digit solver isolates the turning
points of the plate's acceleration as roots of a polynomial in ``exp(i phi)``, and bisects from there.
"""

import itertools

import mpmath as mp
import numpy as np

from kernels import njit

DIGITS = 60


class Exact:
    """One forcing at one gamma, to 60 digits; harmonics must be integers."""

    def __init__(self, forcing, gamma):
        """Take the doubles as exact numbers."""
        mp.mp.dps = DIGITS
        self.gamma = mp.mpf(float(gamma))
        self.tones = [(int(n), mp.mpf(b), mp.mpf(p)) for n, b, p in forcing.tones]
        self.turning = self._turning()
        self.known = {}  # crossings in one period, by level

    def derivative(self, order, phi):
        """The ``order``-th derivative of ``s`` at ``phi``."""
        turn = order * mp.pi / 2
        return mp.fsum(b * mp.mpf(n) ** order * mp.sin(n * phi + p + turn) for n, b, p in self.tones)

    def _turning(self):
        """Phases in [0, 2 pi) where the plate's jerk vanishes."""
        top = max(n for n, _, _ in self.tones)
        coefficients = np.zeros(2 * top + 1, dtype=complex)  # of z^top sum n^3 b (e^{ip} z^n + e^{-ip} z^-n) / 2
        for n, b, p in self.tones:
            coefficients[top + n] += n**3 * float(b) * np.exp(1j * float(p))
            coefficients[top - n] += n**3 * float(b) * np.exp(-1j * float(p))
        roots = np.roots(coefficients[::-1])
        angles = np.sort(np.angle(roots[np.abs(np.abs(roots) - 1) < 1e-4]) % (2 * np.pi))
        found = []
        for angle in angles:
            x = mp.findroot(lambda phi: self.derivative(3, phi), mp.mpf(angle), tol=1e-90, verify=False)
            if not found or x - found[-1] > 1e-12:
                found.append(x)
        return found

    def crossings(self, level, start, stop):
        """Ascending phases in ``(start, stop)`` where ``gamma q = level``."""
        if level not in self.known:
            self.known[level] = self._crossings_of_a_period(level)
        first, last = int(mp.floor(start / (2 * mp.pi))) - 1, int(mp.ceil(stop / (2 * mp.pi))) + 1
        shifted = (x + 2 * mp.pi * turn for turn in range(first, last) for x in self.known[level])
        return [x for x in shifted if start < x < stop]

    def _crossings_of_a_period(self, level):
        pieces = [*self.turning, self.turning[0] + 2 * mp.pi]

        def excess(phi):
            return -self.gamma * self.derivative(2, phi) - level

        return [
            bisect_newton(excess, lambda phi: -self.gamma * self.derivative(3, phi), a, b)
            for a, b in itertools.pairwise(pieces)
            if excess(a) * excess(b) < 0
        ]

    def threshold_near(self, phi):
        """The up-crossing of ``gamma q = 1`` nearest to ``phi``."""
        near = [x for x in self.crossings(mp.mpf(1), phi - 7, phi + 7) if self.derivative(3, x) < 0]
        return min(near, key=lambda x: abs(x - phi))

    def motion(self, stage, phi):
        """``h, h', h''`` at ``phi`` for the stage ``(phi0, h0, v0, level)``."""
        phi0, h0, v0, level = stage
        tau = phi - phi0
        slope0 = self.derivative(1, phi0)
        s = self.derivative(0, phi) - self.derivative(0, phi0) - slope0 * tau
        h = h0 + v0 * tau - self.gamma * s - level * tau**2 / 2
        v = v0 - self.gamma * (self.derivative(1, phi) - slope0) - level * tau
        return h, v, -self.gamma * self.derivative(2, phi) - level

    def landing(self, phi0, v0=0, h0=0, level=1, reach=None):
        """The first landing phase of a ball in flight under a steady pull, or None before ``phi0 + reach``."""
        stage = (phi0, mp.mpf(h0), mp.mpf(v0), mp.mpf(level))
        span = mp.mpf(10)
        edges = [phi0]
        while True:
            stop = edges[-1] + span
            points = [*self.crossings(stage[3], edges[-1], stop), stop]
            if reach is not None and stop > phi0 + reach:
                points = [x for x in points if x < phi0 + reach] + [phi0 + reach]
            for b in points:
                root = self._landing_between(stage, edges[-1], b)
                if root is not None:
                    return root
                edges.append(b)
            if reach is not None and edges[-1] >= phi0 + reach:
                return None

    def _landing_between(self, stage, a, b):
        """First root of h in ``(a, b]``, where h'' keeps its sign; h > 0 just after a."""
        h_b, v_b, _ = self.motion(stage, b)
        _, v_a, _ = self.motion(stage, a)
        middle = (a + b) / 2
        convex = self.motion(stage, middle)[2] > 0
        if convex and v_a < 0 < v_b:  # the lowest point decides
            low = bisect_newton(lambda x: self.motion(stage, x)[1], lambda x: self.motion(stage, x)[2], a, b)
            if self.motion(stage, low)[0] > 0:
                return None
            b = low
        elif h_b > 0:
            return None
        if a == stage[0] and stage[1] == 0:  # leave the trivial root at the start
            a = self._lifted(stage, a, b)
            if a is None:
                return None
        return bisect_newton(lambda x: self.motion(stage, x)[0], lambda x: self.motion(stage, x)[1], a, b)

    def _lifted(self, stage, a, b):
        """A phase in ``(a, b)`` with h > 0, or None."""
        step = b - a
        for _ in range(150):
            step /= 2
            if self.motion(stage, a + step)[0] > 0:
                return a + step
        return None


def bisect_newton(f, slope, a, b):
    """The single root of ``f`` in ``[a, b]`` to 50 digits."""
    rising = f(b) > 0
    x = (a + b) / 2
    for _ in range(400):
        value = f(x)
        if (value > 0) == rising:
            b = x
        else:
            a = x
        gradient = slope(x)
        new = x - value / gradient if gradient else a
        if not a < new < b:
            new = (a + b) / 2
        if abs(new - x) < mp.mpf(10) ** -50 * (1 + abs(x)):
            return new
        x = new
    return x


@njit()
def _height(tones, gamma, phi0, v0, tau):
    h = v0 * tau - 0.5 * tau * tau
    for j in range(tones.shape[0]):
        n = tones[j, 0]
        angle = n * phi0 + tones[j, 2]
        h += gamma * tones[j, 1] * (np.sin(angle) + n * tau * np.cos(angle) - np.sin(angle + n * tau))
    return h


@njit()
def stays_above(tones, gamma, phi0, v0, start, stop, noise):
    """Whether ``h > 0`` on all of ``[start, stop]``: 1 proven, 0 one point is below ``-noise``, -1 too near to say.

    Interval bisection with nothing but a bound M on ``|h''|``: ``h >= min(h(a), h(b)) - M (b - a)^2 / 8`` on [a, b].
    """
    bound = 1.0
    for j in range(tones.shape[0]):
        bound += gamma * tones[j, 1] * tones[j, 0] ** 2
    todo = [(start, stop, _height(tones, gamma, phi0, v0, start), _height(tones, gamma, phi0, v0, stop))]
    verdict = 1
    while len(todo) > 0:
        a, b, h_a, h_b = todo.pop()
        if min(h_a, h_b) < -noise:
            return 0
        if min(h_a, h_b) > noise + bound * (b - a) ** 2 / 8.0:
            continue
        if bound * (b - a) ** 2 / 8.0 < noise:
            verdict = -1
            continue
        middle = 0.5 * (a + b)
        h = _height(tones, gamma, phi0, v0, middle)
        todo.append((a, middle, h_a, h))
        todo.append((middle, b, h, h_b))
    return verdict


def lifted_until(forcing, gamma, phi0, v0, at_threshold):
    """A time before which a ball taking off at ``phi0`` is surely in the air: the Taylor bound of its height."""
    n, b, p = forcing.tones.T
    a = 0.0 if at_threshold else max(gamma * float(np.sum(b * n**2 * np.sin(n * phi0 + p))) - 1.0, -1e300)
    jerk = gamma * float(np.sum(b * n**3 * np.cos(n * phi0 + p)))
    snap = gamma * float(np.sum(b * n**4))
    t = np.geomspace(1e-9, 1.0, 400)
    free = v0 + t * (a / 2 + t * (jerk / 6 - t * snap / 24)) > 0
    return 0.0 if not free[0] else float(t[np.argmin(free) - 1] if not free.all() else t[-1])
