"""Result of a closed loop: numbers, arrays and names, with no fit and no model behind them; and its file.

The report, its figures, the sentences, the JSON and the improved profile are functions of this value only, but for the
first bifurcations in a report. Decision 123.

The file is HDF5, the format of the recordings, with the arrays as datasets and everything else as one JSON text: one
file cannot lose its other half as JSON with an NPZ can. A loaded result equals the saved one: floats are written with
all their digits, and the types of the result say how to read each value.
"""

from __future__ import annotations

import dataclasses
import json
import math
import types
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import h5py
import numpy as np
from pydantic import BaseModel, ValidationError

from analysis.attribution.hypothesis import ChanceTest, Rejected
from analysis.discovery.discover import Discovery
from analysis.loop.verdict import Failed, Verdict
from analysis.residuals.lack_of_fit import GoodnessOfFit
from analysis.residuals.prediction_errors import Errors, GivenOpenings
from analysis.thresholds import Thresholds
from daq.files.disk import disk_file, whole
from daq.setup.errors import InputError
from daq.setup.setup import Setup
from kernels.arrays import Bools, Floats, Integers
from model.effects.registry import resolve


@dataclass(frozen=True)
class AddedEffect:
    """One effect that was added: its name and its parameters as ``(value, low, high)`` with 95 % intervals."""

    name: str
    parameters: Mapping[str, tuple[float, float, float]]


@dataclass(frozen=True)
class FittedParameter:
    """A parameter of the best hypothesis, in its own unit."""

    effect: str
    parameter: str
    value: float  # as fitted
    sigma: float  # its standard deviation
    added: bool  # True for a parameter of an added effect, False for a calibration or a nuisance
    trend: bool = False  # True where the value is the parameter's change over the whole run
    # how much farther below and above than its form alone says the interval reaches: see `beyond_own_form`
    beyond: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Calibration:
    """A calibration, stated and fitted."""

    effect: str
    parameter: str
    value: float  # as fitted, in the parameter's own unit
    sigma: float  # its standard deviation
    stated: float  # before the fit
    stated_sigma: float  # its standard deviation

    @property
    def moved(self) -> bool:
        """Whether the fit has moved it by more than its stated uncertainty and by three of its own."""
        change = abs(self.value - self.stated)
        return change > self.stated_sigma and change > 3.0 * self.sigma


@dataclass(frozen=True)
class TestedCandidate:
    """Effects tested on top of the declared model: held-out log-score gain and its standard error, nats."""

    __test__ = False  # a name that begins with Test is no test case

    names: tuple[str, ...]
    gain: float
    error: float


@dataclass(frozen=True)
class StepTable:
    """Steps of all recordings, arrays (m,)."""

    recording: Integers  # index of the recording
    number: Integers  # the step's number in it
    gamma: Floats  # measured ``A w^2 / g``
    ratio: Integers  # c
    period_s: Floats  # of the forcing
    held_out: Bools  # True for steps reserved for the final test

    def __len__(self) -> int:
        return len(self.gamma)


@dataclass(frozen=True)
class Predictions:
    """Flights as one model predicts them, one event ahead: arrays (n,), seconds, NaN where nothing is predicted."""

    takeoff_s: Floats
    landing_s: Floats
    takeoff_residual_s: Floats  # measured minus predicted, of the events that are scored
    landing_residual_s: Floats  # the same
    takeoff_sigma_s: Floats  # standard deviation of the residual by the errors of measurement, the plate's included
    landing_sigma_s: Floats  # the same


@dataclass(frozen=True)
class FlightTable:
    """Flights of all recordings, arrays (n,)."""

    step: Integers  # row of the step in `StepTable`
    takeoff_s: Floats  # measured, since the start of the recording
    landing_s: Floats  # the same
    scored: Bools  # True where the landing is compared with its prediction
    from_rest: Bools  # True where the take-off is compared as well: it was seen, after a rest
    before: Predictions  # of the declared model
    after: Predictions  # of the best hypothesis
    # by the names of `analysis.residuals.covariates.COVARIATES`, SI units, NaN where unknown
    covariates: Mapping[str, Floats]

    def __len__(self) -> int:
        return len(self.step)


