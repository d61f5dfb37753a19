"""Recordings analysed: flights, plate motion, comparison with the model, the closed loop, and drop tests."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.flights.assemble import Flights, flights_of
from analysis.flights.compare import Comparison
from analysis.flights.compare import compare as compare_flights
from analysis.flights.scan import plate_of
from analysis.flights.table import COLUMNS, flag_names
from analysis.loop.close_loop import close_loop as close_loop_of
from analysis.loop.result import ClosedLoop
from analysis.loop.tables import loop_json
from analysis.plate.motion import PlateMotion
from analysis.report.wording import gamma_scale
from bench.profiles.find import load_measuring
from bench.profiles.improved import write_improved
from bench.terminal.comparison import comparison_json, sentences
from daq.recording import Recording
from daq.recording import open_recording as open_file
from model.tones import STANDARD_GRAVITY_MPS2
from shakerbench.tables import Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FLIGHT_UNITS = {
    "takeoff_s": "s", "landing_s": "s", "duration_s": "s", "uncertainty_s": "s", "takeoff_phase": "rad",
    "landing_phase": "rad", "step": "1", "gamma": "1", "flags": "",
}  # fmt: skip
PLATE_UNITS = {
    "step": "1", "gamma": "1", "gamma_uncertainty": "1", "gamma_peak": "1", "gamma_drive": "1", "frequency_hz": "Hz",
    "frequency_uncertainty_hz": "Hz", "masked": "1",
}  # fmt: skip
COMPARISON_UNITS = {
    "step": "1", "gamma": "1", "gamma_peak": "1", "measured": "", "predicted": "", "mean_ratio": "1", "rms_s": "s",
    "within_sample": "1", "unfit_reason": "",
}  # fmt: skip


@dataclass(frozen=True, repr=False)
class FlightTable(Table):
    """Flights of a recording, one a row; ``flights`` holds every column, the plate and the uncertainty of edges."""

    flights: Flights | None = None

    def plot(self, ax: Axes, **style: Any) -> Axes:
        """Measured flight times (s) against gamma, drawn on ``ax``: only flights that are fit for a comparison.

        Parameters
        ----------
        ax : matplotlib.axes.Axes
            Drawn on, and returned.
        **style
            Of the dots, as `Axes.plot` takes them.
        """
        good = self.flights.good() if self.flights is not None else np.ones(self.n_rows, dtype=bool)
        look: dict[str, Any] = {"ms": 4.0, "mew": 0, "color": "#9b2226", "alpha": 0.6} | style
        ax.plot(self["gamma"][good], self["duration_s"][good], "o", **look)
        ax.set_xlabel("gamma")
        ax.set_ylabel("flight time (s)")
        return ax


@dataclass(frozen=True, repr=False)
class PlateTable(Table):
    """The plate's motion, one fitted step a row; ``motion`` holds tones, covariances and windows of each step."""

    motion: PlateMotion | None = None


@dataclass(frozen=True, repr=False)
class ComparisonTable(Table):
    """A recording against the model, one step a row; ``comparison`` holds changes and the first bifurcation."""

    comparison: Comparison | None = None
    summary: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """The comparison as ``bench compare --json`` writes it; times in s."""
        return {} if self.comparison is None else comparison_json(self.comparison)


