"""Two clocks, one time base: how well the map is known, and how well event times agree with what really happened.

    python -m benchmarks.daq.clock_sync map        # offset and rate at 40 dB, beside what the fit says of itself
    python -m benchmarks.daq.clock_sync events     # a whole run: audio out, serial in, clocks 80 ppm apart and drifting

The run is `rig.execution.run` with the real back end, frames and decoder; card and port are in this process, at full
speed. What really happened is what the simulated plant says of its take-offs and landings, in the time of the drive.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from analysis.flights.assemble import FlightFlag, flights_of
from bench.profiles.find import load
from daq.clocks.clock_sync import ClockTracker, fit_clock
from daq.recording import open_recording
from daq.recording.writer import RecordingWriter
from rig.backends.serial_daq import SerialReader, SoundcardSerialBackend
from rig.execution.run import run_ramp
from rig.profile import parse_profile
from rig.sim.scenario import Scenario
from rig.virtual import SerialDevice
from tests.fakes.played_time import played_s
from tests.fakes.serial_loopback import WiredCard, WiredPort

RATE_HZ = 20000.0
NEAR_S = 2e-4


class Witnessed(SerialDevice):
    """A device whose plant's events are written down, in the time of the drive."""

    def __init__(self, ppm: float, ppm_per_minute: float) -> None:
        super().__init__(Scenario("ideal"), RATE_HZ, np.random.default_rng(1), ppm=ppm, ppm_per_minute=ppm_per_minute)
        self.events: dict[str, list[float]] = {"left_s": [], "landed_s": []}

    def _convert(self) -> bool:
        """Note the last event of each kind after every few conversions."""
        more = super()._convert()
        for name, seen in self.events.items():
            at = float(self.plant._state[0][name])
            if at >= 0.0 and (not seen or at != seen[-1]):
                seen.append(at)
        return more


def events(ppm: float, ppm_per_minute: float) -> None:
    """Run a ramp through two clocks and compare."""
    _, text = load("simulated")
    text = text.replace("start = 0.4, stop = 2.6, steps = 23", "start = 0.6, stop = 2.4, steps = 19")
    text = text.replace("hold_cycles = 20", "hold_cycles = 60")
    profile = parse_profile(text)
    device = Witnessed(ppm, ppm_per_minute)
    port = WiredPort(device)
    card = WiredCard(port, RATE_HZ)
    reader = SerialReader("simulated", 3, RATE_HZ, lambda: port)
    backend = SoundcardSerialBackend(card, reader, dict.fromkeys(device.plant.channels, 10.0), 0.2, 25.37)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.h5"
        writer = RecordingWriter(
            path, profile.setup(), profile_text=text, channels=backend.channels, backend=backend.name, simulated=True,
            scales=backend.scales,
        )  # fmt: skip
        began = time.monotonic()
        summary = run_ramp(profile, backend, writer)
        played = backend._played
        begin_s = (port.played_samples - played) / RATE_HZ
        with open_recording(path) as recording:
            flights = flights_of(recording)
            steps, rows, gaps = recording.steps, recording.clock_map, recording.gaps
    print(f"{ppm:+g} ppm, {ppm_per_minute:+g} ppm a minute: {summary.how} {summary.why}, {summary.n_samples} samples, "
          f"{len(flights)} flights, {time.monotonic() - began:.1f} s")  # fmt: skip
    print(f"  clock nodes {len(rows)}: offset known to {rows['uncertainty'].max() / RATE_HZ * 1e6:.3f} us, "
          f"rate {rows['rate'][0] * 1e6:.4f} to {rows['rate'][-1] * 1e6:.4f} ppm, "
          f"known to {rows['rate_uncertainty'].max() * 1e6:.4f} ppm; "
          f"frequency of the steps {steps['frequency_hz'][0]:.6f} to {steps['frequency_hz'][-1]:.6f} Hz")  # fmt: skip
    seen = ~flights.has(FlightFlag.FALSE | FlightFlag.ACCELEROMETER | FlightFlag.CUT)
    for name, own in (("take-offs", flights.takeoff_s[seen]), ("landings", flights.landing_s[seen])):
        true = np.array(device.events["left_s" if name == "take-offs" else "landed_s"]) - begin_s
        for label, times in (("by the map", played_s(own, rows, gaps, RATE_HZ)), ("nominal", nominal(own, rows))):
            near = np.clip(np.searchsorted(true, times), 1, len(true) - 1)
            off = np.where(times - true[near - 1] < true[near] - times, times - true[near - 1], times - true[near])
            matched = np.abs(off) < (NEAR_S if label == "by the map" else np.inf)
            rms_us, mean_us = np.sqrt(np.mean(off[matched] ** 2)) * 1e6, off[matched].mean() * 1e6
            print(f"  {name} {label}: {matched.sum()} of {len(off)}, rms {rms_us:.2f} us, mean {mean_us:+.2f} us")


