"""The closed loop on gamma: on target before a step holds, on a rig that answers otherwise than its profile says."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from bench.profiles.find import load
from daq.recording import Recording, open_recording
from daq.recording.writer import RecordingWriter
from rig.backends.simulated import SimulatedBackend
from rig.execution.amplitude_loop import achieved_gamma, target_acceleration
from rig.execution.operator import RunSummary
from rig.execution.plate_monitor import Amplitudes, MeterBlock, ToneMeter
from rig.execution.run import run_ramp
from rig.profile import ControlTable, Profile
from rig.sim.scenario import Scenario
from tests.fakes.commanded_drive import commanded, fades_of_changes

F_HZ = 25.37
LAG_S = math.tan(math.radians(20.0)) / (2.0 * math.pi * F_HZ)  # 20 degrees at the first tone, more at the second
OFF = {"drive_gain": {"relative": 0.4125}, "phase_lag": {"time_constant_s": LAG_S}}  # 3 dB too loud
GAMMAS = {1: (0.45, 1.3, 2.2), 2: (0.18, 0.7, 1.1), 3: (0.1, 0.4, 0.6)}  # the ball at rest, and flying


def profile_for(ratio: int, control: ControlTable | None, hold_cycles: int = 40) -> Profile:
    """The shipped profile of ``ratio`` with three steps."""
    profile, _ = load({1: "simulated", 2: "c2", 3: "c3"}[ratio])
    ramp = profile.ramp.model_copy(update={"gamma": GAMMAS[ratio], "hold_cycles": hold_cycles})
    return profile.model_copy(update={"control": control, "ramp": ramp})


def record(profile: Profile, scenario: Scenario, path: Path) -> RunSummary:
    """Run it on the simulated rig."""
    backend = SimulatedBackend(profile.sampling.rate_hz, scenario, seed=7)
    writer = RecordingWriter(
        path, profile.setup(), profile_text="", channels=backend.channels, scales=backend.scales,
        backend=backend.name, simulated=True,
    )  # fmt: skip
    return run_ramp(profile, backend, writer)


def plain_fit(volts: np.ndarray, first: int, rate_hz: float, multiples: tuple[int, ...]) -> np.ndarray:
    """Complex amplitudes by a plain least squares of another making than the loop's, with harmonics up to 6."""
    angle = 2 * np.pi * (np.arange(first, first + len(volts)) * F_HZ / rate_hz % 1.0)
    columns = [np.ones(len(volts))]
    for m in range(1, 7):
        columns += [np.cos(m * angle), -np.sin(m * angle)]
    solution = np.linalg.lstsq(np.array(columns).T, volts, rcond=None)[0]
    return np.array([complex(solution[2 * m - 1], solution[2 * m]) for m in multiples])


def worst_errors(path: Path, profile: Profile, plate_mps2) -> tuple[float, float]:
    """Largest relative amplitude error and phase error in degrees over the holds, by ``plate_mps2(recording, row)``."""
    relative, degrees = [], []
    with open_recording(path) as recording:
        for row in recording.steps:
            ratio = plate_mps2(recording, row) / target_acceleration(profile, float(row["gamma"]))
            relative.append(np.abs(np.abs(ratio) - 1.0).max())
            degrees.append(np.degrees(np.abs(np.angle(ratio))).max())
    return max(relative), max(degrees)


def hold_of(recording, row, channel: str) -> tuple[np.ndarray, int]:
    """Volts of a step's hold, and its first sample."""
    first = int(row["first_sample"] + row["settle_samples"])
    return recording.read_v(channel, first, int(row["first_sample"] + row["n_samples"])), first


def by_the_drive(recording, row) -> np.ndarray:
    """What the plate must have done: the looped-back drive through the response that the scenario hides."""
    volts, first = hold_of(recording, row, "drive")
    multiples = tuple(m for m, _ in recording.setup.forcing.displacement_tones())
    response = [2.0 * 9.80665 * 1.4125 / (1 + 2j * math.pi * m * F_HZ * LAG_S) for m in multiples]
    return plain_fit(volts, first, recording.rate_hz, multiples) * np.array(response)


