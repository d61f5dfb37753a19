"""Deaths of the host behind the gate of `firmware/`: is the drive at zero within two cycles, and does it stay there?

    python -m benchmarks.rig.gate_deaths [--deaths 1000] [--seed 1] [--emulator node_modules/rp2040js]

The gate is compiled for this machine. A host arms it and answers its counts, by a line that is slow, and dies at a
random moment: before it armed, in the middle of a message, between two. Then the line is silent, carries noise, what
was in its buffer, or one message for ever; the drive goes on, stops where it was, or is noise at full scale. Checked:
limits of amplitude and slew at every sample; zero from two cycles after the death on; no host opens it again;
a button does.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.rig.gate_emulator import EmulatedGate, build_for_chip
from rig.backends.gate import ARM, BEAT, END, GateLimits, StatusReader, limits_for, message
from tests.fakes.gate import Gate, build_gate

TICKS = 8  # in a cycle: the gate sends its count, the line moves
AFTER = ("silence", "noise", "buffer", "one message")
DRIVES = ("goes on", "stops", "noise")


class Line:
    """Bytes on their way to the gate, each some ticks long."""

    def __init__(self, delay: int) -> None:
        self._on_the_way: list[list[bytes]] = [[] for _ in range(delay + 1)]
        self.sent: list[bytes] = []

    def send(self, wire: bytes) -> None:
        """Put bytes in."""
        self._on_the_way[-1].append(wire)
        self.sent.append(wire)

    def tick(self) -> bytes:
        """Bytes that arrive now."""
        self._on_the_way.append([])
        return b"".join(self._on_the_way.pop(0))


def death(make: Callable[[int], Gate], rng: np.random.Generator) -> tuple[str, Counter[str]]:
    """One death: what is wrong (nothing where all is well), and what it was."""
    part, rate_hz = float(rng.uniform(0.05, 1.0)), float(rng.integers(1000, 20001))
    limits = limits_for(25.0, 25.0 * int(rng.integers(1, 4)), part, rate_hz)
    gate = make(int(rng.choice([0, 2**31, 2**32]) - rng.integers(1, 9 * limits.cycle)) % 2**32)
    line, heard = Line(int(rng.integers(0, 3))), StatusReader()
    every = int(rng.integers(1, 5))  # ticks between two messages
    dies, after, what = int(rng.integers(0, 5 * TICKS)), str(rng.choice(AFTER)), str(rng.choice(DRIVES))
    tick = limits.cycle // TICKS
    phase = 2 * np.pi * np.arange((dies + 7 * TICKS) * tick) / limits.cycle
    drive = np.rint(0.95 * limits.limit * np.sin(phase)).astype(np.int16)
    dead = drive[dies * tick :]
    if what == "stops":
        dead[:] = dead[0]
    elif what == "noise":
        dead[:] = rng.integers(-32768, 32768, len(dead))
    armed, out = False, list[NDArray[np.int16]]()
    for k in range(dies + 7 * TICKS):
        status = heard.feed(gate.status())
        if k <= dies and status is not None and (not armed or k % every == 0):
            wire = message(BEAT if armed else ARM, status.now, None if armed else limits)
            line.send(wire[: int(rng.integers(0, len(wire)))] if k == dies else wire)
            armed = True
        elif k > dies and line.sent:
            line.send({
                "silence": b"", "noise": rng.bytes(int(rng.integers(0, 40))), "buffer": line.sent[k % len(line.sent)],
                "one message": line.sent[-2 if len(line.sent) > 1 else -1],
            }[after])  # fmt: skip
        gate.hear(line.tick())
        out.append(gate.play(drive[k * tick : (k + 1) * tick]))
    kinds = Counter({f"then {after}": 1, f"drive {what}": 1, "armed" if np.any(out[dies]) else "not open": 1})
    return fault(gate, limits, np.concatenate(out).astype(int), dies * tick + 2 * limits.cycle), kinds


def fault(gate: Gate, limits: GateLimits, out: NDArray[np.int_], zero_from: int) -> str:
    """What is wrong with samples that left the gate, and with how it opens again."""
    if np.any(np.abs(out) > limits.limit):
        return "beyond the limit of amplitude"
    if np.any(np.abs(np.diff(out, prepend=0)) > limits.slew):
        return "beyond the limit of slew"
    if np.any(out[zero_from:]):
        return f"not at zero, {np.flatnonzero(out)[-1] - zero_from} samples late"
    was_open = bool(np.any(out))
    drive = np.full(limits.cycle, limits.limit // 2, np.int16)
    for pressed in (False, True):
        if pressed:
            gate.press()
        for kind in (END, ARM, BEAT):
            status = StatusReader().feed(gate.status())
            gate.hear(b"\0" + message(kind, status.now if status else 0, limits if kind == ARM else None))
        opened = bool(np.any(gate.play(drive)))
        if opened != pressed and (was_open or pressed):
            return "does not open by its button" if pressed else "was opened by a host"
        if not was_open:
            return ""
    return ""


def score(make: Callable[[int], Gate], n_deaths: int, seed: int) -> Counter[str]:
    """So many deaths: what they were, and what was wrong."""
    rng, counts = np.random.default_rng(seed), Counter[str]()
    for i in range(n_deaths):
        wrong, kinds = death(make, rng)
        counts += kinds
        counts["deaths"] += 1
        counts["at zero within two cycles, and locked"] += not wrong
        if wrong:
            counts[f"WRONG: {wrong}"] += 1
            print(f"death {i}: {wrong}", flush=True)
    return counts


def main() -> None:
    """Score the deaths and print what they were."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--deaths", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--emulator", type=Path, help="folder of rp2040js: the gate's machine code runs on it")
    given = parser.parse_args()
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        if given.emulator is None:
            library = build_gate(Path(folder))
            counts = score(lambda now: Gate(library, now), given.deaths, given.seed)
        else:
            elf, emulator = build_for_chip(Path(folder)), given.emulator.resolve()
            counts = score(lambda now: EmulatedGate(elf, emulator, now), given.deaths, given.seed)
    print(f"{time.process_time() - began:.0f} s of processor")
    for key, n in counts.most_common():
        print(f"{n:7d} {key}")


if __name__ == "__main__":
    main()
