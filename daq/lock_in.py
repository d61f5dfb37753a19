"""Complex amplitudes of known tones by joint least squares: one estimator for the control loop and for the analysis.

A complex amplitude ``z`` at ``f`` means ``Re[z exp(i 2 pi f n / rate)]`` with ``n`` counted from sample 0 of the
recording, whatever piece of it is handed in, masked or not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

from daq.lock_in_kernel import accumulate, add_sorts, add_stretches, invert
from kernels.arrays import Bools, Complexes, Floats, Integers


@dataclass(frozen=True)
class ToneFit:
    """Amplitudes of ``k`` tones in one channel, in the channel's unit."""

    frequencies_hz: Floats
    amplitudes: Complexes  # ``Re[z exp(i 2 pi f t)]``, t = 0 at sample 0 of the recording
    covariance: Floats  # of ``(Re z_0, Im z_0, Re z_1, Im z_1, ...)``, from the residual rms taken as white.
    rms: float  # root mean square of the residual, degrees of freedom counted
    offset: float  # the constant fitted with the tones
    offset_uncertainty: float  # its standard deviation
    n: int  # values used

    @property
    def shows(self) -> bool:
        """Whether a tone is larger than four of its uncertainties: less may be noise."""
        return bool(np.abs(self.amplitudes).max() > 4.0 * self.amplitude_sigma().max())

    def amplitude_sigma(self) -> Floats:
        """Standard deviation of each tone's amplitude, the rms over its two quadratures, shape (k,)."""
        variances = self.covariance.diagonal()
        return np.sqrt(0.5 * (variances[0::2] + variances[1::2]))

    def polar_sigma(self, k: int) -> Floats:
        """Standard deviations of the relative amplitude and of the phase in rad of tone ``k``, shape (2,).

        They differ where a mask leaves out the same phases of every cycle.
        """
        z, own = self.amplitudes[k], slice(2 * k, 2 * k + 2)
        along = np.array([[z.real, z.imag], [-z.imag, z.real]]) / abs(z) ** 2
        return np.asarray(np.sqrt(np.diagonal(along @ self.covariance[own, own] @ along.T)))


@dataclass(frozen=True)
class ToneFits:
    """Fits of ``k`` tones to each of ``m`` stretches, in the values' unit."""

    frequencies_hz: Floats
    amplitudes: Complexes
    offsets: Floats
    rms: Floats  # as in `ToneFit`
    n: Integers

    @classmethod
    def join(cls, parts: Sequence[Self]) -> Self:
        """Stretches of all parts, which share the tones, one after the other."""
        each = zip(*((x.amplitudes, x.offsets, x.rms, x.n) for x in parts), strict=True)
        return cls(parts[0].frequencies_hz, *(np.concatenate(own) for own in each))


class _Sums(NamedTuple):
    """Normal matrices, right sides, sums of squares and numbers of values, each by sort; see `LockIn`."""

    grams: Floats
    sides: Floats
    squares: Floats
    counts: Integers


