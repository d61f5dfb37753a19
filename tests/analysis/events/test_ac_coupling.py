"""Contact behind a coupling capacitor: edges found as on a wire, alternation demanded, a missed edge flagged."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from analysis.events.ac_coupling import USUAL_CORNER_HZ, Coupling, LevelRestorer, measure_coupling
from analysis.events.edges import time_edges
from analysis.events.levels import CLOSES, OPENS, Crossings, CrossingScan, Levels
from analysis.flights.assemble import FlightFlag, flights_of
from analysis.signals import PAD, Piece
from daq.files.tables import Block
from daq.recording import open_recording
from daq.recording.writer import RecordingWriter

RATE = 20000.0


def high_pass(x: np.ndarray, corner_hz: float) -> np.ndarray:
    """One pole, settled on the first sample."""
    decay = np.exp(-2.0 * np.pi * corner_hz / RATE)
    low, _ = lfilter([1.0 - decay], [1.0, -decay], x, zi=[decay * x[0]])
    return x - np.concatenate([x[:1], low[:-1]])


def square(edges_s: np.ndarray, n: int, tau_s: float = 2e-5, first: float = 0.0) -> np.ndarray:
    """A circuit that toggles between 0 and 1 at the given times, by its RC."""
    t = np.arange(n) / RATE
    out = np.full(n, first)
    direction = 1.0 - 2.0 * first
    for edge in edges_s:
        out += direction * np.where(t >= edge, -np.expm1(-np.maximum(t - edge, 0.0) / tau_s), 0.0)
        direction = -direction
    return out


def restored(
    volts: np.ndarray, coupling: Coupling, cuts: int = 3, rate_hz: float = RATE
) -> tuple[Crossings, LevelRestorer]:
    """Crossings of a signal handed over in pieces."""
    restorer, scan = LevelRestorer(coupling, rate_hz), CrossingScan(coupling.levels)
    edges = np.linspace(0, volts.size, cuts + 1).astype(int)
    for first, last in pairwise(edges):
        index = np.clip(np.arange(first - PAD, last + PAD), 0, volts.size - 1)
        piece = Piece(int(first), int(last - first), {"continuity": volts[index].astype(np.float32)})
        scan.add(restorer.restore(piece), piece.first, PAD, piece.count)
    return scan.crossings(), restorer


@pytest.mark.parametrize("corner_hz", [2.0, 8.0, 20.0])
@pytest.mark.parametrize("swing_v", [5.0, -3.0])
def test_every_edge_is_found_behind_a_capacitor_and_none_that_is_not_there(corner_hz: float, swing_v: float) -> None:
    """With 2 % of noise: corner and swing come back, all edges with their sign and times as good as on a wire."""
    rng = np.random.default_rng(2)
    true = np.cumsum(rng.uniform(3e-3, 40e-3, 300))
    clean = swing_v * square(true, int((true[-1] + 0.02) * RATE))
    noise = 0.02 * rng.standard_normal(clean.size)
    volts = high_pass(clean, corner_hz) + swing_v * noise
    coupling = measure_coupling([volts], 1.1 * swing_v, RATE)  # declared 10 % wrong
    assert coupling.corner_hz == pytest.approx(corner_hz, rel=0.1)
    assert coupling.levels.open_v == pytest.approx(swing_v, rel=0.01)
    assert coupling.levels.noise_v == pytest.approx(0.02 * abs(swing_v), rel=0.05)
    crossings, restorer = restored(volts, coupling)
    np.testing.assert_array_equal(crossings.kind, np.tile([OPENS, CLOSES], 150))
    edges, _, _ = time_edges(crossings, coupling.levels, RATE)
    levels = Levels(0.0, swing_v, 0.02 * abs(swing_v))
    wire = CrossingScan(levels)
    wire.add(np.pad((clean / swing_v + noise).astype(np.float32), PAD, mode="edge"), 0, PAD, clean.size)
    wired, _, _ = time_edges(wire.crossings(), levels, RATE)
    error, wired_error = edges.time_s - true, wired.time_s - true
    assert np.abs(error).max() < 1.0 / RATE
    assert np.sqrt(np.mean(error**2)) < 1.1 * np.sqrt(np.mean(wired_error**2))
    np.testing.assert_allclose(edges.uncertainty_s, wired.uncertainty_s, rtol=0.3)
    assert restorer.missed == []


@pytest.mark.parametrize("rate_hz", [48_000.0, 96_000.0])
def test_at_the_rates_of_sound_cards(rate_hz: float) -> None:
    """The same at 48 and 96 kHz, where an edge takes several samples: spans are seconds, not samples."""
    rng = np.random.default_rng(7)
    true = np.cumsum(rng.uniform(3e-3, 40e-3, 100))
    t = np.arange(int((true[-1] + 0.02) * rate_hz)) / rate_hz
    clean = np.zeros(t.size)
    for k, edge in enumerate(true):
        clean += (1 - 2 * (k % 2)) * np.where(t >= edge, -np.expm1(-np.maximum(t - edge, 0.0) / 5e-5), 0.0)
    volts = high_pass(clean, 8.0 * RATE / rate_hz) + 0.02 * rng.standard_normal(t.size)
    coupling = measure_coupling([volts], 1.0, rate_hz)
    assert coupling.corner_hz == pytest.approx(8.0, rel=0.1)
    assert coupling.levels.open_v == pytest.approx(1.0, rel=0.02)
    crossings, restorer = restored(volts, coupling, rate_hz=rate_hz)
    assert restorer.missed == []
    np.testing.assert_array_equal(crossings.kind, np.tile([OPENS, CLOSES], 50))
    edges, _, _ = time_edges(crossings, coupling.levels, rate_hz)
    assert np.sqrt(np.mean((edges.time_s - true) ** 2)) < 5e-6


def test_a_recording_that_begins_in_the_air_is_known_by_its_first_edge() -> None:
    """The first edge falls: the ball was in the air, and edges alternate from there."""
    true = np.arange(1, 60) * 0.017
    volts = high_pass(square(true, int(1.1 * RATE), first=1.0), 8.0)
    crossings, restorer = restored(volts, measure_coupling([volts], 1.0, RATE))
    np.testing.assert_array_equal(crossings.kind[:4], [CLOSES, OPENS, CLOSES, OPENS])
    assert (len(crossings.kind), restorer.missed) == (59, [])


@pytest.mark.parametrize("opens", [True, False])
def test_an_edge_too_slow_to_see_is_missed_once_and_declared(opens: bool) -> None:
    """A dirty contact lets an edge creep: the next one goes the same way as the last, and says so; then all is well."""
    rng = np.random.default_rng(5)
    true = np.arange(1, 81) * 0.02
    slow = 40 if opens else 41
    n = int(1.7 * RATE)
    volts = square(np.delete(true, [slow, slow + 1]), n)
    creep = np.interp(np.arange(n) / RATE, [true[slow], true[slow] + 0.019], [0.0, 1.0])
    creep[np.arange(n) / RATE >= true[slow + 1]] = 0.0
    volts = high_pass(volts + (creep if opens else -creep), 20.0) + 0.02 * rng.standard_normal(n)
    crossings, restorer = restored(volts, Coupling(Levels(0.0, 1.0, 0.02), 20.0, 99))
    assert len(restorer.missed) == 1
    assert restorer.missed[0] / RATE == pytest.approx(true[slow + 1], abs=5e-4)
    after = crossings.sample / RATE > true[slow + 1] + 1e-3
    np.testing.assert_allclose(crossings.sample[after] / RATE, true[slow + 2 :], atol=1.5 / RATE)


def test_silence_keeps_the_declared_swing_and_finds_nothing() -> None:
    """Noise has no edges: what was declared stands, and no crossing is made up."""
    rng = np.random.default_rng(6)
    volts = 0.1 * rng.standard_normal(200_000)
    coupling = measure_coupling([volts], 5.0, RATE)
    assert (coupling.levels.open_v, coupling.corner_hz, coupling.edges) == (5.0, USUAL_CORNER_HZ, 0)
    crossings, restorer = restored(volts, coupling)
    assert (crossings.sample.size, restorer.missed) == (0, [])


@pytest.fixture(scope="module")
def twins(make, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path, float]:
    """One run on a wire, behind an 8 Hz high-pass, and behind it with a take-off that crept, and that take-off."""
    source = make([1.2, 1.6, 2.2])
    folder = tmp_path_factory.mktemp("ac")
    rng = np.random.default_rng(8)
    with open_recording(source.path) as recording:
        codes = np.column_stack([recording.codes(name) for name in recording.channels])
        volts, scale = recording.read_v("continuity"), recording.scale("continuity")[0]
        edges = flights_of(recording)
        continuity = recording.setup.channels.continuity.model_copy(update={"coupling": "ac"})
        channels = recording.setup.channels.model_copy(update={"continuity": continuity})
        setup = recording.setup.model_copy(update={"channels": channels})
        crept = volts.copy()
        plain = (
            edges.good() & ~edges.has(FlightFlag.ACCELEROMETER) & (edges.contact_s > 5e-3) & (edges.duration_s > 2e-2)
        )
        crept_at = edges.takeoff_s[plain][5]
        at, until = round(crept_at * RATE), round(edges.landing_s[plain][5] * RATE) - 4
        crept[at - 1 : until] = np.linspace(0.0, 5.0, until - at + 1)
        for name, own in (("ac.h5", volts), ("crept.h5", crept)):
            codes[:, 0] = np.rint((high_pass(own, 8.0) + 0.02 * rng.standard_normal(own.size)) / scale)
            with RecordingWriter(
                folder / name, setup, profile_text="", channels=recording.channels, backend="test", simulated=True
            ) as writer:
                writer.append(Block(0, codes))
                for step in recording.steps:
                    writer.mark_step(step)
    return source.path, folder / "ac.h5", folder / "crept.h5", crept_at


def test_flights_behind_a_capacitor_are_those_on_a_wire(twins: tuple[Path, Path, Path, float]) -> None:
    """``coupling = "ac"``: the same flights to a few microseconds, and no edge missed."""
    with open_recording(twins[0]) as wired, open_recording(twins[1]) as coupled:
        a, b = flights_of(wired), flights_of(coupled)
    assert (len(a), b.edges.missed) == (len(b), 0)
    np.testing.assert_allclose(b.takeoff_s, a.takeoff_s, atol=3e-5)
    np.testing.assert_allclose(b.landing_s, a.landing_s, atol=3e-5)
    assert np.sqrt(np.mean((b.takeoff_s - a.takeoff_s) ** 2)) < 3e-6


def test_after_lost_samples_the_next_landing_is_not_trusted(
    twins: tuple[Path, Path, Path, float], tmp_path: Path
) -> None:
    """70 ms lost behind a capacitor: what comes before the next landing is unsure, two landings later all is well."""
    lost = 1400
    with open_recording(twins[1]) as recording:
        codes = np.column_stack([recording.codes(name) for name in recording.channels])
        at = recording.n_samples // 4
        with RecordingWriter(
            tmp_path / "gap.h5", recording.setup, profile_text="", channels=recording.channels, backend="test",
            simulated=True,
        ) as writer:  # fmt: skip
            writer.append(Block(0, codes[:at]))
            writer.append(Block(at, codes[at + lost :], lost_before=lost))
            for step in recording.steps:
                writer.mark_step(step)
        whole = flights_of(recording)
    with open_recording(tmp_path / "gap.h5") as recording:
        torn = flights_of(recording)
    gap_s = at / RATE
    after = torn.landing_s > gap_s
    assert torn.has(FlightFlag.UNSURE)[after][0]
    later = np.flatnonzero(after & ~torn.has(FlightFlag.ACCELEROMETER))[2:]  # only of the contact circuit
    true = whole.landing_s[whole.landing_s > gap_s + lost / RATE]
    off = np.abs(torn.landing_s[later][:, None] + lost / RATE - true[None, :]).min(axis=1)
    assert later.size > 10 and off.max() < 5e-5


def test_a_missed_edge_makes_its_flight_unsure(twins: tuple[Path, Path, Path, float]) -> None:
    """The flight whose take-off was missed is not in the table, and the one after it is marked."""
    with open_recording(twins[1]) as coupled, open_recording(twins[2]) as crept:
        a, b = flights_of(coupled), flights_of(crept)
    assert b.edges.missed == 1
    assert np.abs(a.takeoff_s - twins[3]).min() < 1e-4 < np.abs(b.takeoff_s - twins[3]).min()
    first_after = np.flatnonzero(b.takeoff_s > twins[3])[0]
    same = np.argmin(np.abs(a.takeoff_s - b.takeoff_s[first_after]))
    assert b.has(FlightFlag.UNSURE)[first_after] and not a.has(FlightFlag.UNSURE)[same]
    assert b.has(FlightFlag.UNSURE).sum() == a.has(FlightFlag.UNSURE).sum() + 1