@dataclass(frozen=True)
class LoopResult:
    """A closed loop.

    Parameters
    ----------
    loop : analysis.loop.close_loop.ClosedLoop
        Effects found, errors before and after (us), noise floors (us), what remains.
    recordings : tuple of Path
        What it was closed on.
    """

    loop: ClosedLoop
    recordings: tuple[Path, ...]

    @property
    def verdict(self) -> str:
        """``explained``, ``nothing_missing`` or ``unexplained``."""
        return self.loop.verdict

    def to_dict(self) -> dict[str, Any]:
        """The verdict as ``bench close-loop --json`` writes it; keys carry their units."""
        return loop_json(self.loop)

    def errors(self) -> Table:
        """Errors on the held-out steps before and after, one row each; landings and take-offs in us."""
        errors = [self.to_dict()[when] for when in ("before", "after")]
        names = [name for name in errors[0] if name in errors[1]]
        columns: dict[str, Any] = {"which": np.array(["before", "after"])}
        columns |= {name: np.array([one[name] for one in errors], dtype=np.float64) for name in names}  # None: NaN
        units = {name: "us" if "_us" in name else "1" for name in names} | {"which": ""}
        return Table(columns, units, {"noise_floor_us": self.loop.errors.landing_floor_us}, "which")

    def write_report(self, folder: str | Path) -> Path:
        """Write the page with its pictures into ``folder``; returns the page's path."""
        from analysis.report.page import write_report

        return write_report(self.loop, Path(folder), recording=self.recordings[0])

    def write_improved(self, path: str | Path) -> list[str]:
        """Write the recording's profile with the found effects declared, in SI units; returns what was written."""
        return write_improved(self.loop, self.recordings[0], Path(path))


def _opened(recording: Recording | str | Path) -> AbstractContextManager[Recording]:
    """An open recording, which stays open, or one behind a path."""
    return nullcontext(recording) if isinstance(recording, Recording) else open_file(recording)


def open_recording(path: str | Path) -> Recording:
    """Open a recording for reading: a closed one, one that is being written, or one that was cut off.

    Parameters
    ----------
    path : str or Path
        HDF5.

    Returns
    -------
    Recording
        A context manager: ``rate_hz`` in Hz, ``steps``, ``read_v(channel, start, stop)`` in V, ``setup``, ``attrs``.

    Raises
    ------
    InputError
        Where the file is missing, not HDF5, or not a recording.

    Examples
    --------
    >>> with open_recording("run.h5") as recording:  # doctest: +SKIP
    ...     recording.read_v("accelerometer", 0, 1000)
    """
    return open_file(path)


def find_flights(recording: Recording | str | Path) -> FlightTable:
    """Every flight of a recording, with times, uncertainties, phases and flags; one pass over the file.

    Parameters
    ----------
    recording : Recording, str or Path
        Open, or a path.

    Returns
    -------
    FlightTable
        Times in s, phases in rad, flags by name joined with ``|``.

    Raises
    ------
    InputError
        Where the file is no recording.

    Examples
    --------
    >>> find_flights("run.h5").to_dataframe()  # doctest: +SKIP
    """
    with _opened(recording) as opened:
        flights = flights_of(opened)
        attrs = {"recording": opened.path.name, "simulated": int(bool(opened.attrs.get("simulated")))}
    columns: dict[str, Any] = {name: getattr(flights, name) for name in COLUMNS}
    columns["flags"] = np.array([flag_names(int(flags)) for flags in flights.flags], dtype=np.str_)
    return FlightTable(columns, FLIGHT_UNITS, attrs, "flight", flights)


def plate_motion(recording: Recording | str | Path) -> PlateTable:
    """Measured motion of the plate in each step, from the accelerometer.

    Parameters
    ----------
    recording : Recording, str or Path
        Open, or a path.

    Returns
    -------
    PlateTable
        Gammas (dimensionless) with one standard deviation, frequencies in Hz.

    Raises
    ------
    InputError
        Where the file is no recording.

    Examples
    --------
    >>> plate_motion("run.h5")["gamma"]  # doctest: +SKIP
    """
    with _opened(recording) as opened:
        motion = plate_of(opened)
    fitted = [step for step in motion.steps if step is not None]
    columns = {name: np.array([getattr(step, name) for step in fitted]) for name in PLATE_UNITS}
    return PlateTable(columns, PLATE_UNITS, {"noise_mps2": motion.noise_mps2}, "step", motion)


