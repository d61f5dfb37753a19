"""Flipped bytes in recordings: is each one found, how fast, and what of the recording is still read right?

    python -m benchmarks.daq.flips [--kind closed|unsealed|cut-off] [--flips 400] [--bytes 1] [--seed 1]

Each trial changes neighbouring bytes at a random place of a sound recording, half of them outside the samples. Then
`verify`, `open_recording` with a read of everything, and `recover` are asked. ``unseen``: `verify` calls the file
sound, yet something reads differently. ``wrong``: a reader is given a number that differs, or loses a sample that no
gap declares. ``hung``: `verify` took longer than 2 s of wall time (10 s where the file is read by another process).
``raised``: anything but an answer or an `InputError`.
"""

from __future__ import annotations

import argparse
import logging
import shutil
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from daq.files.seal import Seal, read_seal
from daq.files.tables import CLOCK_DTYPE, Block
from daq.recording import CHANNELS, Recording, open_recording, verify
from daq.recording.recover import recover
from daq.recording.writer import RecordingWriter
from daq.setup.errors import InputError
from daq.setup.setup import Setup

PROFILE = Path(__file__).parents[2] / "rig_profiles" / "simulated.toml"
SETUP = {
    "name": "flips", "forcing": {"frequency_hz": 25.37}, "ball": {"mass_kg": 0.25},
    "channels": {"accelerometer": {"sensitivity": {"value": 0.1, "uncertainty": 0.0005}, "unit": "V/g"}},
}  # fmt: skip
N_BLOCKS, BLOCK = 160, 512
LIMIT_S = {"closed": 2.0, "unsealed": 10.0, "cut-off": 10.0}


def make(path: Path, kind: str) -> None:
    """A recording of 80,000 samples with a gap, steps, drive changes and clock readings."""
    rng, n = np.random.default_rng(1), N_BLOCKS * BLOCK
    t = np.arange(n) / 20000.0
    tone = np.sin(2 * np.pi * 25.37 * t)
    volts = np.stack([5.0 * (tone > 0.3), 0.1 * tone, tone], 1) + 1e-3 * rng.standard_normal((n, 3))
    codes = np.rint(volts * 3276.8).astype(np.int16)
    writer = RecordingWriter(
        path, Setup.model_validate(SETUP), profile_text=PROFILE.read_text(encoding="utf-8"), channels=CHANNELS,
        backend="flips", simulated=True, note="a note", extra={"knob": 3},
    )  # fmt: skip
    for i in range(N_BLOCKS):
        lost = 7 if i == 40 else 0
        writer.append(Block(i * BLOCK, codes[i * BLOCK : (i + 1) * BLOCK], clock_ns=25_600_000 * i, lost_before=lost))
        if i % 32 == 31:
            writer.mark_step({"first_sample": (i - 31) * BLOCK, "n_samples": 32 * BLOCK, "gamma": i / 100})
    readings = np.zeros(50, CLOCK_DTYPE)
    readings["device_sample"] = readings["recorded_sample"] = np.arange(50) * 1000
    writer.mark_rows("clock_readings", readings)
    if kind == "cut-off":
        writer._frames._file.close()
        with path.open("r+b") as raw:  # as a kill leaves it: in writing mode
            raw.seek(0)
            raw.write(_as_killed(path))
        return
    writer.close()


def _as_killed(path: Path) -> bytes:
    """The superblock of a closed frames file with the marks of a writer."""
    from daq.files.frames.frame_file import lookup3

    head = bytearray(path.read_bytes()[:48])
    head[11] |= 5
    head[44:] = lookup3(bytes(head[:44])).to_bytes(4, "little")
    return bytes(head)


def content(recording: Recording) -> dict[str, Any]:
    """Everything that a reader is given."""
    names = recording.channels
    return {
        "times": recording.timestamps_ns(), "codes": {name: recording.codes(name) for name in names},
        "scales": {name: recording.scale(name) for name in names}, "setup": recording.setup,
        "steps": recording.steps, "blocks": recording.blocks, "side": recording.side,
        "attrs": {k: v for k, v in recording.attrs.items() if k not in ATTRS_OF_A_RECOVERY},
    }  # fmt: skip


ATTRS_OF_A_RECOVERY = {
    "recovered",
    "recovered_at",
    "recovered_from",
    "damage",
    "attributes_crc32",
    "sealed",
    "ended",
    "why",
    "channels",
}


def compare(recording: Recording, truth: dict[str, Any]) -> str:
    """``all``: everything is right. ``gap``: what is missing or doubtful is said, the rest is right. ``wrong``."""
    found = content(recording)
    at = np.searchsorted(truth["times"], found["times"])
    right = bool(np.all(at < len(truth["times"]))) and np.array_equal(truth["times"][at], found["times"])
    right &= all(np.array_equal(codes, truth["codes"][name][at]) for name, codes in found["codes"].items())
    right &= all(scale == truth["scales"][name] for name, scale in found["scales"].items())
    said = "\n".join((*recording.damage, str(recording.attrs.get("damage", ""))))
    right &= "root attributes" in said or (found["setup"] == truth["setup"] and found["attrs"] == truth["attrs"])
    declared = len(truth["times"]) + int(truth["blocks"]["lost_before"].sum())
    at_the_end = bool(said) and (not len(at) or at[-1] < len(truth["times"]) - 1)  # no block after it declares it
    unknown = "is not known" in said or "the table blocks" in said  # what declares gaps is gone itself
    right &= at_the_end or unknown or len(at) + int(found["blocks"]["lost_before"].sum()) == declared
    if not right:
        return "wrong"
    same = len(at) == len(truth["times"]) and len(found["codes"]) == len(truth["codes"])
    for name in ("steps", "blocks"):
        same = same and _same(found[name], truth[name])
    same = same and all(_same(rows, truth["side"][name]) for name, rows in found["side"].items())
    same = same and found["attrs"] == truth["attrs"]
    if same:
        return "all"
    return "gap" if said else "wrong"


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    return a.dtype == b.dtype and a.tobytes() == b.tobytes()