class LockIn:
    """Normal equations of a joint tone fit, accumulated in one pass over any number of pieces.

    Parameters
    ----------
    rate_hz : float
        Sampling rate of what is handed to `add`.
    frequencies_hz : array, shape (k,)
        Positive, pairwise different.
    channels : int
        Number of channels, which share the tones and the mask.
    boxcar : int
        When the values are means over ``boxcar`` recorded samples each (then ``rate_hz`` is the rate of the means and
        a value's index is that of its mean): the boxcar's gain and delay are taken out exactly.
    sorts : int
        Number of sorts of values with sums of their own (`part` gives the fit of some of them).
    """

    def __init__(
        self, rate_hz: float, frequencies_hz: npt.ArrayLike, channels: int = 1, boxcar: int = 1, sorts: int = 1
    ) -> None:
        self.rate_hz = float(rate_hz)
        self.boxcar = boxcar
        self.frequencies_hz = np.atleast_1d(np.asarray(frequencies_hz, dtype=np.float64))
        if self.frequencies_hz.size and not np.all(np.isfinite(self.frequencies_hz) & (self.frequencies_hz > 0)):
            raise ValueError(f"tone frequencies must be positive and finite, got {self.frequencies_hz}")
        p = 2 * self.frequencies_hz.size + 1
        self._sums = _Sums(
            np.zeros((sorts, p, p)), np.zeros((sorts, p, channels)), np.zeros((sorts, channels)),
            np.zeros(sorts, dtype=np.int64),
        )  # fmt: skip
        self._response = boxcar_response(self.frequencies_hz, self.rate_hz, boxcar)
        self.forget()

    def forget(self) -> None:
        """Drop the solutions, not the sums."""
        self._inverse: Floats | None = None
        self._fits: dict[int, ToneFit] = {}
        self._parts: dict[tuple[int, ...], LockIn] = {}

    def _of_sums(self, sums: _Sums) -> LockIn:
        """A fit of the same tones from other sums."""
        own = object.__new__(LockIn)  # the tones are known to be sound
        own.rate_hz, own.boxcar = self.rate_hz, self.boxcar
        own.frequencies_hz, own._response = self.frequencies_hz, self._response
        own._sums = sums
        own.forget()
        return own

    @property
    def gram(self) -> Floats:
        """Normal matrix over all sorts, shape (2k + 1, 2k + 1): constant, then cosine and sine of each tone."""
        grams = self._sums.grams
        return np.asarray(grams[0] if len(grams) == 1 else grams.sum(axis=0))

    @property
    def rhs(self) -> Floats:
        """Right sides over all sorts, shape (2k + 1, channels)."""
        sides = self._sums.sides
        return np.asarray(sides[0] if len(sides) == 1 else sides.sum(axis=0))

    @property
    def n(self) -> int:
        """Values used, of all sorts."""
        return int(self._sums.counts.sum())

    @property
    def counts(self) -> Integers:
        """Values used, of each sort."""
        return self._sums.counts

    def response(self) -> Complexes:
        """Response of the boxcar at each tone, gain and delay, shape (k,)."""
        return self._response

    def add(self, x: npt.ArrayLike, first: int, mask: npt.ArrayLike | None = None) -> None:
        """Accumulate values ``first, first + 1, ...``.

        Parameters
        ----------
        x : array, shape (n,) or (n, channels)
        first : int
            Index of the first value, counted from sample 0 of the recording.
        mask : bool array, shape (n,), optional
            True where a value counts; or the sort of each value as int8, negative where it does not count.
        """
        values = np.asarray(x, dtype=np.float64)
        values = values.reshape(values.shape[0], -1)
        if values.shape[1] != self._sums.sides.shape[2]:
            raise ValueError(f"expected {self._sums.sides.shape[2]} channels, got {values.shape[1]}")
        sort = np.zeros(values.shape[0], dtype=np.int8)
        if mask is not None:
            given = np.asarray(mask)  # a mask is the sorts -1 and 0
            sort = given.astype(np.int8) - 1 if given.dtype == np.bool_ else given.astype(np.int8, copy=False)
        if sort.shape[0] != values.shape[0]:
            raise ValueError(f"mask has {sort.shape[0]} entries for {values.shape[0]} values")
        cycles = self.frequencies_hz / self.rate_hz
        self.forget()
        accumulate(np.ascontiguousarray(values), sort, int(first), cycles, self._response, self._sums)

    def add_stretches(self, x: npt.ArrayLike, edges: Integers) -> None:
        """Accumulate values ``edges[0] .. edges[-1] - 1`` of the only channel, those between two edges as a sort."""
        values = np.ascontiguousarray(x, dtype=np.float64)
        if values.shape != (int(edges[-1] - edges[0]),):
            raise ValueError(f"expected {edges[-1] - edges[0]} values of one channel, got shape {values.shape}")
        cycles = self.frequencies_hz / self.rate_hz
        self.forget()
        add_stretches(values, np.ascontiguousarray(edges, dtype=np.int64), cycles, self._response, self._sums)

    def part(self, sorts: npt.ArrayLike) -> LockIn:
        """The fit of only some sorts: one object for each choice until values are added, not to be added to."""
        chosen = np.asarray(sorts, dtype=np.int64)
        key = tuple(chosen.tolist())
        if key not in self._parts:
            total = _Sums(*(np.zeros((1, *each.shape[1:]), each.dtype) for each in self._sums))
            add_sorts(chosen, self._sums, total)
            self._parts[key] = self._of_sums(total)
        return self._parts[key]

    def only(self, tones: Bools) -> LockIn:
        """The fit of only the chosen ``tones`` (k,), of all sorts, from the sums there are; not to be added to."""
        rows = np.append(0, (2 * np.flatnonzero(tones)[:, None] + [1, 2]).ravel())
        gram, side = self.gram[None, rows[:, None], rows], self.rhs[None, rows]
        part = self._of_sums(_Sums(gram, side, *(each.sum(axis=0)[None] for each in self._sums[2:])))
        part.frequencies_hz, part._response = self.frequencies_hz[tones], self._response[tones]
        return part

    def __add__(self, other: LockIn) -> LockIn:
        """The fit of both pieces together (same tones, same channels, sorts merged)."""
        pairs = zip(self._sums, other._sums, strict=True)
        return self._of_sums(_Sums._make(a.sum(axis=0)[None] + b.sum(axis=0)[None] for a, b in pairs))

    def __sub__(self, other: LockIn) -> LockIn:
        """The fit without the values of ``other``, which are some of these (same tones, same channels, one sort)."""
        return self._of_sums(_Sums._make(a - b for a, b in zip(self._sums, other._sums, strict=True)))

    def inverse(self) -> Floats:
        """Inverse of the normal matrix; raises ``ValueError`` when the values cannot distinguish the tones."""
        if self._inverse is None:
            self._inverse = _inverses(self.gram[None], np.array([self.n]), self.frequencies_hz)[0]
        return self._inverse

    def solve(self, channel: int = 0) -> ToneFit:
        """Fit of one channel; raises ``ValueError`` when the values cannot distinguish the tones."""
        if channel not in self._fits:
            square = float(np.add.reduce(self._sums.squares[:, channel]))
            self._fits[channel] = solved(self.frequencies_hz, self.inverse(), self.rhs[:, channel], square, self.n)
        return self._fits[channel]

    def solve_each(self) -> ToneFits:
        """A fit of each sort of the first channel; raises ``ValueError`` when one cannot distinguish the tones."""
        grams, sides, squares, counts = self._sums
        inverses, sides = _inverses(grams, counts, self.frequencies_hz), sides[:, :, 0]
        solutions = (inverses @ sides[:, :, None])[:, :, 0]
        left = np.maximum(squares[:, 0] - (solutions[:, None, :] @ sides[:, :, None])[:, 0, 0], 0.0)
        rms = np.sqrt(left / (counts - sides.shape[1]))
        return ToneFits(self.frequencies_hz, solutions[:, 1::2] + 1j * solutions[:, 2::2], solutions[:, 0], rms, counts)


