"""Tables of a closed loop: steps, flights and plate data, measured and predicted, as plain arrays."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from analysis.flights.compare import FirstBifurcation, first_bifurcation
from analysis.flights.table import Flights
from analysis.loop.result import (
    Bifurcation,
    FirstBifurcations,
    FlightTable,
    PlateTable,
    Predictions,
    Source,
    StepTable,
)
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.uncertainty import uncertainty_at
from analysis.residuals.values import Values
from daq.recording import open_recording
from daq.recording.identity import stored_id
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from kernels.arrays import Bools
from model.effects.registry import resolve

Effects = Mapping[str, Mapping[str, float]]


def step_table(model: ForwardModel, train: Bools) -> StepTable:
    """Steps of the observations; those outside ``train`` (m,) are held out."""
    steps = model.observations.steps
    return StepTable(steps.recording, steps.number, steps.gamma, steps.ratio, steps.plate.period_s, ~train)


def flight_table(model: ForwardModel, before: Values, after: Values) -> FlightTable:
    """Flights with the predictions at the fitted values ``before`` and ``after``."""
    observations = model.observations
    first = _predictions(model, before)
    return FlightTable(
        observations.measured.step,
        observations.measured.opening_s,
        observations.measured.landing_s,
        observations.scored,
        model.from_rest,
        first,
        first if after == before else _predictions(model, after),
        model.covariates(after),
    )


def _predictions(model: ForwardModel, values: Values) -> Predictions:
    r, u = model.residuals(values), uncertainty_at(model, values)
    return Predictions(
        r.predicted.opening_s,
        r.predicted.landing_s,
        r.opening_s,
        r.landing_s,
        u.opening_total_s,
        u.landing_total_s,
    )


def plate_table(model: ForwardModel, before: Values, after: Values) -> PlateTable:
    """Plate data with the residuals at the fitted values ``before`` and ``after``."""
    data = model.observations.plate
    residuals = (model.residuals(values).plate for values in (before, after))
    return PlateTable(data.kind, data.step, data.value, data.sigma, *residuals)


def source_of(path: Path) -> Source:
    """Provenance of a recording: date, rig, note and software."""
    with open_recording(path) as opened:
        setup, attrs = opened.setup, opened.attrs
        rig = f"{setup.name} ({setup.description})" if setup.description else setup.name
        note, version, commit = (str(attrs.get(key, "")) for key in ("note", "software_version", "software_commit"))
        started, backend = str(attrs.get("started", "")), str(attrs.get("backend", ""))
        simulated = bool(attrs.get("simulated", False))
        return Source(path.name, rig, started, backend, simulated, note, version, commit, stored_id(opened), str(path))


def first_bifurcations(flights: Flights, setup: Setup, improved: Effects) -> FirstBifurcations | None:
    """First bifurcation in the data, by the declared model and by the improved one; None without enough flights.

    Parameters
    ----------
    flights
        Of the first recording.
    setup
        Its measuring setup, with the declared effects.
    improved
        Effects of the improved model.
    """
    declared = resolve(setup.declared_values())
    try:
        before = first_bifurcation(flights, setup, declared)
        after = before if improved == declared else first_bifurcation(flights, setup, improved)
    except (ValueError, InputError):
        return None
    change, measured = before.measured, None
    if change is not None:
        low, high = sorted((float(change.gamma_before), float(change.gamma_after)))
        measured = Bifurcation(change.type, low, high)
    return FirstBifurcations(measured, _predicted(before), _predicted(after))


def _predicted(first: FirstBifurcation) -> Bifurcation:
    at = float(first.predicted_gamma)
    return Bifurcation(first.predicted_type, at, at, float(first.same_type_gamma))
