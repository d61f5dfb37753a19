"""The drive of a run again, bit for bit, from the tables of its recording."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from daq.setup.setup import Setup
from kernels.arrays import Floats
from rig.programme.ramp import Fade, PhaseClock, drive_amplitudes, stop_fade_samples, synthesise


def fades_of_changes(setup: Setup, rows: NDArray[np.void]) -> list[Fade]:
    """The fades of a recording's table of drive changes (`DRIVE_DTYPE`)."""
    n_tones = len(setup.forcing.displacement_tones())
    return [
        Fade(
            int(group["first_sample"][0]),
            int(group["n_samples"][0]),
            tuple((group["start_re_v"] + 1j * group["start_im_v"]).tolist()),
            tuple((group["end_re_v"] + 1j * group["end_im_v"]).tolist()),
        )
        for group in (rows[i : i + n_tones] for i in range(0, len(rows), n_tones))
    ]


def fades_of_steps(setup: Setup, steps: NDArray[np.void], *, zero_from: int | None = None) -> list[Fade]:
    """The fades of an open-loop run, from its step table alone.

    Parameters
    ----------
    setup
        The recording's measuring part.
    steps
        Its step table (`daq.files.tables.STEP_DTYPE`): of each row the first sample, length, fade and gamma are
        used.
    zero_from
        First sample of a hard zero, where the run was stopped *now* (the recording's ``why`` names it).
    """
    clock = PhaseClock.of(setup.forcing.frequency_hz, setup.sampling.rate_hz)
    zero = before = tuple(0j for _ in setup.forcing.displacement_tones())
    fades: list[Fade] = []
    for row in steps:
        target = drive_amplitudes(setup, float(row["gamma"]))
        fades.append(Fade(int(row["first_sample"]), int(row["fade_samples"]), before, target))
        before = target
    if fades:
        end = int(steps[-1]["first_sample"] + steps[-1]["n_samples"])
        fades.append(Fade(end, stop_fade_samples(clock), fades[-1].at(end), zero))
    if zero_from is not None:
        fades.append(Fade(zero_from, 0, zero, zero))
    return fades


def commanded(setup: Setup, fades: Sequence[Fade], first_sample: int, n_samples: int) -> Floats:
    """The drive samples of a run again, bit for bit, from its changes of amplitude.

    Parameters
    ----------
    setup
        The recording's measuring part.
    fades
        `fades_of_changes` of the recording, or `fades_of_steps` of an open-loop one; each holds until the next begins.
    first_sample, n_samples
        Which samples, by the device's own index (lost samples counted).

    Returns
    -------
    array, shape (n_samples,)
        Commanded volts; zero before the first fade.
    """
    clock = PhaseClock.of(setup.forcing.frequency_hz, setup.sampling.rate_hz)
    multiples = tuple(m for m, _ in setup.forcing.displacement_tones())
    out = np.zeros(n_samples)
    end = first_sample + n_samples
    for fade in reversed(fades):
        start = max(first_sample, fade.first_sample)
        if start < end:
            out[start - first_sample : end - first_sample] = synthesise(clock, multiples, fade, start, end - start)
            end = start
    return out