def by_a_twin(effects: dict[str, dict[str, float]]) -> Callable[[Recording, np.void], np.ndarray]:
    """Judge by the same plant, given the same drive bit for bit, whose sensor neither rings nor makes noise."""
    silent = Scenario("twin", effects, {"ring_g_s_per_m": 0.0, "accelerometer_noise_g": 0.0})
    moved: list[np.ndarray] = []

    def judge(recording: Recording, row: np.void) -> np.ndarray:
        setup = recording.setup
        if not moved:
            twin = SimulatedBackend(recording.rate_hz, silent, seed=7)
            twin.start()
            drive_v = commanded(setup, fades_of_changes(setup, recording.drive_changes), 0, recording.n_samples)
            scale = twin.scales["accelerometer"][0] / setup.channels.accelerometer.volts_per_mps2
            moved.append(twin.exchange(drive_v).codes[:, 1] * scale)
        first, end = int(row["first_sample"] + row["settle_samples"]), int(row["first_sample"] + row["n_samples"])
        multiples = tuple(m for m, _ in setup.forcing.displacement_tones())
        return plain_fit(moved[0][first:end], first, recording.rate_hz, multiples)

    return judge


@pytest.mark.parametrize("ratio", [1, 2, 3])
def test_gain_and_lag_are_driven_out(tmp_path: Path, ratio: int) -> None:
    """3 dB too loud and 20 degrees late, the ball bouncing: within 0.5 % and 0.5 degrees by the hidden response."""
    path = tmp_path / "run.h5"
    profile = profile_for(ratio, ControlTable())
    assert record(profile, Scenario("off", OFF), path).how == "complete"
    relative, degrees = worst_errors(path, profile, by_the_drive)
    assert relative < 0.005 and degrees < 0.5


@pytest.mark.parametrize("mass_ratio", [0.01, 0.03])
@pytest.mark.parametrize("ratio", [1, 2, 3])
def test_with_a_resonance_at_5_hz(tmp_path: Path, ratio: int, mass_ratio: float) -> None:
    """The same with a slow table mode that ball and impacts drive, noise and ringing on: within tolerance by a twin."""
    path = tmp_path / "run.h5"
    effects = OFF | {"table_resonance": {"frequency_hz": 5.0, "damping": 0.05, "mass_ratio": mass_ratio}}
    profile = profile_for(ratio, ControlTable())
    assert record(profile, Scenario("off", effects), path).how == "complete"
    relative, degrees = worst_errors(path, profile, by_a_twin(effects))
    assert relative < 0.005 and degrees < 0.5


def test_open_loop_misses_and_the_step_table_says_so(tmp_path: Path) -> None:
    """Without control the same rig is a third off; the step table's achieved gamma tells it, within its uncertainty."""
    path = tmp_path / "run.h5"
    profile = profile_for(1, None)
    record(profile, Scenario("off", OFF), path)
    relative, degrees = worst_errors(path, profile, by_the_drive)
    assert relative > 0.3 and degrees > 15
    with open_recording(path) as recording:
        for row in recording.steps:
            gamma = np.abs(by_the_drive(recording, row) / target_acceleration(profile, 1.0))[0]
            assert abs(row["achieved_gamma"] - gamma) < 3 * row["achieved_gamma_uncertainty"] < 0.03 * gamma


def test_a_step_that_cannot_settle_stops_the_run(tmp_path: Path) -> None:
    """A tolerance that noise forbids ends the run softly with the step and the error, not with a guess."""
    path = tmp_path / "run.h5"
    profile = profile_for(1, ControlTable(tolerance=1e-5, tolerance_deg=1e-3, max_cycles=80))
    summary = record(profile, Scenario("off", OFF), path)
    assert summary.how == "stopped" and "step 0 (gamma 0.45) has not settled within 80 cycles" in summary.why
    with open_recording(path) as recording:
        row = recording.steps[-1]
        assert row["settle_samples"] == row["n_samples"] and np.isnan(row["achieved_gamma"])


