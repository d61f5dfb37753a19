"""Closed loops that differ from another one."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from analysis.attribution.choice import LogScoreDifference
from analysis.discovery.discover import Band, Discovery
from analysis.discovery.symbolic import FittedForm, Form
from analysis.loop.result import ClosedLoop
from analysis.residuals.covariates import Covariate


def changed(loop: ClosedLoop, **values: Any) -> ClosedLoop:
    """The loop with other values, those of its selection and of its errors under their own names."""
    for part in ("selection", "errors"):
        value = getattr(loop, part)
        own = {f.name: values.pop(f.name) for f in dataclasses.fields(value) if f.name in values}
        values[part] = dataclasses.replace(value, **own)
    return dataclasses.replace(loop, **values)


def found_by(loop: ClosedLoop, term: str, of: str, form: Form | None, unit: str) -> ClosedLoop:
    """A loop that discovered a term, as a formula with values 0.3, 0.2, ... or as a curve."""
    x, gain = np.linspace(0.01, 0.5, 9), LogScoreDifference(90.0, 9.0, 80.0, 8.0)
    forms: tuple[FittedForm, ...] = ()
    if form is not None:
        n = len(form.parameters)
        values = (0.3, 0.2, 0.1)[:n]
        forms = (
            FittedForm(
                form.name, form.expression, form.parameters, form.kinds, ("1",) * n, values, values, -3.0, 2.0, True
            ),
        )
    discovered = Discovery(
        term, Covariate("some quantity"), "it rises", Band(x, x + 0.1, x, x, unit), x, gain,
        (("adhesion", 0.9),), (), loop.errors.after, 5.0, of, forms, form.name if form else "",
    )  # fmt: skip
    return dataclasses.replace(loop, verdict="unexplained", discovered=discovered)
