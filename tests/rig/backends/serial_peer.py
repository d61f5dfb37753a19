"""A serial device in a process of its own, for the tests: a pseudo-terminal, and the simulated rig on its own clock.

Standard output: the name of the terminal, then one byte for each piece of drive taken in. Standard input: pieces of
drive, each a little-endian u32 count and so many float64 volts. POSIX alone has pseudo-terminals.
"""

from __future__ import annotations

import os
import struct
import sys
import tty

import numpy as np

from rig.sim.scenario import Scenario
from rig.virtual import SerialDevice


def main() -> None:
    """Serve until the drive ends."""
    ppm, ppm_per_minute = (float(word) for word in sys.argv[1:3])
    device = SerialDevice(Scenario("ideal"), 20000.0, np.random.default_rng(1), ppm=ppm, ppm_per_minute=ppm_per_minute)
    master, slave = os.openpty()
    tty.setraw(slave)
    out, source = sys.stdout.buffer, sys.stdin.buffer
    out.write(os.ttyname(slave).encode() + b"\n")
    out.flush()
    while len(head := source.read(4)) == 4:
        (n,) = struct.unpack("<I", head)
        wire = device.play(np.frombuffer(source.read(8 * n), "<f8"))
        while wire:
            wire = wire[os.write(master, wire) :]
        out.write(b".")
        out.flush()


if __name__ == "__main__":
    main()