def boxcar_response(frequencies_hz: Floats, rate_hz: float, boxcar: int) -> Complexes:
    """Response of the mean over ``boxcar`` samples, ``rate_hz`` means a second, at each tone, shape (k,)."""
    theta = np.pi * frequencies_hz / (rate_hz * boxcar)  # half a recorded sample's phase
    # Dirichlet's kernel: the sum of a geometric series of phasors
    gain = np.sin(boxcar * theta) / (boxcar * np.sin(theta))
    return np.asarray(gain * np.exp(1j * theta * (boxcar - 1)))


def inverse_of(gram: Floats, n: int, frequencies_hz: Floats) -> Floats:
    """Inverse of the normal matrix (p, p) of ``n`` values; raises ``ValueError`` where it has none."""
    return np.asarray(_inverses(gram[None], np.array([n]), frequencies_hz)[0])


def solved(frequencies_hz: Floats, inverse: Floats, side: Floats, square: float, n: int) -> ToneFit:
    """The fit of ``k`` tones to ``n`` values, by the inverse of the normal matrix (2k + 1, 2k + 1), the right side
    (2k + 1,), and the sum of the values' squares.
    """
    solution = inverse @ side
    variance = max(square - float(solution @ side), 0.0) / (n - side.size)
    # column pairs are (cos, -sin), so the unknowns are Re z and Im z
    return ToneFit(
        frequencies_hz=frequencies_hz,
        amplitudes=solution[1::2] + 1j * solution[2::2],
        covariance=inverse[1:, 1:] * variance,
        rms=math.sqrt(variance),
        offset=float(solution[0]),
        offset_uncertainty=math.sqrt(inverse[0, 0] * variance),
        n=n,
    )


def _inverses(grams: Floats, counts: Integers, frequencies_hz: Floats) -> Floats:
    """Inverses of normal matrices (m, p, p) of ``counts`` (m,) values; raises ``ValueError`` where one has none."""
    p = grams.shape[1]
    if counts.min(initial=p + 1) <= p:
        raise ValueError(f"{counts.min()} values cannot fix {p} unknowns")
    inverses = np.empty(grams.shape)
    unfit = int(invert(np.ascontiguousarray(grams), inverses))
    if unfit >= 0:
        raise ValueError(f"the tones {frequencies_hz} Hz cannot be separated by {counts[unfit]} values")
    return inverses


def fit_tones(
    x: npt.ArrayLike, first_sample: int, rate_hz: float, frequencies_hz: npt.ArrayLike, mask: Bools | None = None
) -> ToneFit:
    """Joint least squares for the complex amplitudes of known tones and a constant.

    Raises `ValueError` for too few samples, or tones too close to be distinguished. Phases refer to sample 0 of the
    recording.

    Parameters
    ----------
    x : array, shape (n,)
        Samples ``first_sample, first_sample + 1, ...`` of the recording.
    first_sample : int
    rate_hz : float
    frequencies_hz : array, shape (k,)
    mask : bool array, shape (n,), optional
        True where a sample counts.
    """
    lock_in = LockIn(rate_hz, frequencies_hz)
    if mask is None:
        values = np.ravel(np.asarray(x, dtype=np.float64))
        lock_in.add_stretches(values, np.array([first_sample, first_sample + len(values)], dtype=np.int64))
    else:
        lock_in.add(x, first_sample, mask)
    return lock_in.solve()


def fit_tones_each(x: npt.ArrayLike, edges: Integers, rate_hz: float, frequencies_hz: npt.ArrayLike) -> ToneFits:
    """`fit_tones` of each of successive stretches of the recording.

    Raises `ValueError` for too few samples in a stretch, or tones too close to be distinguished.

    Parameters
    ----------
    x : array, shape (n,)
        Samples ``edges[0], ..., edges[-1] - 1`` of the recording.
    edges : int array, shape (m + 1,)
        First sample of each stretch, and the end of the last.
    rate_hz : float
    frequencies_hz : array, shape (k,)
    """
    lock_in = LockIn(rate_hz, frequencies_hz, sorts=len(edges) - 1)
    lock_in.add_stretches(x, edges)
    return lock_in.solve_each()
