"""Continuation of a stopped ramp, or repetition of one step, as a new recording that names the first.

The first recording is only read. The new one names which it continues and from which step, and its
profile must drive the same ramp.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from daq.recording import Recording, open_recording
from daq.setup.errors import InputError
from rig.profile import Profile, parse_profile


def continued(profile: Profile, first: Path | None, step: int | None = None) -> tuple[Profile, dict[str, Any]]:
    """The rest of a ramp, and the free keys by which the new recording names the first.

    Parameters
    ----------
    profile
        The whole ramp's, as for the first recording.
    first
        The recording that was stopped; None: the whole ramp is left.
    step
        Repeat only this step, numbered as `bench plan` does (from 0).

    Raises
    ------
    InputError
        When ``first`` was driven by another ramp, has nothing left, or there is no such step.
    """
    if first is None:
        if step is not None:
            raise InputError(f"--step {step}: name the recording whose step it repeats by --resume REC.h5")
        return profile, {}
    gammas = profile.ramp.gammas()
    with open_recording(first) as recording:
        before = parse_profile(str(recording.attrs.get("profile_text", "")), f"{first} (its profile)")
        if before.forcing != profile.forcing or before.ramp != profile.ramp:
            raise InputError(
                f"{first}: was driven by another ramp; wanted the same [forcing] and [ramp] as the profile's"
            )
        began = str(recording.attrs.get("started", ""))
        if step is None:
            start = _first_unfinished(recording)
            if start >= len(gammas):
                raise InputError(f"{first}: all {len(gammas)} steps were finished; --step N repeats one of them")
            left = gammas[start:]
        else:
            if not 0 <= step < len(gammas):
                raise InputError(f"--step {step}: the ramp has the steps 0 to {len(gammas) - 1}; see bench plan")
            start, left = step, (gammas[step],)
    ramp = profile.ramp.model_copy(update={"gamma": left, "order": None})
    keys = {"continues": first.name, "continues_started": began, "from_step": start, "one_step": step is not None}
    return profile.model_copy(update={"ramp": ramp}), keys


def _first_unfinished(recording: Recording) -> int:
    """Index, in the whole ramp, of the first step that was not held to its end."""
    extra = recording.attrs.get("extra", {})
    if extra.get("one_step"):
        raise InputError(f"{recording.path}: holds one repeated step; resume the recording it names")
    start = int(extra.get("from_step", 0))
    done = 0
    for row in recording.steps:
        first, end = int(row["first_sample"]), int(row["first_sample"] + row["n_samples"])
        gaps = recording.gaps
        inside = gaps[(gaps[:, 0] > first) & (gaps[:, 0] <= end)]
        held = int(row["n_samples"] - row["settle_samples"]) + int(inside[:, 1].sum())
        wanted = float(row["cycles"]) * recording.rate_hz / float(row["frequency_hz"])
        if end > recording.n_samples or held < wanted - 2:
            break
        done += 1
    return start + done
