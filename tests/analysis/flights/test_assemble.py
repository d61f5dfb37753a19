"""From a recording of the simulated rig to its flights: nearly all are found, at the right time, and marked."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from analysis.flights.assemble import FlightFlag, Flights, flights_of, write_csv
from analysis.statistics import nearest
from daq.recording import open_recording

RATE = 20000.0
RAMPS = {1: np.linspace(0.6, 2.6, 6), 2: np.linspace(0.25, 1.6, 5), 3: np.linspace(0.15, 0.9, 5)}


def read(path: Path) -> Flights:
    """All flights of a recording."""
    with open_recording(path) as recording:
        return flights_of(recording)


def found(flights: Flights, true: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which true flights are in the table with both ends within 1.5 samples, and the pulls of their ends."""
    kept = flights.select(~flights.has(FlightFlag.FALSE))
    row = nearest(kept.landing_s, true[:, 1])
    landing, takeoff = kept.landing_s[row] - true[:, 1], kept.takeoff_s[row] - true[:, 0]
    hit = (np.abs(landing) < 1.5 / RATE) & (np.abs(takeoff) < 1.5 / RATE)
    return hit, (landing / kept.landing_uncertainty_s[row])[hit], (takeoff / kept.takeoff_uncertainty_s[row])[hit]


@pytest.mark.parametrize("ratio", [1, 2, 3])
def test_nearly_all_true_flights_of_the_ideal_rig_are_found(make, ratio: int) -> None:
    """At least 98 % of all true flights, the instantly relaunched included, and errors as large as stated."""
    made = make(RAMPS[ratio], ratio=ratio, truth=True)
    flights, true = read(made.path), made.true_flights()
    hit, landing, takeoff = found(flights, true)
    assert true.shape[0] > 100
    assert hit.mean() >= 0.98
    assert (~flights.has(FlightFlag.FALSE)).sum() <= 1.02 * true.shape[0] + 1
    for pull in (landing, takeoff):
        assert np.sqrt(np.mean(pull**2)) == pytest.approx(1.0, abs=0.25)
    # a good part of them was invisible to the contact circuit
    assert flights.has(FlightFlag.ACCELEROMETER).mean() > 0.1


def test_without_impacts_in_the_accelerometer_nothing_breaks_and_hidden_landings_are_suspected(make) -> None:
    """An accelerometer that shows no impacts: relaunched flights merge, and the merged ones are marked as unsure."""
    made = make([1.9, 2.0, 2.1], truth=True, rig={"ring_g_s_per_m": 0.0})
    flights, true = read(made.path), made.true_flights()
    assert flights.edges.sensor_offset is None
    merged = [
        np.count_nonzero((true[:, 0] > a - 1e-4) & (true[:, 1] < b + 1e-4)) > 1
        for a, b in zip(flights.takeoff_s, flights.landing_s, strict=True)
    ]
    whole = ~flights.has(FlightFlag.CUT)
    assert np.sum(np.array(merged) & whole) > 5
    marked = flights.has(FlightFlag.UNSURE)
    assert marked[np.array(merged) & whole].mean() > 0.8
    assert not marked[~np.array(merged) & whole].any()


def test_contact_bounce_is_kept_and_marked(make) -> None:
    """A bouncing contact makes many openings; they stay in the table as false and the true landings survive."""
    made = make([0.8, 1.2, 1.5], truth=True, rig={"bounce_s": 1e-3})
    flights, true = read(made.path), made.true_flights()
    false = flights.has(FlightFlag.FALSE)
    assert false.sum() > 20
    assert flights.duration_s[false].max() < 4.1e-4
    row = nearest(flights.takeoff_s[~false], true[:, 0])
    assert np.mean(np.abs(flights.takeoff_s[~false][row] - true[:, 0]) < 1.5 / RATE) > 0.95


def test_a_late_contact_circuit_is_measured_against_the_accelerometer(make) -> None:
    """A circuit that reports both edges half a millisecond late: the two sensors differ by that."""
    made = make([0.8, 1.1, 1.4], effects={"contact_latency": {"delay_s": 5e-4}})
    offset = read(made.path).edges.sensor_offset
    assert offset is not None
    assert offset.offset_s == pytest.approx(-5e-4, abs=5e-6)


def test_an_elastic_ball_makes_double_hits_and_no_false_offset(make) -> None:
    """Rebounds within half a period are marked as double hits; a chatter's end is not taken for a slow circuit."""
    effects = {"coulomb_friction": {"mu_up": 0.3, "mu_down": 0.3}, "restitution": {"e0": 0.514}}
    flights = read(make([0.7, 0.9, 1.1], effects=effects).path)
    assert flights.has(FlightFlag.DOUBLE_HIT).sum() > 20
    offset = flights.edges.sensor_offset
    assert offset is not None
    assert abs(offset.offset_s) < 1e-4


def test_flights_know_their_step_and_what_cuts_them(make) -> None:
    """Steps, settling, and a flight across a change of step are marked; phases lie in [0, 2 pi)."""
    flights = read(make([0.8, 2.5], settle=4, hold=6).path)
    assert set(np.unique(flights.step)) == {0, 1}
    period = 1.0 / 25.37
    settled = flights.has(FlightFlag.SETTLING)
    expected = np.mod(flights.takeoff_s, 10 * period) < 4 * period
    assert np.mean(settled == expected) > 0.95
    assert np.all((flights.takeoff_phase >= 0.0) & (flights.takeoff_phase < 2 * np.pi))
    # the ball leaves a plate that falls away by g: a_p = -g at the first tone's phase asin(1 / gamma_peak)
    rest = flights.good() & (flights.step == 0)
    np.testing.assert_allclose(np.sin(flights.takeoff_phase[rest]), 1.0 / 1.6, atol=2e-3)


def test_the_table_is_written_for_others_to_read(make, tmp_path: Path) -> None:
    """The CSV has the named columns, one row a flight, flags by name."""
    flights = read(make([0.8, 1.4], settle=3, hold=5).path)
    out = tmp_path / "flights.csv"
    write_csv(flights, out)
    head, *rows = out.read_text(encoding="utf-8").splitlines()
    assert head == "takeoff_s,landing_s,duration_s,uncertainty_s,takeoff_phase,landing_phase,step,gamma,flags"
    assert len(rows) == len(flights)
    first = rows[0].split(",")
    assert float(first[2]) == pytest.approx(float(first[1]) - float(first[0]), abs=2e-9)
    assert any(row.endswith("SETTLING") for row in rows)