def trial(path: Path, truth: dict[str, Any], whole: str, limit_s: float) -> Counter[str]:
    """What verify, a reader and recover make of a damaged file."""
    said: Counter[str] = Counter()
    began, state = time.perf_counter(), ""
    try:
        state = verify(path).state
    except InputError:
        state = "refused"
    except Exception as error:  # noqa: BLE001 (a defect of the product: counted, as are the two below)
        said[f"raised {type(error).__name__}"] += 1
    said["hung"] += time.perf_counter() - began > limit_s
    try:
        with open_recording(path) as recording:
            read = compare(recording, truth)
    except InputError:
        read = "refused"
    except Exception as error:  # noqa: BLE001
        read = f"raised {type(error).__name__}"
    said["found" if state not in (whole, "complete", "stopped") else "idle" if read == "all" else "unseen"] += 1
    said[f"read {read}"] += 1
    out = path.with_name("out.h5")
    try:
        with open_recording(recover(path, out).path) as recording:
            saved = compare(recording, truth)
    except InputError as error:
        saved = "not needed" if "nothing to recover" in str(error) else "refused"
    except Exception as error:  # noqa: BLE001
        saved = f"raised {type(error).__name__}"
    out.unlink(missing_ok=True)
    said[f"recovered {saved}"] += 1
    said["wrong"] += "wrong" in (read, saved)
    return said


def regions(path: Path, kind: str) -> list[tuple[str, int, int]]:
    """Stretches of the file by what they hold: name, first byte, one past the last."""
    size = path.stat().st_size
    if kind == "cut-off":
        import h5py

        from daq.files.frames.frame_file import as_if_ended

        spans: list[tuple[str, int, int]] = []
        with h5py.File(as_if_ended(path), "r") as file:
            for name in file:
                file[name].id.chunk_iter(
                    lambda c, name=name: spans.append((name, c.byte_offset, c.byte_offset + c.size))
                )
        edges, at = sorted(spans, key=lambda s: s[1]), 0
        for _, first, last in list(edges):
            spans.append(("attributes and indexes", at, first))
            at = last
        return [s for s in [*spans, ("attributes and indexes", at, size)] if s[2] > s[1]]
    whole = path.with_name("whole.h5")
    seal = read_seal(whole if whole.exists() else path)
    if not isinstance(seal, Seal):
        raise TypeError(path)
    found = [
        (
            seal.columns[row["column"]] if row["column"] >= 0 else "tables, attributes, indexes",
            int(row["offset"]), int(row["offset"] + row["n_bytes"]),
        )
        for row in seal.extents
    ]  # fmt: skip
    return [("superblock", 0, 48), *found] + ([("seal", seal.end, size)] if kind == "closed" else [])


def main() -> None:
    """Run the trials and print a table by region."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kind", choices=("closed", "unsealed", "cut-off"), default="closed")
    parser.add_argument("--flips", type=int, default=400)
    parser.add_argument("--bytes", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    logging.disable()
    rng, began = np.random.default_rng(given.seed), time.perf_counter()
    table: dict[str, Counter[str]] = {}
    with tempfile.TemporaryDirectory() as folder:
        path, kept = Path(folder) / "a.h5", Path(folder) / "kept.h5"
        if given.kind == "unsealed":
            make(Path(folder) / "whole.h5", "closed")
            shutil.copy(Path(folder) / "whole.h5", path)
            with path.open("r+b") as raw:
                seal = read_seal(path)
                raw.truncate(seal.end if isinstance(seal, Seal) else None)
        else:
            make(path, given.kind)
        shutil.copy(path, kept)
        size, parts = path.stat().st_size, regions(path, given.kind)
        samples = {*CHANNELS, "timestamp", "frames"}
        other = [part for part in parts if part[0] not in samples]
        with open_recording(path) as recording:
            truth = content(recording)
        whole = verify(path).state if given.kind != "closed" else "complete"
        whole = "complete" if given.kind == "unsealed" else whole
        for i in range(given.flips):
            choice = other if i % 2 else parts
            weights = np.array([last - first for _, first, last in choice], float)
            name, first, last = choice[rng.choice(len(choice), p=weights / weights.sum())]
            place, n_bytes = int(rng.integers(first, last)), given.bytes
            changed = bytearray(kept.read_bytes())
            for at in range(place, min(place + n_bytes, last)):
                changed[at] ^= int(rng.integers(1, 256))
            path.write_bytes(changed)
            said = trial(path, truth, whole, LIMIT_S[given.kind])
            table.setdefault(name, Counter()).update(said + Counter(tried=1))
            if said["wrong"] or said["unseen"] or said["hung"] or any(key.startswith("raised") for key in said):
                print(f"byte {place} ({name}): {dict(said)}", flush=True)
    print(f"{given.kind}, {size} bytes, {given.flips} times {given.bytes} byte(s), {time.perf_counter() - began:.0f} s")
    for name, row in [*sorted(table.items()), ("all", sum(table.values(), Counter()))]:
        print(f"{name:28s}", ", ".join(f"{key} {n}" for key, n in sorted(row.items()) if n))


if __name__ == "__main__":
    main()
