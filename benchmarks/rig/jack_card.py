"""A sound card's run without a sound card: `bench ramp` through PortAudio and JACK, the plant in another process.

The plant writes down every frame it gave. A recording is right when it is those frames, code for code, with as many
missing, and where, as it declares.

    python -m benchmarks.rig.jack_card run  # a ramp, closed loop; its flights beside the in-process rig's
    python -m benchmarks.rig.jack_card run --hold 280  # the same for five minutes
    python -m benchmarks.rig.jack_card xruns  # xruns provoked by stopping the run's process now and then
    python -m benchmarks.rig.jack_card unplug  # the driver killed in the middle of a run
    python -m benchmarks.rig.jack_card rehearse --times 20  # the rehearsal of the how-to, every core busy

Needs jackd and libportaudio2. On a machine that is busy with other work, ``--first`` runs all of it before that work
(Linux, with the rights for it).
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from benchmarks.rig import jack_server

BENCH = [sys.executable, "-c", "from bench.cli import main; main()"]
PRIORITIES = {"virtual": jack_server.PLANT, "ramp": jack_server.RUN}
STOPS_S = (0.012, 0.03, 0.05, 0.08)  # for how long the run's process is stopped, in turn


def bench(ahead: bool, *words: str) -> list[str]:
    """The call of a `bench` command, before all other work where asked for."""
    return [*(jack_server.before(PRIORITIES[words[0]]) if ahead else []), *BENCH, *words]


def profile_text(hold: int, rate_hz: int, *, simulated: bool = False, closed: bool = True) -> str:
    """The shipped sound-card profile, with the loop on gamma closed or not; the same ramp on the in-process rig."""
    from bench.profiles.find import load

    _, text = load("soundcard")
    text = text.replace("hold_cycles = 20", f"hold_cycles = {hold}")
    if closed:
        text = text.replace("# [control]", "[control]")
    text = text.replace("rate_hz = 48000", f"rate_hz = {rate_hz}").replace("steps = 23", "steps = 12")
    if simulated:
        text = text[: text.index("[backend]")] + '[backend]\nkind = "simulated"\n'
    return text


@contextmanager
def virtual(folder: Path, text: str, period: int, ahead: bool) -> Iterator[Path]:
    """The plant behind JACK; gives the profile's path, and leaves ``plant.npz``."""
    path = folder / "card.toml"
    path.write_text(text, encoding="utf-8")
    os.environ["JACK_DEFAULT_SERVER"] = server = f"card-{os.getpid()}"
    options = ["--server", server, "--period", str(period), "--log", str(folder / "plant.npz")]
    with jack_server.asked(ahead, server, int(text.split("rate_hz = ")[1].split()[0]), period):
        process = subprocess.Popen(bench(ahead, "virtual", str(path), *options), stdout=subprocess.PIPE, text=True)
        try:
            print(process.stdout.readline().strip() if process.stdout else "")
            yield path
        finally:
            process.terminate()
            print(process.communicate(timeout=60)[0].strip())


def compare(recording: Path, log: Path) -> None:
    """Frame by frame: the recording against what the plant gave."""
    from daq.recording import open_recording

    with np.load(log) as plant, open_recording(recording) as rec:
        frames, codes = plant["frame"], plant["codes"]
        at = (frames - frames[0]) % 2**32
        model = np.full((int(at[-1]) + codes.shape[1], 3), -32768, np.int16)
        for first, piece in zip(at, codes, strict=True):
            model[first : first + len(piece)] = piece
        heard = np.column_stack([rec.codes(name, 0, rec.n_samples) for name in rec.channels])
        key = heard[:64, 1]
        starts = [k for k in np.flatnonzero(model[:, 1] == key[0]) if np.array_equal(model[k : k + 64, 1], key)]
        place = np.arange(rec.n_samples) + starts[0]
        for sample, lost in rec.gaps:
            place[sample:] += lost
        same = np.all(model[place] == heard, axis=1)
        filled = np.zeros(rec.n_samples, np.bool_)
        claimed = 0
        for block in rec.blocks:
            filled[block["first_sample"] : block["first_sample"] + block["n_samples"]] = bool(block["flags"] & 8)
            claimed += bool(block["flags"] & 1)
        lost = int(rec.gaps[:, 1].sum())
        print(
            f"{rec.n_samples} frames recorded, {lost} declared lost in {len(rec.gaps)} gaps "
            f"(PortAudio claimed {claimed} losses); "
            f"{np.count_nonzero(~same)} frames differ from the plant's, {np.count_nonzero(~same & ~filled)} of them "
            f"undeclared; {np.count_nonzero(filled)} frames flagged as made up or driven by nobody"
        )
        print(f"gaps: {[(int(sample), int(n)) for sample, n in rec.gaps]}")


def flights(recording: Path) -> None:
    """Marks of the flights at the gaps."""
    from analysis.flights.assemble import FlightFlag, flights_of
    from daq.recording import open_recording

    with open_recording(recording) as rec:
        found = flights_of(rec)
        gaps_s = rec.gaps[:, 0] / rec.rate_hz
    marked = found.has(FlightFlag.GAP)
    touch = np.array([np.any((found.takeoff_s <= g) & (found.landing_s >= g)) for g in gaps_s], np.bool_)
    unmarked = sum(bool(np.any((found.takeoff_s <= g) & (found.landing_s >= g) & ~marked)) for g in gaps_s)
    print(f"{len(gaps_s)} gaps, {touch.sum()} in a flight; {marked.sum()} flights marked; {unmarked} gaps unmarked")


