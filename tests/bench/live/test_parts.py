"""Parts of the live page without a browser: board, decimation, controls, messages, one step's reduction, verdict."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from threading import Thread
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analysis.flights.assemble import flights_of
from analysis.flights.classify import classify
from analysis.residuals.observations import Observations
from bench.jobs.blocks import Chosen, by_person
from bench.jobs.run_ramp import make_backend, record
from bench.live import watched_run
from bench.live.analyst import DOUBTFUL, PLAIN, Analyst, cut_to, predicted, reduce_run, verdict_of
from bench.live.board import EVENT_SLOTS, Board, RunSide
from bench.live.scope_data import SCOPE, MinMax, PlateHeight, flights_piece, scope_piece, spectrum_piece
from bench.profiles.find import load, shipped_folder
from bench.web.browsers import GONE_S, SILENT_S, Lease
from daq.files.tables import Block
from daq.recorder.shared_ring import Ring, RingReader
from daq.recording import open_recording
from rig.execution.operator import StopRequest
from rig.profile import parse_profile
from rig.programme.ramp import NextSteps
from rig.programme.sequencer import Stop


@pytest.fixture
def board() -> Iterator[Board]:
    """A board of its own."""
    one = Board()
    yield one
    one.close()


def test_messages_come_in_order_and_once(board: Board) -> None:
    """What one side puts, the other reads once, in order; both lanes are apart."""
    other = Board(board.name)
    assert other.events.read() == ([], 0)
    for i in range(5):
        assert board.events.put({"kind": "x", "i": i, "text": "\u0393 \u2265 1"})
    other.commands.put({"do": "now"})
    messages, missed = other.events.read()
    assert [m["i"] for m in messages] == list(range(5)) and missed == 0 and messages[0]["text"] == "\u0393 \u2265 1"
    assert other.events.read() == ([], 0)
    assert board.commands.read()[0] == [{"do": "now"}]
    other.close()


def test_writer_never_waits_and_the_reader_is_told_what_it_missed(board: Board) -> None:
    """A reader that slept gets the newest messages and their number is right; a message too long is left out."""
    other = Board(board.name)
    for i in range(3 * EVENT_SLOTS):
        board.events.put({"i": i})
    messages, missed = other.events.read()
    assert messages[-1]["i"] == 3 * EVENT_SLOTS - 1 and missed + len(messages) == 3 * EVENT_SLOTS
    assert not board.events.put({"text": "x" * 10_000})
    other.close()


@settings(max_examples=40, deadline=None)
@given(n_bin=st.integers(1, 9), cuts=st.lists(st.integers(0, 120), max_size=6))
def test_no_extreme_is_lost_whatever_the_pieces(n_bin: int, cuts: list[int]) -> None:
    """Minima and maxima of each bin are those of all its samples, in whatever pieces they come."""
    codes = np.random.default_rng(1).integers(-32768, 32767, (120, 3)).astype(np.int16)
    minmax, edges = MinMax(n_bin, 3), [0, *sorted(cuts), 120]
    found = np.concatenate([minmax.add(codes[a:b]) for a, b in itertools.pairwise(edges)])
    whole = codes[: len(codes) // n_bin * n_bin].reshape(-1, n_bin, 3)
    assert np.array_equal(found, np.stack([whole.min(axis=1), whole.max(axis=1)], axis=1))


def test_plate_height_is_the_motion() -> None:
    """Twice integrated, a sine of 20 m/s^2 at 25 Hz is one of its displacement, within a part in a hundred."""
    rate, hz, a = 20_000.0, 25.0, 20.0
    t = np.arange(60_000) / rate
    scale, least = 0.003, 1e-7
    codes = np.round(a * np.sin(2 * np.pi * hz * t) / scale).astype(np.int16)
    height = PlateHeight(rate, hz, scale, least)
    x = np.concatenate([height.add(piece) for piece in np.array_split(codes, 50)])[-8000:] * least
    assert np.ptp(x) / 2 == pytest.approx(a / (2 * np.pi * hz) ** 2, rel=0.05)


def test_reader_of_the_ring_takes_nothing() -> None:
    """A third process reads every block; the recorder's own blocks are all still there, and nothing can be written."""
    ring = Ring(8, 10, 2)
    reader = RingReader(ring.slots, 10, 2, ring.name)
    sent = [Block(10 * i, np.full((10, 2), i, np.int16)) for i in range(5)]
    for block in sent:
        ring.put(block)
    assert [int(b.codes[0, 0]) for b in reader.read()] == list(range(5)) and reader.read() == []
    assert ring.backlog == 5 and len(ring.take()) == 5
    with pytest.raises(ValueError, match="read-only"):
        reader.set_counter("taken", 0)
    for i in range(30):
        ring.put(Block(50 + 10 * i, np.full((10, 2), i, np.int16)))
        ring.take()
    late = reader.read()
    assert [b.first_sample for b in late] == sorted(b.first_sample for b in late) and len(late) <= 7
    reader.close()
    ring.close()


