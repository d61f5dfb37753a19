"""Joint tone fit with separate contact and flight amplitudes: the ball's weight on the table changes the tones.

Contact has an extra amplitude of each forcing tone and an extra offset; the harmonics are common to both. The fit is
solved on request.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from daq.lock_in import LockIn, ToneFit

MIN_BLOCKS = 60  # block means needed in contact and in flight
MAX_CONDITION = 1e6  # condition number of the scaled normal matrix above which the two cannot be separated


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

    def solve(self) -> tuple[ToneFit | None, ToneFit | None]:
        """Forcing tones and offset in contact and in flight, m/s^2; None where either has too few blocks."""
        parts = _joint_fit(self.contact, self.total, self.rms_v, list(self.rows))
        contact, flight = (None if part is None else scaled(part, self.factor, self.zero_v) for part in parts)
        return contact, flight


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


def _joint_fit(contact: LockIn, total: LockIn, rms: float, rows: list[int]) -> tuple[ToneFit | None, ToneFit | None]:
    """Tones ``rows`` and the offset in contact and in flight, in volts, the harmonics common to both."""
    if min(contact.n, total.n - contact.n) < MIN_BLOCKS:
        return None, None
    columns = [0, *(c for r in rows for c in (2 * r + 1, 2 * r + 2))]
    beside = contact.gram[:, columns]
    gram = np.block([[total.gram, beside], [beside.T, contact.gram[np.ix_(columns, columns)]]])
    scale = 1.0 / np.sqrt(np.diag(gram))
    scaled = gram * np.outer(scale, scale)
    if np.linalg.cond(scaled) > MAX_CONDITION:
        return None, None
    inverse = np.asarray(np.linalg.inv(scaled) * np.outer(scale, scale), dtype=np.float64)
    solution = inverse @ np.concatenate([total.rhs[:, 0], contact.rhs[columns, 0]])
    p = total.gram.shape[0]
    pick = np.zeros((2, len(columns), gram.shape[0]))
    for k, c in enumerate(columns):
        pick[:, k, c] = 1.0
        pick[0, k, p + k] = 1.0
    fits = []
    for part, n in zip(pick, (contact.n, total.n - contact.n), strict=True):
        own, covariance = part @ solution, part @ inverse @ part.T * rms**2
        fits.append(
            ToneFit(
                total.frequencies_hz[rows],
                own[1::2] + 1j * own[2::2],
                covariance[1:, 1:],
                rms,
                float(own[0]),
                float(np.sqrt(covariance[0, 0])),
                n,
            )
        )
    return fits[0], fits[1]
