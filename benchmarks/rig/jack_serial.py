"""Audio out through JACK and PortAudio, frames in through a pseudo-terminal and pyserial: two clocks, in real time.

A process of its own holds the plant: it hears the drive as a JACK client and sends frames on a clock that is 80 ppm
slow and drifts. The run is `rig.execution.run` with the real back ends; what really happened is what the plant says of
its take-offs and landings, in the time of the drive.

    python -m benchmarks.rig.jack_serial            # some 40 s; needs jackd and libportaudio2
    python -m benchmarks.rig.jack_serial --kill 5   # the device's process is killed after 5 s of the run
    python -m benchmarks.rig.jack_serial --keep RUN.h5   # the recording stays, for bench close-loop

``--first`` runs all of it before other work of the machine (Linux, with the rights for it).
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

RATE_HZ, SERVER = 20000.0, f"benchmark-{os.getpid()}"
NEAR_S = 3e-4


def profile_text(port: str) -> str:
    """A short ramp through card and serial device."""
    from bench.profiles.find import load

    _, text = load("simulated")
    text = text.replace("start = 0.4, stop = 2.6, steps = 23", "start = 0.6, stop = 2.4, steps = 13")
    text = text.replace("hold_cycles = 20", "hold_cycles = 60")
    return text.replace('kind = "simulated"', f'kind = "soundcard+serial"\ndevice = "shaker"\nport = "{port}"\n')


def plant(server: str, port: str, out: str, hidden: str) -> None:
    """The process of the plant: says when it is there, runs until its input closes, then writes down what happened."""
    from rig.profile import parse_profile
    from rig.sim.scenario import Scenario, load_scenario
    from rig.virtual import JackSerialPlant

    events: dict[str, list[float]] = {"left_s": [], "landed_s": []}
    device_plant = JackSerialPlant(
        parse_profile(profile_text(port)),
        load_scenario(Path(hidden)) if hidden else Scenario("ideal"),
        1,
        server,
        ppm=80.0,
        ppm_per_minute=2.0,
    )
    convert = device_plant.device._convert

    def witnessed() -> bool:
        more = convert()
        for name, seen in events.items():
            at = float(device_plant.device.plant._state[0][name])
            if at >= 0.0 and (not seen or at != seen[-1]):
                seen.append(at)
        return more

    device_plant.device._convert = witnessed  # type: ignore[method-assign]
    with device_plant:
        print("ready", flush=True)
        sys.stdin.read()
    np.savez(out, skipped=device_plant.skipped_frames, **{k: np.array(v) for k, v in events.items()})


def run(options: argparse.Namespace) -> int:
    """Start everything, run, compare."""
    from bench.jobs.run_ramp import record
    from benchmarks.rig import jack_server
    from rig.backends.registry import open_backend
    from rig.profile import parse_profile
    from rig.virtual import jack_server as found_server

    os.environ["JACK_DEFAULT_SERVER"] = SERVER
    kill_s: float | None = options.kill
    with (
        tempfile.TemporaryDirectory() as folder,
        jack_server.asked(options.first, SERVER, int(RATE_HZ), 256),
        found_server(SERVER, RATE_HZ, 256),
    ):
        events, path, port = (Path(folder) / name for name in ("events.npz", "run.h5", "port"))
        path = options.keep or path
        command = [sys.executable, "-m", "benchmarks.rig.jack_serial", "--plant", SERVER, str(port), str(events)]
        command.append(str(options.scenario or ""))
        if options.first:
            command = jack_server.before(jack_server.PLANT) + command
            jack_server.this_process(jack_server.RUN)
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdin is not None and process.stdout is not None  # noqa: S101
            process.stdout.readline()
            text = profile_text(str(port))
            profile = parse_profile(text)
            if kill_s is not None:
                threading.Timer(kill_s, process.kill).start()
            began, cpu = time.monotonic(), time.process_time()
            summary = record(profile, text, open_backend(profile), path, quiet=True)
            wall = time.monotonic() - began
            print(f"{summary.how} {summary.why}: {summary.n_samples} samples, {summary.lost_samples} lost, "
                  f"{wall:.1f} s, {100 * (time.process_time() - cpu) / wall:.0f} % of a core")  # fmt: skip
            process.stdin.close()
            process.wait(20.0)
        if kill_s is None:
            compare(path, events)
        else:
            from daq.recording import verify

            report = verify(path)
            print(f"kept: {report.state}, {report.n_samples} samples")
    return 0


def compare(path: Path, events: Path) -> None:
    """Event times by the map against what really happened; the plant's own start is one unknown number of samples."""
    from analysis.flights.assemble import FlightFlag, flights_of
    from daq.recording import open_recording
    from tests.fakes.played_time import played_s

    with open_recording(path) as recording:
        flights, rows, gaps = flights_of(recording), recording.clock_map, recording.gaps
        lag_ms = 1e3 * float(recording.steps["first_sample"][0]) / RATE_HZ
        jumps = int(np.count_nonzero(recording.clock_readings["jump"]))
    true = np.load(events)
    seen = ~flights.has(FlightFlag.FALSE | FlightFlag.ACCELEROMETER | FlightFlag.CUT)
    print(f"flights {len(flights)}, frames the server skipped {int(true['skipped'])}, jumps of the clocks {jumps}; "
          f"rate {rows['rate'][0] * 1e6:.3f} to {rows['rate'][-1] * 1e6:.3f} ppm, "
          f"known to {rows['rate_uncertainty'].max() * 1e6:.3f}, "
          f"offset to {rows['uncertainty'].max() / RATE_HZ * 1e6:.3f} us; frames {lag_ms:.1f} ms late")  # fmt: skip
    shift = None
    for name, own in (("left_s", flights.takeoff_s[seen]), ("landed_s", flights.landing_s[seen])):
        times = played_s(own, rows, gaps, RATE_HZ)
        if shift is None:
            shift = latency(times, true[name])
        off = nearest(times + shift, true[name])
        near = np.abs(off) < NEAR_S
        off -= np.median(off[near])  # the part of a sample in the latency is one number for the whole run
        print(f"  {name}: {near.sum()} of {len(off)} within {NEAR_S * 1e6:g} us, rms {np.std(off[near]) * 1e6:.2f} us, "
              f"worst {np.abs(off[near]).max() * 1e6:.2f} us")  # fmt: skip


def latency(times: np.ndarray, true: np.ndarray) -> float:
    """The one shift (s) of the run against the plant's own start under which most events have a partner."""
    tried = (true[:400, None] - times[None, :5]).ravel()
    hits = [np.count_nonzero(np.abs(nearest(times + shift, true)) < NEAR_S) for shift in tried]
    best = tried[int(np.argmax(hits))]
    off = nearest(times + best, true)
    return float(best - np.median(off[np.abs(off) < NEAR_S]))


def nearest(times: np.ndarray, true: np.ndarray) -> np.ndarray:
    """How far each time is from the nearest true one."""
    k = np.clip(np.searchsorted(true, times), 1, len(true) - 1)
    return np.where(times - true[k - 1] < true[k] - times, times - true[k - 1], times - true[k])


def main() -> int:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kill", type=float, metavar="SECONDS")
    parser.add_argument("--keep", type=Path, metavar="RUN.h5")
    parser.add_argument("--scenario", type=Path, metavar="FILE", help="what the plant hides")
    parser.add_argument("--first", action="store_true", help="before all other work of this machine")
    parser.add_argument("--plant", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.plant:
        plant(*options.plant)
        return 0
    return run(options)


if __name__ == "__main__":
    sys.exit(main())
