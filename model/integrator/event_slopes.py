"""Derivatives of a prediction one event ahead, without another flight: exact, by the variational equations.

Partial derivatives of an effect's hooks are differences of the hook itself at the states of the flight, so that a hook
is written without its derivatives. Whole predictions, differenced, are the test of it.
"""

from __future__ import annotations

from dataclasses import dataclass

from kernels.arrays import Floats
from model.integrator.one_step import Detection, Measured, PlateSteps, Predicted
from model.integrator.problem import Problem, active, for_kernel
from model.integrator.takeoff_slopes import LANDING, LANDING_BEFORE
from model.integrator.variation import TONES


@dataclass(frozen=True)
class Slopes:
    """Derivatives of a prediction, arrays of n events; zeros where they cannot be used.

    Parameters
    ----------
    landing, landing_before
        Of opening, landing and impact speed by the landing before and the one before that, (n, 3) each.
    tones
        By the real and imaginary part of each tone of the event's step, (n, 3, k, 2).
    info
        What the second order is about, (n, `model.integrator.takeoff_slopes.INFO`).
    """

    landing: Floats
    landing_before: Floats
    tones: Floats
    info: Floats


def slopes_of(
    measured: Measured,
    plate: PlateSteps,
    rows: Floats,
    detection: Detection,
    found: Predicted,
) -> Slopes:
    """Derivatives of a prediction without another flight: of all it depends on.

    Parameters
    ----------
    measured, plate, rows, detection
        Those of the prediction.
    found
        The prediction, see `one_ahead`.

    Raises
    ------
    ValueError
        Where the plate has a mode, or the prediction is not of `one_ahead`.
    """
    rows = for_kernel(rows.reshape(-1, rows.shape[-1]))
    problem, tones = Problem(measured, plate, rows, detection, (0.0, 0.0)), plate.acceleration_mps2
    if active(rows, "plate_mode"):
        raise ValueError("a plate with a mode has no derivatives; wanted one without")
    if found.table is None:
        raise ValueError("the prediction was not made by one_ahead; wanted one with the kernel's table")
    out, info = problem.slopes(tones, measured.wanted, found.table)
    out[info[:, 0] == 0.0] = 0.0
    k, first = tones.shape[1], TONES
    return Slopes(
        out[..., LANDING],
        out[..., LANDING_BEFORE],
        out[..., first : first + 2 * k].reshape(len(out), 3, k, 2),
        info,
    )