def beside(recording: Path, simulated: Path) -> None:
    """Flights of the two recordings, step by step."""
    from analysis.flights.assemble import flights_of
    from daq.recording import open_recording

    runs = []
    for path in (recording, simulated):
        with open_recording(path) as rec:
            good = flights_of(rec)
            runs.append((good.select(good.good()), rec.steps))
    (a, steps), (b, others) = runs
    print("gamma   achieved: card, in process   flights   mean duration (ms)   difference (us)   its doubt (us)")
    for k, (step, other) in enumerate(zip(steps, others, strict=True)):
        here, there = (1e3 * run.duration_s[run.step == k] for run in (a, b))
        if min(len(here), len(there)) < 5:
            continue
        doubt = 1e3 * np.hypot(np.std(here) / np.sqrt(len(here)), np.std(there) / np.sqrt(len(there)))
        print(
            f"{step['gamma']:5.2f}   {step['achieved_gamma']:.4f} {other['achieved_gamma']:.4f}   {len(here):4d} "
            f"{len(there):4d}   {here.mean():7.3f} {there.mean():7.3f}   {1e3 * (here.mean() - there.mean()):7.1f} "
            f"{doubt:7.1f}"
        )


def ramp(path: Path, out: Path, *, provoke: bool, ahead: bool) -> None:
    """`bench ramp` in a process of its own, and what it took."""
    process = subprocess.Popen(bench(ahead, "ramp", str(path), "--out", str(out)), stderr=subprocess.STDOUT)
    began = time.monotonic()
    turn = 0
    while process.poll() is None:
        time.sleep(1.0 + 0.037 * turn)
        if provoke and time.monotonic() - began > 4.0:
            process.send_signal(signal.SIGSTOP)
            time.sleep(STOPS_S[turn % len(STOPS_S)])
            process.send_signal(signal.SIGCONT)
            turn += 1
    import resource

    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    wall_s = time.monotonic() - began
    share = (used.ru_utime + used.ru_stime) / wall_s
    print(
        f"exit {process.returncode}; {wall_s:.0f} s; {share:.1%} of a core (start included), "
        f"largest process {used.ru_maxrss / 1024:.0f} MB; stopped {turn} times"
    )


def unplug(folder: Path, path: Path, ahead: bool) -> None:
    """`bench ramp`, and after some seconds the server killed as nobody expects it."""
    out = folder / "unplugged.h5"
    process = subprocess.Popen(bench(ahead, "ramp", str(path), "--out", str(out)))
    time.sleep(6.0)
    server = os.environ["JACK_DEFAULT_SERVER"]
    listed = subprocess.run(["pgrep", "-f", f"jackd .*-n {server} "], capture_output=True, text=True, check=True)
    os.kill(int(listed.stdout.split()[0]), signal.SIGKILL)
    killed = time.monotonic()
    code = process.wait(timeout=30)
    print(f"exit {code}, {time.monotonic() - killed:.1f} s after the server was killed")
    subprocess.run([*BENCH, "verify", str(out)], check=False)


@contextmanager
def busy(processes: int) -> Iterator[None]:
    """So many processes that want a core each, as long as the block runs."""
    others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(processes)]
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()


def rehearse(folder: Path, times: int, beside: int) -> None:
    """The shipped profile's ramp again and again, as it stands; how each one ended."""
    from bench.profiles.find import load
    from daq.recording import open_recording

    whole = 0
    with virtual(folder, load("soundcard")[1], 256, ahead=False) as path, busy(beside):
        for k in range(times):
            out = folder / f"rehearsal_{k}.h5"
            done = subprocess.run(bench(False, "ramp", str(path), "--out", str(out)), capture_output=True, text=True)
            whole += done.returncode == 0
            said = f"{k + 1}: exit {done.returncode}, {done.stdout.strip().rsplit(' -> ')[0]}"
            if out.exists():
                with open_recording(out) as recording:
                    made_up = sum(int(b["n_samples"]) for b in recording.blocks if b["flags"] & 8)
                    said += f"; {len(recording.gaps)} gaps, {made_up} samples flagged as made up"
                out.unlink()
            print(said if done.returncode == 0 else f"{said}\n   {done.stderr.strip().splitlines()[-1]}", flush=True)
    print(f"{whole} of {times} rehearsals complete, {beside} busy processes beside them on {os.cpu_count()} cores")


def main() -> None:
    """Run what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["run", "xruns", "unplug", "rehearse"])
    parser.add_argument("--hold", type=int, default=60, help="cycles of each of 12 steps")
    parser.add_argument("--rate", type=int, default=48000)
    parser.add_argument("--period", type=int, default=256)
    parser.add_argument("--times", type=int, default=20, help="rehearsals")
    parser.add_argument("--busy", type=int, default=os.cpu_count() or 1, help="processes beside the rehearsals")
    parser.add_argument("--first", action="store_true", help="before all other work of this machine")
    parser.add_argument("--keep", type=Path, help="folder for the recordings")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.keep or Path(scratch)
        folder.mkdir(exist_ok=True)
        if options.what == "rehearse":
            return rehearse(folder, options.times, options.busy)
        out = folder / "card.h5"
        text = profile_text(options.hold, options.rate, closed=options.what != "xruns")
        with virtual(folder, text, options.period, options.first) as path:
            if options.what == "unplug":
                return unplug(folder, path, options.first)
            ramp(path, out, provoke=options.what == "xruns", ahead=options.first)
        compare(out, folder / "plant.npz")
        if options.what == "xruns":
            return flights(out)
        other = folder / "in_process.toml"
        other.write_text(profile_text(options.hold, options.rate, simulated=True), encoding="utf-8")
        subprocess.run([*BENCH, "ramp", str(other), "--out", str(folder / "in_process.h5")], check=True)
        beside(out, folder / "in_process.h5")
    return None


if __name__ == "__main__":
    main()