def test_one_browser_holds_the_controls() -> None:
    """The first holds; another gets them when the holder hands over, is gone for a while, or does not answer."""
    lease = Lease()
    lease.ask("a", 0.0)
    lease.ask("b", 0.0)
    assert lease.may("a") and not lease.may("b") and lease.asked_by == "b"
    lease.keep("a")
    lease.hand_over("b")
    assert lease.may("a") and lease.asked_by is None
    lease.ask("b", 1.0)
    lease.hand_over("a")
    assert lease.may("b") and not lease.may("a")
    lease.left("b", 2.0)
    lease.came("b")
    assert not lease.pass_time(2.0 + GONE_S + 1.0) and lease.may("b")  # it loaded the page again
    lease.ask("a", 20.0)
    assert not lease.pass_time(20.0 + SILENT_S - 1.0) and lease.pass_time(20.0 + SILENT_S + 1.0) and lease.may("a")
    lease.left("a", 50.0)
    assert lease.pass_time(50.0 + GONE_S + 0.1) and lease.holder is None


def test_commands_become_requests(board: Board) -> None:
    """Stops, pause, going on and notes become requests; the strongest stop stands, nonsense does not."""
    request, other = StopRequest(), Board(board.name)
    side = RunSide(board)
    side._request = request
    notes = [{"do": "note", "text": text} for text in (" dusty ", " ")]
    for command in [{"do": "pause"}, *notes, {"do": "format c:"}, {"do": "ramp_down"}, {"do": "finish"}]:
        side._obey(command)
    assert request.pause and request.notes == ["page: hold after this step", "dusty"]
    assert request.wanted is Stop.RAMP_DOWN
    side._obey({"do": "go_on"})
    side._obey({"do": "now"})
    assert not request.pause and request.wanted is Stop.NOW and request.why == "page: stopped now"
    assert [m["do"] for m in other.events.read()[0]] == ["pause", "note", "ramp_down", "finish", "go_on", "now"]
    other.close()