@dataclass(frozen=True)
class PlateTable:
    """Plate observables, arrays (r,)."""

    kind: Integers  # index into `analysis.residuals.plate_data.plate_observables.KINDS`
    step: Integers  # row of the step
    value: Floats  # measured, in the unit of the kind
    sigma: Floats  # its standard deviation
    before: Floats  # residuals under the declared model, scaled to ``sigma``
    after: Floats  # the same under the best hypothesis

    def __len__(self) -> int:
        return len(self.kind)


@dataclass(frozen=True)
class Source:
    """Provenance of one recording, as its file states it.

    ``identity`` is `daq.recording.header.stored_id`, by which the verdict is found again next to the recording;
    ``path`` is where the recording lay.
    """

    file: str
    rig: str
    started: str
    backend: str
    simulated: bool
    note: str
    software_version: str
    software_commit: str
    identity: str = ""
    path: str = ""


@dataclass(frozen=True)
class Selection:
    """Outcome of the selection among sets of effects."""

    effects: tuple[AddedEffect, ...]  # effects that were added, never those declared nor nuisances
    names: tuple[str, ...]  # names of the best set of effects; empty where nothing was added
    # sets of effects that the data cannot tell from the best one, the best first; empty where nothing was added
    ties: tuple[tuple[str, ...], ...]
    parameters: tuple[FittedParameter, ...]  # everything the best hypothesis fits
    calibrations: tuple[Calibration, ...]  # those of them that the profile states
    candidates: tuple[TestedCandidate, ...]  # every candidate of the first round, in the order tested
    rounds: tuple[str, ...]  # outcome of each round of the selection, in words
    rejected: Rejected | None  # the candidate of greatest gain that was refused, or None
    chance: tuple[ChanceTest, ...]  # by round, the best candidate against what the best of all gains by chance

    @property
    def added(self) -> tuple[FittedParameter, ...]:
        """Parameters of the added effects."""
        return tuple(p for p in self.parameters if p.added)


@dataclass(frozen=True)
class HeldOutErrors:
    """Errors on the held-out steps, and what measurement noise leaves of them."""

    before: Errors  # under the declared model
    after: Errors  # under the best hypothesis
    given_openings: GivenOpenings  # the landings behind ``after``, conditioned on the openings of their steps
    landing_floor_us: float  # rms that measurement noise leaves of landings at the final model, on the same flights
    takeoff_floor_us: float  # the same of take-offs


@dataclass(frozen=True)
class DetectionLimits:
    """Effects that a run could not have shown: ``sizes`` by ``effect.parameter``, ``at_no_size`` by name."""

    sizes: Mapping[str, float]
    at_no_size: tuple[str, ...]


@dataclass(frozen=True)
class ClosedLoop:
    """Result of closing the loop."""

    verdict: Verdict
    failed: tuple[Failed, ...]  # tests that forbid "explained" or "nothing missing"
    selection: Selection  # effects that were added, and what else was tried
    discovered: Discovery | None  # a smooth term found where no named effect suffices
    errors: HeldOutErrors  # on the held-out steps
    remainder: GoodnessOfFit  # of the best hypothesis on all steps
    detection: DetectionLimits  # the size below which the run could not have shown an effect
    # measurement, prediction and residual: step by step, flight by flight and datum by datum
    steps: StepTable
    flights: FlightTable
    plate: PlateTable
    setup: Setup
    limits: Thresholds  # of the verdict
    sources: tuple[Source, ...]  # provenance of the recordings
    notes: tuple[str, ...]  # remarks on the data, in words

    @property
    def held_out(self) -> tuple[int, ...]:
        """Numbers of the held-out steps, in the order of the recordings."""
        return tuple(int(n) for n in self.steps.number[self.steps.held_out])

    def improved_effects(self) -> dict[str, dict[str, float]]:
        """Declared and added effects, without trends, by effect and parameter: the improved model."""
        out = {name: dict(table) for name, table in resolve(self.setup.declared_values()).items()}
        for p in self.selection.added:
            if not p.trend:
                out.setdefault(p.effect, {})[p.parameter] = p.value
        return out