def compare(
    recording: Recording | str | Path, *, profile: str | Path | None = None, ideal: bool = False
) -> ComparisonTable:
    """Measured against predicted, step by step, at the gamma that the plate achieved.

    Parameters
    ----------
    recording : Recording, str or Path
        Open, or a path.
    profile : str or Path, optional
        Replaces the recording's own measuring part, declared effects included.
    ideal : bool
        Leave the declared effects out of the model.

    Returns
    -------
    ComparisonTable
        Root mean square differences in s; ``summary`` holds the result in sentences.

    Raises
    ------
    InputError
        Where the file is no recording, or the profile does not fit it.
    ValueError
        For effects that the model does not know.

    Examples
    --------
    >>> print(*compare("run.h5").summary, sep="\\n")  # doctest: +SKIP
    """
    with _opened(recording) as opened:
        if profile is not None:
            opened.measure_with(load_measuring(profile)[0])
        setup, flights = opened.setup, flights_of(opened)
        held = compare_flights(flights, setup, effects={} if ideal else None, steps_table=opened.steps)
    columns: dict[str, Any] = {
        name: np.array([step.measured.label if name == "measured" else getattr(step, name) for step in held.steps])
        for name in COMPARISON_UNITS
    }
    summary = tuple(sentences(held, gamma_scale(setup.forcing, held.ratio)))
    return ComparisonTable(columns, COMPARISON_UNITS, {"effects": ", ".join(held.effects)}, "step", held, summary)


def close_loop(
    recordings: Sequence[str | Path] | str | Path, *, profile: str | Path | None = None, anyway: bool = False
) -> LoopResult:
    """Find where measurement and model part, name the missing effect, and report the error before and after.

    Parameters
    ----------
    recordings : path, or sequence of paths
        Of one rig; their steps are judged together.
    profile : str or Path, optional
        Replaces the recordings' own measuring part.
    anyway : bool
        Go on where a recording contradicts its profile so far that a verdict means nothing.

    Returns
    -------
    LoopResult
        Errors and noise floors in us.

    Raises
    ------
    InputError
        Where a file is no recording, contradicts its profile, or holds too few steps.

    Examples
    --------
    >>> close_loop(["run.h5"]).verdict  # doctest: +SKIP
    'explained'
    """
    paths = tuple(Path(p) for p in ([recordings] if isinstance(recordings, str | Path) else recordings))
    setup = None if profile is None else load_measuring(profile)[0]
    return LoopResult(close_loop_of(paths, setup=setup, anyway=anyway), paths)


def drop(
    files: Sequence[str | Path] | str | Path,
    *,
    fps: float | None = None,
    scale_m: float | None = None,
    heights_m: Sequence[float] = (),
    g_mps2: float = STANDARD_GRAVITY_MPS2,
    seed: int = 1,
) -> dict[str, Any]:
    """Restitution, friction and drag from drop tests by camera, sound or contact.

    Parameters
    ----------
    files : path, or sequence of paths
        Films, folders of frames, tables, WAV files or recordings of one ball.
    fps : float, optional
        Frames a second at which it was filmed, 1/s; by default the file's own.
    scale_m : float, optional
        Metres a pixel, or a unit of the table.
    heights_m : sequence of float
        Stated drop heights to check, m: one for all, or one for each file.
    g_mps2 : float
        Local gravity, m/s^2.
    seed : int
        Of the bootstrap.

    Returns
    -------
    dict
        As ``bench drop --json`` writes it: values with 95 % intervals, keys with their units.

    Raises
    ------
    InputError
        For what is no drop test, with the file and what to do.

    Examples
    --------
    >>> drop("bounces.wav")["chosen"]  # doctest: +SKIP
    'constant_restitution'
    """
    from bench.jobs.drop_test import Request, check_request, measure

    paths = tuple(Path(p) for p in ([files] if isinstance(files, str | Path) else files))
    request = Request(paths, fps, scale_m, heights_m=tuple(heights_m), gravity_mps2=g_mps2, seed=seed)
    check_request(request)
    return measure(request).outcome.payload