def nominal(times_s: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """What one would believe without a map: the latency known at the start, and the same rate."""
    return times_s + (rows["played_sample"][0] - rows["recorded_sample"][0]) / RATE_HZ


def accuracy(noise_db: float, seconds: float, ratio: int) -> None:
    """Offset and rate in the middle of steps of 3 s, over ten runs."""
    off, off_rate, said, said_rate = [], [], [], []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        n = int(seconds * RATE_HZ)
        t = np.arange(n) / RATE_HZ
        rate = 1e-6 * (80.0 + t / 60.0 + 0.3 * np.sin(2 * np.pi * t / 37.0 + seed))
        place = np.arange(n) - 311.37 - seed / 7.0 + np.cumsum(rate)
        heard, played = ramp(place, ratio), ramp(np.arange(n + 2000.0), ratio)
        heard += np.std(heard) * 10 ** (-noise_db / 20) * rng.standard_normal(n)
        tracker = ClockTracker(-311.0 - seed / 7.0, 0, 1000, RATE_HZ)
        for first in range(0, n, 1000):
            tracker.played(played[first : first + 1000])
            tracker.heard(first, heard[first : first + 1000])
        at = np.arange(30_000, n, 60_000)
        fit = fit_clock(np.concatenate(tracker.readings), at)
        off.append(fit["played_sample"] - place[at])
        off_rate.append(fit["rate"] - rate[at])
        said.append(fit["uncertainty"])
        said_rate.append(fit["rate_uncertainty"])
    rms_us, rms_ppm = (float(np.sqrt(np.mean(np.square(x)))) for x in (off, off_rate))
    said_us, said_ppm = (float(np.sqrt(np.mean(np.square(x)))) for x in (said, said_rate))
    print(f"c = {ratio}, {noise_db:g} dB: offset {rms_us / RATE_HZ * 1e6:.3f} us (said {said_us / RATE_HZ * 1e6:.3f}), "
          f"rate {rms_ppm * 1e6:.3f} ppm (said {said_ppm * 1e6:.3f})")  # fmt: skip


def ramp(place: np.ndarray, ratio: int) -> np.ndarray:
    """A ramp of steps of three seconds, faded, at any place between the samples."""
    t = place / RATE_HZ
    step = np.floor(t / 3.0)
    w = np.clip((t - 3.0 * step) / 0.2, 0.0, 1.0)
    wave = np.sin(2 * np.pi * 25.37 * t)
    wave += ratio**2 * np.sin(2 * np.pi * ratio * 25.37 * t) if ratio > 1 else 0.0
    return np.where(t >= 0.0, (0.2 + 0.05 * (step - 1 + w * w * (3.0 - 2.0 * w))) * wave, 0.0)


def main() -> int:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["map", "events"])
    options = parser.parse_args()
    if options.what == "map":
        for noise_db in (60.0, 40.0, 20.0):
            for ratio in (1, 3):
                accuracy(noise_db, 60.0, ratio)
    else:
        for ppm, ppm_per_minute in ((0.0, 0.0), (80.0, 2.0), (-80.0, -2.0), (80.0, 20.0)):
            events(ppm, ppm_per_minute)
    return 0


if __name__ == "__main__":
    sys.exit(main())