FORMAT, VERSION = "shakerbench closed loop", 3


def save_verdict(loop: ClosedLoop, path: Path) -> None:
    """Write a closed loop to the file ``path``; raises `InputError` where the file cannot be written."""
    arrays: dict[str, np.ndarray] = {}
    tree = as_tree(loop, "", arrays)
    try:
        with whole(path) as part, disk_file(part) as disk, h5py.File(disk, "w") as file:
            file.attrs.update(format=FORMAT, version=VERSION)
            file["values"] = json.dumps(tree)
            for place, array in arrays.items():
                file.create_dataset(place, data=array)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error}); name a file in a folder you can write to") from error


def is_verdict(path: Path) -> bool:
    """Whether a file was written by `save_verdict`, of any version."""
    try:
        with h5py.File(path, "r") as file:
            return bool(file.attrs.get("format") == FORMAT)
    except OSError:
        return False


def load_verdict(path: Path) -> ClosedLoop:
    """Read a closed loop that `save_verdict` wrote.

    Raises `InputError` where the file holds none, or one of another version.
    """
    wanted = f"wanted a closed loop written by save_verdict, version {VERSION}"
    try:
        with h5py.File(path, "r") as file:
            found = file.attrs.get("format"), file.attrs.get("version")
            if found != (FORMAT, VERSION):
                raise InputError(f"{path}: {wanted}, found format {found[0]!r}, version {found[1]!r}")
            loop: ClosedLoop = from_tree(ClosedLoop, json.loads(file["values"][()]), file)
    except (OSError, KeyError, TypeError, ValueError, ValidationError) as error:
        raise InputError(f"{path}: {wanted} ({error}); save it again") from error
    return loop


def as_tree(value: Any, place: str, arrays: dict[str, np.ndarray]) -> Any:
    """JSON values of a value; arrays go to ``arrays``, by their place in the result."""
    if isinstance(value, np.ndarray):
        arrays[place] = value
        return {"array": place}
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    if dataclasses.is_dataclass(value):
        return {f.name: as_tree(getattr(value, f.name), f"{place}/{f.name}", arrays) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {key: as_tree(x, f"{place}/{key}", arrays) for key, x in value.items()}
    if isinstance(value, tuple):
        return [as_tree(x, f"{place}/{i}", arrays) for i, x in enumerate(value)]
    if isinstance(value, float) and not math.isfinite(value):
        return str(float(value))  # "nan" and "inf" are no JSON numbers
    return value.item() if isinstance(value, np.generic) else value


def from_tree(kind: Any, tree: Any, arrays: Any) -> Any:
    """Value of the type ``kind`` from `as_tree`; ``arrays`` has the arrays, or data sets, by their places."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return None if tree is None else from_tree(next(k for k in inner if k is not type(None)), tree, arrays)
    if origin is np.ndarray:
        return arrays[tree["array"]][()]
    if origin is tuple:
        kinds = inner[:1] * len(tree) if inner[1:] == (Ellipsis,) else inner
        return tuple(from_tree(k, x, arrays) for k, x in zip(kinds, tree, strict=True))
    if origin is not None and origin is not Literal and issubclass(origin, Mapping):
        return {key: from_tree(inner[1], x, arrays) for key, x in tree.items()}
    if dataclasses.is_dataclass(kind):
        hints = get_type_hints(kind)
        there = [f.name for f in dataclasses.fields(kind) if f.name in tree or f.default is dataclasses.MISSING]
        return kind(**{name: from_tree(hints[name], tree[name], arrays) for name in there})  # type: ignore[operator]
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return kind.model_validate(tree)
    return float(tree) if kind is float else tree
