"""The locked cycle held to gamma_peak 6 on the simulated rig: by seeds, delays and a friction.

Run: python -m benchmarks.rig.branch_hold [--seeds 20] [--friction 0.1] [--out FOLDER]

Each run is judged from its recording: flights, held part, corrections, phase and multiplier against the exact branch
of the ball that was there. The friction is declared: the controller takes the branch of that ball.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from analysis.flights.assemble import flights_of
from analysis.residuals.held import HeldStep, held_steps
from bench.jobs.run_ramp import branch_hold, locked_branch
from bench.profiles.find import load
from daq.recording import open_recording
from daq.recording.writer import RecordingWriter
from daq.setup.setup import Setup
from rig.execution.run import run_ramp
from rig.profile import BranchTable, ControlTable, Profile, parse_profile
from rig.sim.scenario import Scenario
from tests.fakes.delayed import Delayed

GAMMAS = (1.75, 1.875, 2.0, 2.125, 2.25, 2.375, 2.5, 2.625, 2.75, 2.875, 3.0)
DELAYS_MS = (0, 5, 10, 20, 30, 40)


def profile_of(friction: float, kick: float, seed: int = 0) -> Profile:
    """The shipped profile with a slow ramp over the branch; declared ``friction`` for the comparison."""
    text = load("simulated")[1]
    if friction:
        text += f"\n[declared.coulomb_friction]\nmu_up = {friction}\nmu_down = {friction}\n"
    profile = parse_profile(text)
    update = {"gamma": GAMMAS, "order": None, "settle_cycles": 20, "hold_cycles": 120, "slew_per_cycle": 0.01}
    if friction:  # the lock is later
        update["gamma"] = (1.85, *GAMMAS[2:])
    control = ControlTable(branch=BranchTable(kick=kick, seed=seed))
    backend = profile.backend.model_copy(update={"block_samples": 100})
    ramp = profile.ramp.model_copy(update=update)
    return profile.model_copy(update={"ramp": ramp, "control": control, "backend": backend})


def run(seed: int, friction: float, kick: float, folder: Path) -> tuple[str, list[HeldStep]]:
    """How one run ended, and its held steps."""
    profile, delay_ms = profile_of(friction, kick, seed), DELAYS_MS[seed % len(DELAYS_MS)]
    hidden = {"coulomb_friction": {"mu_up": friction, "mu_down": friction}} if friction else {}
    rig = Delayed(profile.sampling.rate_hz, Scenario("branch", hidden), seed)
    rig.behind(round(delay_ms * 1e-3 * profile.sampling.rate_hz))
    path, hold = folder / f"{friction:g}-{seed}.h5", branch_hold(profile)
    writer = RecordingWriter(
        path, Setup.model_validate(profile.setup()), profile_text="", channels=rig.channels, scales=rig.scales,
        backend=rig.name, simulated=True,
    )  # fmt: skip
    ended = run_ramp(profile.model_copy(update={"control": None}), rig, writer, hold=hold)
    with open_recording(path) as recording:
        steps = held_steps(recording, flights_of(recording))
    return f"{delay_ms:2d} ms, {ended.how} {ended.why}{ended.let_go}", steps


def main() -> None:
    """Print one line a run and the worst of all."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--friction", type=float, default=0.0)
    parser.add_argument("--kick", type=float, default=0.002)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    exact = locked_branch(profile_of(given.friction, given.kick))
    every: list[list[float]] = []
    planned = len(profile_of(given.friction, given.kick).ramp.gammas())
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(given.seeds):
            began = time.process_time()
            ended, steps = run(seed, given.friction, given.kick, given.out or Path(folder))
            rows = []
            for h in steps:
                mu = float(np.interp(h.gamma, exact.gamma, exact.multiplier))
                phase = float(np.interp(h.gamma, exact.gamma, exact.phase[:, 0]))
                late = (h.flight_s - 1.0 / 25.37) / h.flight_uncertainty_s
                inside = h.interval[0] <= mu <= h.interval[1]
                rows.append([h.held, h.correction_rms, h.correction_mean, late, h.phase - phase,
                             h.multiplier / mu - 1.0, inside])  # fmt: skip
            every += rows
            t = np.array(rows).reshape(-1, 7)
            print(
                f"seed {seed:2d} {ended}: {len(t)} of {planned} steps held, least {t[:, 0].min(initial=1):.3f} of "
                f"cycles; correction rms at most {100 * t[:, 1].max(initial=0):.2f} %, mean "
                f"{100 * t[:, 2].max(initial=0):.3f} %; flights off by at most {np.abs(t[:, 3]).max(initial=0):.1f} "
                f"sigma; phase {1e3 * np.abs(t[:, 4]).max(initial=0):.1f} mrad; multiplier "
                f"{100 * np.abs(t[:, 5]).max(initial=0):.1f} %, {int(t[:, 6].sum())} in their interval; "
                f"{time.process_time() - began:.0f} s",
                flush=True,
            )
    t = np.array(every)
    if len(t):
        print(
            f"all: {len(t)} of {given.seeds * planned} steps held; multiplier off by {100 * np.std(t[:, 5]):.2f} % "
            f"rms, {np.count_nonzero(np.abs(t[:, 5]) < 0.02)} within 2 %, {int(t[:, 6].sum())} in their 95 % interval; "
            f"flights off by more than 2 sigma in {np.count_nonzero(np.abs(t[:, 3]) > 2.0)}"
        )


if __name__ == "__main__":
    main()
