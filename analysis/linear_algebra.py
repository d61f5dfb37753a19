"""NumPy's linear algebra for what may not be finite: such numbers end in one error before LAPACK gets them.

LAPACK prints its own words on the terminal, and some routines return what is not finite where others raise.
Decision 280.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
import scipy.linalg

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
