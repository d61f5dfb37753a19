"""NumPy's linear algebra for what may not be finite: such numbers end in one error before LAPACK gets them.

LAPACK prints its own words on the terminal, and some routines return what is not finite where others raise.
Decision 280.

References
----------
P. B. Stark, R. L. Parker, Comput. Stat. 10, 129 (1995): least squares within bounds.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
import scipy.linalg

from kernels.arrays import Floats

Routine = TypeVar("Routine", bound=Callable[..., Any])


class NotFiniteError(ValueError):
    """Numbers of a fit that are not finite, or equations without a solution."""


def _checked(routine: Routine) -> Routine:
    """The routine, behind a look at its arrays."""

    @functools.wraps(routine)
    def checked(*args: Any, **options: Any) -> Any:
        if not all(np.isfinite(x).all() for x in args):
            raise NotFiniteError("its equations are not finite")
        try:
            return routine(*args, **options)
        except np.linalg.LinAlgError as error:
            raise NotFiniteError("its equations have no solution") from error

    return cast(Routine, checked)


cholesky = _checked(np.linalg.cholesky)
eigh = _checked(np.linalg.eigh)
inv = _checked(np.linalg.inv)
lstsq = _checked(np.linalg.lstsq)
pinv = _checked(np.linalg.pinv)
slogdet = _checked(np.linalg.slogdet)
solve = _checked(np.linalg.solve)
solveh_banded = _checked(scipy.linalg.solveh_banded)
svd = _checked(np.linalg.svd)


def scaled_inverse(normal: Floats) -> Floats:
    """Inverse of normal equations, their unknowns in units of what each is known to alone.

    In others, what is known a million times worse than another one would be cut off as if it were known for certain.
    """
    known = np.sqrt(np.diagonal(normal))
    units = np.divide(1.0, known, out=np.ones_like(known), where=known > 0.0)
    return np.asarray(pinv(normal * np.outer(units, units), rcond=1e-14) * np.outer(units, units))


def bounded_step(normal: Floats, gradient: Floats, below: Floats, above: Floats, rcond: float | None = None) -> Floats:
    """Minimum of the quadratic model within ``below <= step <= above``, which hold 0, (p,), by an active set.

    A coordinate stays on its bound only while the rest pulls it there: two that trade places may meet theirs together
    though one of them would leave it again. ``rcond`` is that of `scipy.linalg.lstsq`. `scipy.optimize.lsq_linear`
    wants a Jacobian, which is not there.
    """
    step, loose, size = np.zeros(len(gradient)), np.ones(len(gradient), dtype=bool), np.diag(normal)
    for _ in range(4 * len(gradient)):
        goal = step.copy()
        push = gradient[loose] - normal[np.ix_(loose, ~loose)] @ step[~loose]
        goal[loose] = lstsq(normal[np.ix_(loose, loose)], push, rcond=rcond)[0]
        beyond = np.flatnonzero((goal < below) | (goal > above))
        if len(beyond):  # as far as the first bound
            bound = np.where(goal > above, above, below)[beyond]
            share = (bound - step[beyond]) / (goal - step)[beyond]
            first = share <= share.min()
            step += share.min() * (goal - step)
            step[beyond[first]] = bound[first]
            loose[beyond[first]] = False
            continue
        step, pull = goal, gradient - normal @ goal
        inwards = np.where(step > below, np.maximum(-pull, 0.0), np.maximum(pull, 0.0))
        gain = np.where(loose | (below == above), 0.0, 0.5 * inwards**2 / np.maximum(size, 1e-300))
        if gain.max(initial=0.0) < 1e-9:  # nats
            break
        loose[np.argmax(gain)] = True
    return step
