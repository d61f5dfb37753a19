"""Joint tone fit with separate contact and flight amplitudes: the ball's weight on the table changes the tones.

Contact has an extra amplitude of each forcing tone and an extra offset; the harmonics are common to both. The fit is
solved on request.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.linear_algebra import inv
from daq.lock_in import LockIn, ToneFit


@dataclass(frozen=True)
class ContactFlightFit:
    """Normal equations of contact and of the whole step."""

    contact: LockIn  # volts
    total: LockIn  # volts
    rows: tuple[int, ...]  # rows of the forcing's tones among the fitted ones
    rms_v: float  # residual of the step's fit

    def log_gain(self) -> tuple[float, float] | None:
        """Logarithm of the first tone's amplitude in flight over that in contact, and its standard deviation.

        None where contact or flight has too few blocks, or they cannot be separated.
        """
        contact, total = self.contact, self.total
        # fewer blocks do not fix the tones of contact and of flight separately
        if min(contact.n, total.n - contact.n) < 60:
            return None
        extra = [0, *(c for r in self.rows for c in (2 * r + 1, 2 * r + 2))]
        coupling = contact.gram[:, extra]
        gram = np.block([[total.gram, coupling], [coupling.T, contact.gram[np.ix_(extra, extra)]]])
        scale = 1.0 / np.sqrt(np.diag(gram))
        unit_gram = gram * np.outer(scale, scale)
        # where contact and flight alternate with the forcing itself their tones cannot be separated
        if np.linalg.cond(unit_gram) > 1e6:
            return None
        inverse = inv(unit_gram) * np.outer(scale, scale)
        solution = inverse @ np.concatenate([total.rhs[:, 0], contact.rhs[extra, 0]])
        common = slice(2 * self.rows[0] + 1, 2 * self.rows[0] + 3)
        only_contact = slice(len(total.gram) + 1, len(total.gram) + 3)
        in_flight, in_contact = solution[common], solution[common] + solution[only_contact]
        slope = np.zeros(len(solution))  # d log|a| = a . da / |a|^2
        slope[only_contact] = -in_contact / (in_contact @ in_contact)
        slope[common] = slope[only_contact] + in_flight / (in_flight @ in_flight)
        log_gain = 0.5 * np.log((in_flight @ in_flight) / (in_contact @ in_contact))
        return float(log_gain), self.rms_v * float(np.sqrt(slope @ inverse @ slope))


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
