"""Flights behind instruments as laboratories have them: all that were flown, and none that was not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import resample_poly

from analysis.flights.assemble import FlightFlag, Flights, assemble, flights_of
from analysis.flights.scan import scan
from daq.files.tables import Block
from daq.instrument.instrument import instrument_of
from daq.recording import open_recording
from daq.recording.writer import RecordingWriter
from daq.setup.setup import Setup

GAMMAS = np.linspace(1.2, 2.4, 5)
FRICTION = {"coulomb_friction": {"mu_up": 0.1, "mu_down": 0.1}}
NEAR_S = 5e-4
CHAINS: dict[str, dict[str, float]] = {
    "low-pass 5 kHz, 1 pole": {"low_pass_hz": 5000.0, "low_pass_poles": 1.0},
    "low-pass 5 kHz, 2 poles": {"low_pass_hz": 5000.0},
    "low-pass 5 kHz, 4 poles": {"low_pass_hz": 5000.0, "low_pass_poles": 4.0},
    "low-pass 3 kHz, 4 poles": {"low_pass_hz": 3000.0, "low_pass_poles": 4.0},
    "low-pass 1 kHz, 2 poles": {"low_pass_hz": 1000.0},
    "1/f noise": {"flicker_v": 0.002},
    "sigma-delta, accelerometer only": {"fir_samples": 38.0, "fir_accelerometer_only": 1.0},
    "multiplexed": {"between_channels_s": 1e-5},
}


def landings(flights: Flights) -> np.ndarray:
    """Landings of all flights but cut and false ones."""
    return np.sort(flights.landing_s[~flights.has(FlightFlag.FALSE | FlightFlag.CUT)])


def strangers(times: np.ndarray, others: np.ndarray) -> list[float]:
    """The times that have no other one near."""
    return times[np.abs(times[:, None] - others).min(axis=1) > NEAR_S].tolist()


def read(path: Path) -> Flights:
    """All flights of a recording."""
    with open_recording(path) as recording:
        return flights_of(recording)


def written(path: Path, setup: Setup, codes: dict[str, np.ndarray], steps: np.ndarray) -> Path:
    """A recording of these codes."""
    writer = RecordingWriter(path, setup, profile_text="", channels=list(codes), backend="simulated", simulated=True)
    writer.append(Block(0, np.rint(np.column_stack(list(codes.values()))).clip(-32768, 32767).astype(np.int16)))
    for row in steps:
        writer.mark_step(row)
    writer.close()
    return path


@pytest.fixture(scope="module")
def true_landings(make) -> np.ndarray:
    """What happened, behind no instrument: the same at every noise."""
    return np.asarray(make(GAMMAS, effects=FRICTION, truth=True).landing_s)


@pytest.fixture(scope="module")
def plain_landings(make) -> np.ndarray:
    """What is found behind white noise, no filter, no bias."""
    return landings(read(make(GAMMAS, effects=FRICTION).path))


@pytest.mark.parametrize("chain", CHAINS)
def test_an_instrument_neither_hides_flights_nor_makes_them(
    make, true_landings: np.ndarray, plain_landings: np.ndarray, chain: str
) -> None:
    """Each landing is found, many of them launched again unseen by the contact circuit, and none is made up."""
    flights = read(make(GAMMAS, effects=FRICTION, rig=CHAINS[chain]).path)
    assert strangers(landings(flights), true_landings) == []
    assert strangers(plain_landings, landings(flights)) == []
    assert flights.has(FlightFlag.ACCELEROMETER).sum() > 20


def test_where_a_ball_bounces_take_offs_tell_the_delay(make) -> None:
    """Behind a converter that delays the accelerometer alone, the circuit closes after bounces that nobody hears."""
    made = {"gammas": np.linspace(0.7, 1.4, 8), "effects": {"restitution": {"e0": 0.16}}, "ratio": 2}
    truth = np.asarray(make(**made, truth=True).landing_s)
    found = landings(read(make(**made, rig={"fir_samples": 32.0, "fir_accelerometer_only": 1.0}).path))
    assert len(found) > 200 and strangers(found, truth) == []


def test_a_recording_that_others_resampled_holds_the_same_flights(
    make, true_landings: np.ndarray, plain_landings: np.ndarray, tmp_path: Path
) -> None:
    """Polyphase resampling to 48 kHz rings around every edge of the contact: no edge is lost, no contact made up."""
    with open_recording(make(GAMMAS, effects=FRICTION).path) as recording:
        setup, channels, steps = recording.setup, list(recording.channels), recording.steps.copy()
        codes = [resample_poly(recording.codes(name, 0, recording.n_samples), 12, 5) for name in channels]
    setup = setup.model_copy(update={"sampling": setup.sampling.model_copy(update={"rate_hz": 48000.0})})
    for name in ("first_sample", "n_samples", "settle_samples", "fade_samples"):
        steps[name] = steps[name] * 12 // 5
    flights = read(written(tmp_path / "resampled.h5", setup, dict(zip(channels, codes, strict=True)), steps))
    assert strangers(landings(flights), true_landings) == []
    assert strangers(plain_landings, landings(flights)) == []


@pytest.mark.parametrize("own_hz", [10_000, 6250])
def test_an_accelerometer_slower_than_the_recording_shows_the_same_flights(
    make, true_landings: np.ndarray, plain_landings: np.ndarray, tmp_path: Path, own_hz: int
) -> None:
    """Its readings are held until the next one, and the steps of that stair are no impacts."""
    chain = {"low_pass_hz": 0.4 * own_hz, "low_pass_poles": 4.0}
    with open_recording(make(GAMMAS, effects=FRICTION, rig=chain).path) as recording:
        codes = {name: recording.codes(name, 0, recording.n_samples) for name in recording.channels}
        each, setup, steps = recording.rate_hz / own_hz, recording.setup, recording.steps.copy()
    codes["accelerometer"] = codes["accelerometer"][
        (np.arange(codes["accelerometer"].size) // each * each).astype(np.int64)
    ]
    path = written(tmp_path / "held.h5", setup, codes, steps)
    found = landings(read(path))
    assert strangers(found, true_landings) == []
    assert strangers(plain_landings, found) == []
    with open_recording(path) as recording:
        instrument = instrument_of(recording)
    assert instrument is not None
    assert f"stands for {each:.3g} samples" in next(d for d in instrument.doubts if d.kind == "resampled").finding


@pytest.mark.parametrize("step", [32, 64])
def test_an_accelerometer_of_eight_bits_shows_the_same_flights(make, tmp_path: Path, step: int) -> None:
    """Steps of .07 and .2 g of a motion rounded more coarsely than its noise are no impacts of a ball."""
    made = make(np.linspace(0.6, 0.95, 6), effects=FRICTION, rig={"accelerometer_noise_g": 0.005}, truth=True)
    with open_recording(made.path) as recording:
        codes = {name: recording.codes(name, 0, recording.n_samples) for name in recording.channels}
        setup, steps = recording.setup, recording.steps.copy()
    codes["accelerometer"] = np.round(codes["accelerometer"] / step) * step
    found = landings(read(written(tmp_path / "rounded.h5", setup, codes, steps)))
    assert strangers(found, np.asarray(made.landing_s)) == []
    assert len(found) > 60


def test_a_recording_that_ends_in_mid_flight_has_no_impact_at_its_end(make, tmp_path: Path) -> None:
    """Beyond the last sample the motion goes on at its last value: that corner is none, wherever in a cycle it is."""
    with open_recording(make(GAMMAS, effects=FRICTION, rig={"low_pass_hz": 500.0}).path) as recording:
        codes = {name: recording.codes(name, 0, recording.n_samples) for name in recording.channels}
        setup, steps, rate_hz = recording.setup, recording.steps.copy(), recording.rate_hz
    for i, end in enumerate(np.linspace(0.95, 1.0, 8) * recording.n_samples):
        cut = {name: own[: int(end)] for name, own in codes.items()}
        with open_recording(written(tmp_path / f"{i}.h5", setup, cut, steps)) as recording:
            impacts = scan(recording).impacts
        assert not np.any(impacts.time_s > end / rate_hz - 1.2e-3)


def test_a_contact_that_opens_once_more_after_a_landing_makes_no_flight(make, tmp_path: Path) -> None:
    """From .2 to .8 ms after each landing at which the ball comes to rest; no impact ends that."""
    with open_recording(make([0.9, 1.1, 1.3], effects=FRICTION).path) as recording:
        flights, rate_hz = flights_of(recording), recording.rate_hz
        codes = {name: recording.codes(name, 0, recording.n_samples) for name in recording.channels}
        setup, steps = recording.setup, recording.steps.copy()
    rests = np.append(flights.contact_s[1:], 0.0) > 5e-3
    at = np.rint(flights.landing_s[rests] * rate_hz).astype(int)[:, None]
    codes["continuity"][at + np.arange(round(2e-4 * rate_hz), round(8e-4 * rate_hz))] = codes["continuity"].max()
    chattering = read(written(tmp_path / "chatters.h5", setup, codes, steps))
    assert rests.sum() > 40
    assert landings(chattering) == pytest.approx(landings(flights), abs=1e-4)


def test_a_knock_in_mid_flight_cuts_no_flight_that_the_contact_circuit_shows(make) -> None:
    """Bursts like impacts while the ball is high above the plate: the contact circuit and the take-off deny them."""
    with open_recording(make([1.2, 1.3], effects=FRICTION).path) as recording:
        found = scan(recording)
        alone = assemble(found, recording)
        long = np.flatnonzero(alone.good() & (alone.duration_s > 0.015))
        knocks_s = alone.takeoff_s[long] + 0.5 * alone.duration_s[long]
        impacts = found.impacts
        order = np.argsort(np.append(impacts.time_s, knocks_s))
        knocked = replace(
            impacts,
            time_s=np.append(impacts.time_s, knocks_s)[order],
            uncertainty_s=np.append(impacts.uncertainty_s, np.full(len(long), 5e-6))[order],
            strength=np.append(impacts.strength, np.full(len(long), 100.0))[order],
        )
        flights = assemble(replace(found, impacts=knocked), recording)
    assert len(long) > 20
    assert landings(flights) == pytest.approx(landings(alone), abs=1e-6)
