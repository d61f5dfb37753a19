"""Joint tone fit with separate contact and flight amplitudes: the ball's weight on the table changes the tones.

Contact has an extra amplitude of each forcing tone and an extra offset; the harmonics are common to both. The fit is
solved on request.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from daq.lock_in import LockIn, ToneFit

Floats = npt.NDArray[np.float64]

MIN_BLOCKS = 60  # block means needed in contact and in flight
MAX_CONDITION = 1e6  # condition number of the scaled normal matrix above which the two cannot be separated


@dataclass(frozen=True)
class ContactAndFlight:
    """Forcing tones and offset of each, m/s^2, and how the first tone's amplitude differs.

    Attributes
    ----------
    contact, flight : ToneFit
    log_gain, log_gain_uncertainty : float
        Logarithm of the first tone's amplitude in flight over that in contact; their errors are correlated.
    """

    contact: ToneFit
    flight: ToneFit
    log_gain: float
    log_gain_uncertainty: float


@dataclass(frozen=True)
class ContactFlightFit:
    """Normal equations of contact and of the whole step, and their scale to m/s^2.

    Attributes
    ----------
    contact, total : LockIn
        In volts.
    rows : tuple of int
        Rows of the forcing's tones among the fitted ones.
    rms_v : float
        Residual of the step's fit.
    factor, zero_v : float
        Acceleration is ``factor * (volts - zero_v)``.
    """

    contact: LockIn
    total: LockIn
    rows: tuple[int, ...]
    rms_v: float
    factor: float
    zero_v: float

    def solve(self) -> ContactAndFlight | None:
        """The joint fit; None where contact or flight has too few blocks, or they cannot be separated."""
        contact, total = self.contact, self.total
        if min(contact.n, total.n - contact.n) < MIN_BLOCKS:
            return None
        columns = [0, *(c for r in self.rows for c in (2 * r + 1, 2 * r + 2))]
        beside = contact.gram[:, columns]
        gram = np.block([[total.gram, beside], [beside.T, contact.gram[np.ix_(columns, columns)]]])
        scale = 1.0 / np.sqrt(np.diag(gram))
        unit_gram = gram * np.outer(scale, scale)
        if np.linalg.cond(unit_gram) > MAX_CONDITION:
            return None
        inverse = np.linalg.inv(unit_gram) * np.outer(scale, scale)
        solution = inverse @ np.concatenate([total.rhs[:, 0], contact.rhs[columns, 0]])
        q = len(columns)
        pick = np.zeros((2 * q, len(gram)))  # contact has the common tones and the extra ones, flight the common ones
        pick[np.arange(2 * q), columns * 2] = 1.0
        pick[np.arange(q), len(total.gram) + np.arange(q)] = 1.0
        unknowns, covariance = pick @ solution, pick @ inverse @ pick.T * self.rms_v**2
        in_contact, in_flight = (
            scaled(self._part(unknowns[own], covariance[own, own], n), self.factor, self.zero_v)
            for own, n in ((slice(0, q), contact.n), (slice(q, 2 * q), total.n - contact.n))
        )
        first = unknowns.reshape(2, q)[:, 1:3]
        slope = np.zeros((2, q))
        slope[:, 1:3] = first / np.sum(first**2, axis=1, keepdims=True) * [[-1.0], [1.0]]
        variance = float(slope.ravel() @ covariance @ slope.ravel())
        ratio = abs(in_flight.amplitudes[0]) / abs(in_contact.amplitudes[0])
        return ContactAndFlight(in_contact, in_flight, float(np.log(ratio)), float(np.sqrt(variance)))

    def _part(self, unknowns: Floats, covariance: Floats, n: int) -> ToneFit:
        """Offset and forcing tones ``unknowns`` (q,) of one part, in volts."""
        return ToneFit(
            self.total.frequencies_hz[list(self.rows)],
            unknowns[1::2] + 1j * unknowns[2::2],
            covariance[1:, 1:],
            self.rms_v,
            float(unknowns[0]),
            float(np.sqrt(covariance[0, 0])),
            n,
        )


def scaled(fit: ToneFit, factor: float, offset: float) -> ToneFit:
    """The fit times ``factor`` (volts to m/s^2), its offset first shifted by ``-offset`` volts."""
    return ToneFit(
        fit.frequencies_hz,
        fit.amplitudes * factor,
        fit.covariance * factor**2,
        fit.rms * abs(factor),
        (fit.offset - offset) * factor,
        fit.offset_uncertainty * abs(factor),
        fit.n,
    )