def test_settling_takes_whole_cycles_and_is_told(tmp_path: Path) -> None:
    """Under control the step table says how many cycles each step really settled; holds begin on a cycle."""
    path = tmp_path / "run.h5"
    profile = profile_for(1, ControlTable(), hold_cycles=5)
    record(profile, Scenario("off", OFF), path)
    with open_recording(path) as recording:
        cycle = recording.rate_hz / F_HZ
        end = 0
        for row in recording.steps:
            assert row["first_sample"] == end
            end += row["n_samples"]
            assert row["settle_samples"] - row["fade_samples"] == pytest.approx(row["settle_cycles"] * cycle, abs=1.0)
            assert row["n_samples"] - row["settle_samples"] == pytest.approx(5 * cycle, abs=1.0)
        assert len(set(recording.steps["settle_cycles"])) > 1


def test_meter_and_achieved_gamma(make_profile) -> None:
    """A known motion comes back tone by tone; gamma's uncertainty holds scale, g and fit in quadrature."""
    profile = make_profile(("rate_hz = 2000", "rate_hz = 20000"), ratio=2)
    asked = target_acceleration(profile, 0.8)
    n = np.arange(20000)
    a = sum(np.real(z * np.exp(2j * np.pi * m * F_HZ * n / 20000)) for m, z in zip((1, 2), asked, strict=True))
    meter = ToneMeter(profile, 4)
    meter.begin(0)
    for start in range(0, 20000, 333):
        meter.add(MeterBlock(start, a[start : start + 333], np.ones(len(a[start : start + 333]), bool)))
    measured = meter.estimate()
    assert measured is not None and len(meter.windows) == 6
    assert np.abs(measured.values / asked - 1).max() < 1e-9
    gamma, uncertainty = achieved_gamma(profile, measured)
    assert gamma == pytest.approx(0.8) and uncertainty == pytest.approx(0.8 * 1e-3 / 9.80665, rel=1e-3)
    noisy = Amplitudes(asked * cmath.exp(0.3j), np.array([0.08, 0.0]))
    assert achieved_gamma(profile, noisy)[1] == pytest.approx(math.hypot(0.08 / 9.80665, 0.8e-3 / 9.80665))


def test_meter_puts_the_load_back_where_impacts_are_masked(make_profile) -> None:
    """A plate that gives way under the ball by 3 %: masked after each landing, a plain fit is off, the meter is not."""
    profile = make_profile(("rate_hz = 2000", "rate_hz = 20000"))
    n, rate_hz, g = np.arange(60000), 20000.0, profile.g_mps2.value
    turns = n * F_HZ / rate_hz % 1.0
    touching, quiet = turns < 0.35, turns > 0.2
    asked = target_acceleration(profile, 0.8)[0]
    motion = np.real(asked * np.exp(2j * np.pi * turns))
    noise = 0.1 * np.random.default_rng(3).standard_normal(len(n))
    plate = motion - 0.03 * touching * (motion + g)
    true = plain_fit(plate, 0, rate_hz, (1,))[0]
    errors = []
    for known in (touching, None):
        meter = ToneMeter(profile, 8)
        meter.begin(0)
        for k in range(0, len(n), 500):
            piece = slice(k, k + 500)
            touches = None if known is None else known[piece]
            meter.add(MeterBlock(k, plate[piece] + noise[piece], quiet[piece], touches))
        measured = meter.estimate()
        assert measured is not None
        errors.append(abs(measured.values[0] / true - 1))
    assert errors[0] < 2e-4 and errors[1] > 2e-3


def test_meter_drops_what_impacts_leave_unseen(make_profile) -> None:
    """A window of which impacts leave too little is dropped, and less than a cycle is no measurement."""
    profile = make_profile()
    meter = ToneMeter(profile, 2)
    meter.begin(0)
    assert meter.estimate() is None
    meter.add(MeterBlock(0, np.zeros(1000), np.zeros(1000, bool)))
    assert meter.estimate() is None and meter.windows == []
