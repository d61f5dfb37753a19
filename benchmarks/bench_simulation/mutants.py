"""Errors put into the product, one at a time, to see whether the simulation finds them.

A module is compiled from its text with one line changed, before anything imports it.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from pathlib import Path

MUTANTS = {
    "ring overwrites": (
        "recorder_stalls",
        "daq.recorder.shared_ring",
        "if waiting >= self.slots:",
        "if waiting > self.slots:",
    ),
    "ring forgets losses": (
        "declared",
        "daq.recorder.shared_ring",
        "lost = block.lost_before + self._missing",
        "lost = self._missing",
    ),
    "ring not emptied": (
        "recorder_stalls",
        "daq.recorder.recorder_process",
        "while closing is None or ring.backlog:",
        "while closing is None:",
    ),
    "safe too early": (
        "killed",
        "daq.recorder.recorder_process",
        'ring.set_counter("safe_samples", writer.n_samples)',
        'ring.set_counter("safe_samples", writer.n_samples + 1)',
    ),
    "no sync of a step": ("power", "daq.files.frames.frame_writer", "            os.fsync(self._descriptor)\n", ""),
    "last sample not limited": (
        "",
        "rig.execution.interlock",
        "return np.clip(drive_v, -limit, limit)",
        "return np.append(np.clip(drive_v[:-1], -limit, limit), drive_v[-1:])",
    ),
    "fade a cycle longer": (
        "down",
        "rig.programme.sequencer",
        "STOP_FADE_CYCLES = Fraction(3, 2)",
        "STOP_FADE_CYCLES = Fraction(5, 2)",
    ),
    "pause without end": ("page_pause", "rig.programme.sequencer", "LONGEST_PAUSE_S = 600.0", "LONGEST_PAUSE_S = 1e9"),
    "short block not counted": (
        "short",
        "rig.execution.loss_account",
        "self._short += n_played - len(block.codes)",
        "self._short += 0",
    ),
    "card's count wraps": (
        "declared",
        "rig.backends.portaudio",
        "(counter - self._origin - self.received) % 2**32",
        "counter - self._origin - self.received",
    ),
    "frame number wraps": (
        "",
        "daq.clocks.serial_frames",
        "(frame.sequence - last.sequence - 1) % 2**32",
        "frame.sequence - last.sequence - 1",
    ),
    "no checksum of samples": (
        "flip",
        "daq.files.seal",
        'if len(data) == n_bytes and zlib.crc32(data) == row["crc32"]:',
        "if len(data) == n_bytes:",
    ),
    "last block not read": (
        "killed",
        "daq.files.frames.frame_file",
        "int(np.flatnonzero(intact)[-1]) + 1 if",
        "int(np.flatnonzero(intact)[-1]) if",
    ),
    "end of a pipe not known": (
        "recorder_dies",
        "daq.recorder.recorder_process",
        "except (EOFError, ConnectionResetError) as error:  #",
        "except ConnectionResetError as error:  #",
    ),
    "a dead recorder not looked for": (
        "recorder_dies",
        "rig.execution.run",
        "        self._write(lambda: self._writer.append(*pending))",
        "        if pending:\n            self._write(lambda: self._writer.append(*pending))",
    ),
    "heartbeat not watched": ("stall", "rig.execution.interlock", "HEARTBEAT_S = 0.5", "HEARTBEAT_S = 1e9"),
    "stuck sensor not seen": (
        "stuck",
        "rig.execution.interlock",
        "if self._still < self._cycle:",
        "if self._still < 10**9:",
    ),
}
"""Name: kind of fault that brings it to light (none: any), module, its text, and what takes the place of that."""


def mutate(name: str) -> str:
    """Put an error into the product; the kind of fault that brings it to light."""
    kind, module, right, wrong = MUTANTS[name]
    package, _, last = module.rpartition(".")
    parent = importlib.import_module(package)
    spec = importlib.util.find_spec(module)
    if module in sys.modules or spec is None or spec.origin is None:
        raise RuntimeError(f"{module}: is imported already, or has no source")
    text = Path(spec.origin).read_text(encoding="utf-8")
    if text.count(right) != 1:
        raise RuntimeError(f"{module}: not there exactly once: {right}")
    made = importlib.util.module_from_spec(spec)
    sys.modules[module] = made
    exec(compile(text.replace(right, wrong), spec.origin, "exec"), made.__dict__)
    setattr(parent, last, made)
    return kind
