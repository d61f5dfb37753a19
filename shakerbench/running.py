"""Profiles of rigs, and runs of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.jobs.run_ramp import make_backend, record
from bench.profiles.edit import with_values
from bench.profiles.find import load, planned, refuse_forbidden
from daq.setup.errors import InputError
from rig.execution.operator import RunSummary
from rig.profile import Profile, parse_profile
from shakerbench.tables import Table

PLAN_UNITS = {
    "step": "1", "gamma": "1", "gamma_peak": "1", "drive_v": "V", "acceleration_mps2": "m/s^2", "velocity_mps": "m/s",
    "displacement_m": "m", "start_s": "s", "length_s": "s",
}  # fmt: skip


@dataclass(frozen=True)
class RigProfile:
    """A rig's profile, checked, with the text that it was read from.

    Parameters
    ----------
    name : str
        Shipped name or path.
    text : str
        TOML; a recording keeps it.
    profile : rig.profile.Profile
        Forcing, ramp, channels, limits and declared effects, in SI units.
    """

    name: str
    text: str
    profile: Profile

    def with_values(self, values: Mapping[str, Any]) -> RigProfile:
        """Another profile, with ``values`` at their dotted keys; comments and all else stay.

        Parameters
        ----------
        values : mapping of str to value
            Such as ``{"ramp.gamma": [0.9, 1.0, 1.1], "forcing.ratio": 2}``; units as in the profile's file.

        Raises
        ------
        InputError
            Where the result is no profile.

        Examples
        --------
        >>> load_profile("simulated").with_values({"ramp.gamma": [0.9, 1.0]}).profile.ramp.gammas()
        (0.9, 1.0)
        """
        text = with_values(self.text, values, self.name)
        return RigProfile(self.name, text, parse_profile(text, self.name))

    def plan(self) -> Table:
        """Every step of the ramp: start and length in s, peaks of drive (V) and plate (m/s^2, m/s, m)."""
        programme, rows, _ = planned(self.profile)
        columns = {
            "step": [step.index for step, _ in rows],
            "gamma": [step.gamma for step, _ in rows],
            **{name: [getattr(asked, name) for _, asked in rows] for name in list(PLAN_UNITS)[2:7]},
            "start_s": [step.first_sample / programme.rate_hz for step, _ in rows],
            "length_s": [step.n_samples / programme.rate_hz for step, _ in rows],
        }
        return Table({name: np.array(x) for name, x in columns.items()}, PLAN_UNITS, {"profile": self.name}, "step")


def load_profile(name_or_path: str | Path) -> RigProfile:
    """The profile of a rig, by the name of a shipped one or by its path.

    Parameters
    ----------
    name_or_path : str or Path
        Such as ``"simulated"`` or ``"my_rig.toml"``. Frequencies are in Hz, amplitudes in units of g.

    Returns
    -------
    RigProfile

    Raises
    ------
    InputError
        Where there is no such profile, or it does not fit; the message names key and remedy.

    Examples
    --------
    >>> load_profile("simulated").profile.backend.kind
    'simulated'
    """
    profile, text = load(name_or_path)
    return RigProfile(str(name_or_path), text, profile)


def run(
    profile: RigProfile | str | Path,
    out: str | Path,
    *,
    scenario: str | Path | None = None,
    seed: int = 0,
    note: str | None = None,
) -> RunSummary:
    """Drive a profile's ramp through its back end and record it, behind the profile's limits.

    Parameters
    ----------
    profile : RigProfile, str or Path
        What to drive, and with which back end.
    out : str or Path
        The new recording; never overwritten.
    scenario : str or Path, optional
        What a simulated rig hides.
    seed : int
        Of the simulated rig's noise.
    note : str, optional
        The operator's note, stored in the recording.

    Returns
    -------
    RunSummary
        ``how`` (complete, stopped or failed), ``why``, ``n_samples``, ``wall_s`` in s.

    Raises
    ------
    InputError
        Where a limit forbids a step, the recording exists, or the back end cannot be opened.

    Examples
    --------
    >>> run("simulated", "first.h5", scenario="friction", seed=1).how  # doctest: +SKIP
    'complete'
    """
    own = profile if isinstance(profile, RigProfile) else load_profile(profile)
    refuse_forbidden(own.name, own.profile)
    if Path(out).exists():
        raise InputError(f"{out}: exists already and is never overwritten; choose another name")
    backend = make_backend(own.profile, scenario=None if scenario is None else Path(scenario), seed=seed)
    return record(own.profile, own.text, backend, Path(out), note=note, quiet=True)