def test_steps_typed_on_the_page_are_next_or_refused(board: Board) -> None:
    """A person's gammas become the next steps with their reason; what cannot be driven is said on the page."""
    text = load("simulated")[1]
    request, other = StopRequest(partial(by_person, Chosen(text, 1.0, ""))), Board(board.name)
    side = RunSide(board)
    side._request = request
    side._obey({"do": "next", "text": "0.8, 99"})
    assert request.wanted is None
    side._obey({"do": "next", "text": "0.8, 1.2: a closer look"})
    assert request.then == NextSteps((0.8, 1.2), None, "a closer look") and request.wanted is Stop.FINISH_STEP
    refused, taken = other.events.read()[0]
    assert refused["do"] == "refused" and "limits forbid" in refused["text"] and taken["do"] == "next"
    other.close()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Ramps of four steps on the simulated rig: an ideal one, and one with friction."""
    text = (shipped_folder() / "simulated.toml").read_text(encoding="utf-8")
    text = text.replace("{ start = 0.4, stop = 2.6, steps = 23 }", "[0.8, 1.2, 1.6, 2.2]")
    profile, folder = parse_profile(text, "four.toml"), tmp_path_factory.mktemp("runs")
    out = {}
    for name in ("ideal", "friction"):
        out[name] = folder / f"{name}.h5"
        record(profile, text, make_backend(profile, scenario=Path(name)), out[name], quiet=True)
    return out


def so_far(path: Path, n_steps: int) -> tuple[list[dict[str, Any]], Observations]:
    """The first steps of a recording as a page reduces them while the run lasts."""
    with open_recording(path) as recording:
        row = recording.steps[n_steps - 1]
        cut_to(recording, int(row["first_sample"] + row["n_samples"]))
        return reduce_run(recording, {})


def test_step_is_reduced_as_the_analysis_does_it(recorded: dict[str, Path]) -> None:
    """Cycle, tones on target, and residuals of the ideal ball at its noise; the prediction meets the flights."""
    steps, _ = so_far(recorded["ideal"], 4)
    assert [s["label"] for s in steps][:2] == ["1-cycle", "1-cycle"]
    for step in steps:
        (tone,), (_, _, residual_s, noise_s, _) = step["tones"], step["columns"]
        assert tone["mps2"] == pytest.approx(tone["target_mps2"], rel=0.01)
        assert tone["deg"] == pytest.approx(tone["target_deg"], abs=0.5)
        compared = np.isfinite(residual_s)
        assert compared.sum() > 5 and np.median(np.abs(residual_s[compared])) < 3 * np.median(noise_s[compared])
    setup = load("simulated")[0]
    portions = list(predicted(setup, (0.8, 2.2)))
    assert portions[-1]["part"] == 1.0
    gamma, tau = (np.concatenate([p[key] for p in portions]) for key in ("gamma", "tau_ms"))
    near = tau[np.abs(gamma - 2.4) < 0.02]  # gamma_peak of the second step
    duration_s, *_, mark = steps[1]["columns"]
    measured = 1e3 * np.median(duration_s[mark == PLAIN])
    assert np.min(np.abs(near - measured)) < 0.3


class Sent(list[dict[str, Any]]):
    """A pipe that keeps what is sent."""

    send = list.append


def test_page_ends_with_the_flights_of_the_file(board: Board, tmp_path: Path) -> None:
    """A page that is four steps behind shows at the end the flights, classes and residuals that `reprocess` finds."""
    text = load("simulated")[1].replace("{ start = 0.4, stop = 2.6, steps = 23 }", "[0.8, 1.2, 1.6, 2.0, 2.2, 2.4]")
    profile, path, sent, watching = parse_profile(text, "six.toml"), tmp_path / "six.h5", Sent(), Board(board.name)
    analyst_board = Board(board.name)
    analyst = Analyst(profile, analyst_board, sent, pictures=True)
    options = {"quiet": True, "paced": True, "onlooker": RunSide(board)}
    run = Thread(target=record, args=(profile, text, make_backend(profile), path), kwargs=options)
    run.start()
    marks = 0
    while run.is_alive() and marks < 9:  # as the fifth step begins
        marks += sum(event["kind"] == "step" for event in watching.events.read()[0])
    analyst.look()
    run.join()
    while not analyst.done:
        analyst.look()
    shown = {message["step"]: message for message in sent if message["kind"] == "flights"}
    verdicts = [message for message in sent if message["kind"] == "verdict"]
    with open_recording(path) as recording:
        flights, labels = flights_of(recording), [one.label for one in classify(flights_of(recording))]
        first_s = recording.steps["first_sample"] / recording.rate_hz
    assert sorted(shown) == list(range(6)) and all(message["final"] for message in shown.values())
    for k, message in shown.items():
        duration_s, landing_s, residual_s, noise_s, mark = message["columns"]
        own = flights.step == k
        assert np.array_equal(duration_s, flights.duration_s[own])
        assert np.allclose(landing_s, flights.landing_s[own] - first_s[k], rtol=0, atol=1e-12)
        assert message["label"] == labels[k]
        assert np.isfinite(residual_s).sum() > 5 and np.nanmedian(noise_s) < 5e-5
        assert set(mark[np.isfinite(residual_s)]) <= {PLAIN, DOUBTFUL}
    assert verdicts[-1]["step"] == 5 and verdicts[-1]["within"]
    analyst_board.close()
    watching.close()


def test_verdict_while_it_runs(recorded: dict[str, Path]) -> None:
    """An ideal ball is within noise; friction that was not declared is more, and friction is among its candidates."""
    for n in range(1, 5):
        assert verdict_of(so_far(recorded["ideal"], n)[1], n - 1, n, ())["within"]
    verdict = verdict_of(so_far(recorded["friction"], 3)[1], 2, 3, (2.2,))
    assert not verdict["within"] and verdict["floor_us"] < 20
    assert any("friction" in one for one in verdict["candidates"])
    assert "by noise" in verdict["lines"][1]


def test_messages_are_what_the_page_unpacks() -> None:
    """Lengths and fields of the binary messages are those that the script reads."""
    bins = np.arange(24, dtype=np.int16).reshape(3, 2, 4)
    piece = scope_piece(1.5, 5e-5, bins)
    assert struct.unpack("<BBHIdd", piece[:24]) == (1, 4, 0, 3, 1.5, 5e-5) and len(piece) == 24 + 48
    columns = (np.array([0.03, 0.04]), np.array([0.1, 0.2]), np.array([1e-6, np.nan]), np.ones(2), np.zeros(2))
    message = {"columns": columns, "gamma": np.nan, "asked": 0.7, "final": True, "step": 3}
    piece = flights_piece(message, 2.0)
    kind, final, step, n, gamma = struct.unpack("<BBHIf", piece[:12])
    assert (kind, final, step, n) == (2, 1, 3, 2) and gamma == pytest.approx(1.4) and len(piece) == 16 + 2 * 17
    assert np.frombuffer(piece, "<f4", 2, 16).tolist() == pytest.approx([30.0, 40.0])
    t = np.arange(8192) / 20_000.0
    piece = spectrum_piece(20_000.0, np.sin(2 * np.pi * 1000.0 * t))
    n = struct.unpack("<I", piece[4:8])[0]
    hz, density = np.frombuffer(piece, "<f4", n, 8), np.frombuffer(piece, "<f4", n, 8 + 4 * n)
    assert hz[np.argmax(density)] == pytest.approx(1000.0, rel=0.05)


def test_a_scope_gets_frames_at_every_tick_though_they_come_in_bursts(
    board: Board, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Six blocks at once every 59 ms: each of the ticks, 50 ms apart, sends a piece, and all pieces are the frames."""
    pipe = SimpleNamespace(poll=lambda: False, close=lambda: None)
    gone = SimpleNamespace(terminate=lambda: None, join=lambda _: None)
    monkeypatch.setattr(watched_run, "spawned", lambda *_, **__: (pipe, gone))
    pieces: list[bytes] = []
    profile = load("simulated")[0]
    watch = watched_run.WatchedRun(profile, board, lambda m, **_: pieces.append(m) if isinstance(m, bytes) else None)
    ring = Ring(256, 197, 3)
    names = ["continuity", "accelerometer", "drive"]
    event = {"kind": "run", "out": "a.h5", "channels": names, "scales": dict.fromkeys(names, (1e-3, 0.0))}
    board.events.put(event | {"ring": [ring.slots, 197, 3, ring.name]})
    codes = np.random.default_rng(3).integers(-9999, 9999, (197 * 6 * 90, 3)).astype(np.int16)
    sent = 0
    for tick in range(100):
        while sent * 197 / 20_000 + 0.059 < tick * 0.05:  # handed over, six together
            for _ in range(6):
                ring.put(Block(197 * sent, codes[197 * sent : 197 * (sent + 1)]))
                ring.take()
                sent += 1
        before = len(pieces)
        watch.tick()
        assert tick < 3 or [one[0] for one in pieces[before:]].count(SCOPE) == 1
    for _ in range(8):
        watch.tick()
    bins = [np.frombuffer(one[24:], "<i2").reshape(-1, 2, 4) for one in pieces if one[0] == SCOPE]
    shown = np.concatenate(bins)
    assert np.array_equal(shown[:, 0, :3], codes[: len(shown)]) and len(shown) == 197 * sent
    firsts = [struct.unpack_from("<d", one, 8)[0] for one in pieces if one[0] == SCOPE]
    assert np.allclose(np.diff(firsts) * 20_000, [len(one) for one in bins[:-1]])
    watch.close()
    ring.close()
