"""A plate mode as it moved in recordings, under what the ball did to the plate: states at events, and parts of tones.

No chain of predictions leads to it, so an error of one flight stays there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.special import chdtrc

from analysis.residuals.observations import Observations
from analysis.residuals.plate_data.plate_mode import INEXACT_AS_MEASURED, Ringing
from analysis.thresholds import SCALE_KNOWN
from kernels.arrays import Bools, Complexes, Floats


@dataclass(frozen=True)
class MeasuredMode:
    """Where the mode was, and what it adds to the measured tones; see `model.integrator.one_step`."""

    # displacement and velocity at each opening and just after each landing, (n, 4); with a second mode at each opening,
    # its angular frequency and damping ratio, (n, 8)
    state: Floats
    mode_amplitudes: Complexes  # as in `model.integrator.one_step.Predicted`
    projection: Complexes  # the same
    observed_s: Floats  # the same
    turning: Complexes  # phase of the mode at the times of ``state``, (n, 2)
    omega_radps: float
    error_mps: float  # standard deviation of the speed, and of the displacement times the angular frequency
    forgets: float  # rate at which that error is forgotten, 1/s
    undriven: Bools  # tones that are all the mode's, (m, k)

    def kicked(self, kick: tuple[float, float]) -> Floats:
        """``state`` with a displacement (m) and a speed (m/s) added that ring on in it all the time."""
        q, qd = kick
        z = (qd + 1j * self.omega_radps * q) * self.turning
        state = self.state.copy()
        state[:, :4] += np.stack([z.imag / self.omega_radps, z.real], axis=2).reshape(len(state), 4)
        return state

    def read(self, reading: Complexes | Floats) -> Self:
        """The same, what it adds to the tones as they are, (m, k), where it was seen through a ``reading`` of them."""
        return replace(self, mode_amplitudes=self.mode_amplitudes / reading[:, : self.mode_amplitudes.shape[1]])

    @classmethod
    def of(
        cls,
        observations: Observations,
        ringing: Ringing,
        mode: tuple[float, float, float],
        undriven: Bools | None = None,
    ) -> Self:
        """Of a ``mode`` of angular frequency, damping and mass ratio, in recordings that show what the ball did.

        Where tones are known to be ``undriven`` (m, k), all of them is the mode's.
        """
        omega_radps, damping, mass_ratio = mode
        motions = [x.moved(omega_radps / (2.0 * np.pi), damping, mass_ratio) for x in observations.ringing.pushed]
        of, seen = observations.steps.recording[observations.measured.step], observations.measured
        state = np.zeros((len(observations), 8 if any(motion.others for motion in motions) else 4))
        for i, motion in enumerate(motions):
            own, first = of == i, replace(motion, others=())
            opened, landed = seen.opening_s[own], seen.landing_s[own]
            state[own, :4] = np.hstack([first.state(opened), first.state(landed, landings=True)])
            for other in motion.others:  # it rings on in its own time: the first mode's would carry it elsewhere
                radps = abs(other.turn)
                state[own, 4:6], state[own, 6:] = other.state(opened), (radps, -other.turn.real / radps)
        # after the last landing nothing shows how fast the ball flew on
        until_s = np.array([x.until_s for x in observations.ringing.pushed])[of_step := observations.steps.recording]
        followed = ringing.span_s[:, 1] <= until_s[ringing.intervals.step]
        projection = np.where(followed[:, None], ringing.of_motions(motions, of_step), 0.0)
        seconds = np.where(followed, ringing.intervals.seconds, 0.0)
        turning = np.exp(1j * motions[0].turn.imag * np.stack([seen.opening_s, seen.landing_s], axis=1))
        error = max(x.error(omega_radps / (2.0 * np.pi), damping, mass_ratio) for x in observations.ringing.pushed)
        amplitudes = ringing.of_tones(projection, seconds)
        if undriven is None:
            undriven = np.zeros(amplitudes.shape, np.bool_)
        amplitudes = np.where(undriven, observations.steps.plate.acceleration_mps2, amplitudes)
        return cls(state, amplitudes, projection, seconds, turning, omega_radps, *error, undriven)


def undriven_tones(observations: Observations, ringing: Ringing) -> Bools:
    """Tones but the forcing's of which the mode, as identified, leaves no more than noise in all steps, (m, k)."""
    found, steps, plate = observations.ringing.mode, observations.steps, observations.steps.plate
    there = (plate.acceleration_mps2 != 0.0) & ~steps.forcing
    if found is None:
        return np.zeros(there.shape, np.bool_)
    first = 2.0 * np.pi * found.frequency_hz, found.damping, found.mass_ratio
    amplitudes = MeasuredMode.of(observations, ringing, first).mode_amplitudes
    error = (1.0 + SCALE_KNOWN) * np.hypot(steps.sigma_mps2, INEXACT_AS_MEASURED * np.abs(amplitudes))
    squares = np.abs(plate.acceleration_mps2 - amplitudes) ** 2 / np.where(there, error, 1.0) ** 2
    turns = np.round(plate.omega_radps * plate.period_s[:, None] / (2.0 * np.pi), 2)
    out = np.zeros(there.shape, np.bool_)
    for turn in np.unique(turns[there]):
        rows = there & (turns == turn)
        # where noise leaves so much once in a hundred, the drive may well have made it
        out |= rows & (chdtrc(2 * int(rows.sum()), float(squares[rows].sum())) > 0.01)
    return out
