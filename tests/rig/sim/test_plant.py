"""The simulated rig as a device: blocks, seeds, sensors, and every effect it can hide."""

from __future__ import annotations

import inspect
import math

import numpy as np
import pytest

from rig.sim.plant import Plant
from rig.sim.scenario import BEYOND, EFFECTS, Scenario

RATE_HZ = 20000.0
FREQUENCY_HZ = 25.37


def ramp_drive(seconds: float, top_v: float = 2.2) -> np.ndarray:
    """One sine whose amplitude grows to ``top_v`` over the run."""
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    return -np.sin(2.0 * math.pi * FREQUENCY_HZ * t) * top_v * t / seconds


def middle(name: str) -> dict[str, float]:
    """The middle of an effect's strong ranges."""
    return {p.name: 0.5 * sum(p.strong) for p in EFFECTS[name].parameters}


def record(scenario: Scenario, drive_v: np.ndarray, seed: int = 3) -> np.ndarray:
    """Codes of one run."""
    return Plant(scenario, RATE_HZ, np.random.default_rng(seed)).exchange(drive_v)


BUSY = Scenario(
    "busy",
    {
        name: middle(name)
        for name in ("coulomb_friction", "restitution", "table_resonance", "contact_closure", "contact_gap")
    },
    {"bounce_s": 5e-4, "shaker_frequency_hz": 5.0},
    {"coulomb_friction.mu_up": 0.1},
)


@pytest.mark.parametrize("scenario", [Scenario("ideal"), BUSY], ids=["ideal", "busy"])
def test_blocks_of_any_size_give_the_same_codes(scenario: Scenario) -> None:
    """One call, or blocks of 1 to 900 samples: bit for bit the same."""
    drive_v = ramp_drive(5.0)
    cuts = np.cumsum(np.random.default_rng(2).integers(1, 900, 400))
    plant = Plant(scenario, RATE_HZ, np.random.default_rng(3))
    pieces = [plant.exchange(piece) for piece in np.split(drive_v, cuts[cuts < drive_v.size])]
    assert np.array_equal(np.concatenate(pieces), record(scenario, drive_v))


def test_the_seed_decides_the_noise() -> None:
    """The same seed repeats the codes; another seed does not."""
    drive_v = ramp_drive(1.0)
    first = record(BUSY, drive_v)
    assert np.array_equal(first, record(BUSY, drive_v))
    assert not np.array_equal(first, record(BUSY, drive_v, seed=4))


@pytest.mark.parametrize("name", EFFECTS)
def test_each_effect_changes_the_data(name: str) -> None:
    """With the same seed the ideal rig repeats to the code, so what differs, edges and plate, is the effect's doing."""
    drive_v = ramp_drive(16.0)
    away = record(Scenario("one", {name: middle(name)}), drive_v).astype(int) - record(Scenario("none"), drive_v)
    away = np.abs(away)
    assert away[:, :2].max() > 30
    assert np.count_nonzero(away[:, :2].max(axis=1) > 3) > 20
    assert away[:, 2].max() == 0


def test_a_neutral_effect_changes_nothing() -> None:
    """Every effect present at its neutral values: the ideal rig to a code."""
    drive_v = ramp_drive(2.0, top_v=1.0)
    neutral = {n: {p.name: p.neutral for p in e.parameters if p.scales} for n, e in EFFECTS.items()}
    away = record(Scenario("neutral", neutral), drive_v).astype(int) - record(Scenario("none"), drive_v)
    assert np.abs(away[:, 1:]).max() <= 1
    assert np.count_nonzero(np.abs(away[:, 0]) > 1) <= 2


def test_at_least_eight_effects_lie_beyond_the_agreed_names_and_some_are_smooth_terms() -> None:
    """The agreed candidates are all there, and enough beyond them, of both kinds."""
    assert len(EFFECTS) - len(BEYOND) >= 22
    assert sum(bool(entry.covariate) for entry in BEYOND) >= 8
    assert sum(not entry.covariate for entry in BEYOND) >= 4


def test_a_drifting_parameter_grows_as_the_run_goes_on() -> None:
    """A hum that drifts up from nothing: the plate moves more at the end than at the start."""
    effects = {"mains_hum": {"amplitude_g": 0.0, "frequency_hz": 50.0, "phase_rad": 0.0}}
    drift = {"mains_hum.amplitude_g": 6.0}
    codes = record(Scenario("d", effects, {}, drift), np.zeros(200000))[:, 1].astype(float)
    early, late = np.std(codes[:40000]), np.std(codes[-40000:])
    assert late > 3.0 * early


def test_the_ideal_plate_follows_the_drive_within_five_parts_in_ten_thousand() -> None:
    """20, 40 and 120 Hz: 2 g per volt, without phase, in the plant's own books."""
    plant = Plant(Scenario("ideal"), RATE_HZ, np.random.default_rng(0))
    t = np.arange(40000) / RATE_HZ
    for frequency_hz in (20.0, 40.0, 120.0):
        volts = 0.4 * np.cos(2.0 * math.pi * frequency_hz * t)
        states = []
        for v in volts[:4000]:
            plant.exchange(np.array([v]))
            states.append(float(plant._state["node1"][0]))
        ratio = 2.0 * np.mean(np.array(states) * np.exp(-2j * math.pi * frequency_hz * t[:4000])) / (0.4 * 9.80665)
        assert abs(ratio / 2.0 - 1.0) < 5e-4


def test_an_edge_inside_a_sample_shows_in_the_voltage() -> None:
    """Edges fall anywhere between samples, and the RC lets the first voltage after each tell where."""
    codes = record(Scenario("ideal"), ramp_drive(20.0)[:200000])
    volts = codes[:, 0] * 10.0 / 32768.0
    between = (volts > 0.3) & (volts < 4.7)
    assert np.count_nonzero(between) > 100
    assert np.std(volts[between]) > 0.8


def test_a_ball_launched_again_as_it_lands_shows_only_in_the_accelerometer() -> None:
    """At gamma_peak 3.4 the locked ball relaunches at once: no contact is seen, but each impact rings."""
    t = np.arange(round(6.0 * RATE_HZ)) / RATE_HZ
    drive_v = -1.7 * np.sin(2.0 * math.pi * FREQUENCY_HZ * t) * np.minimum(t / 0.5, 1.0)
    codes = record(Scenario("ideal"), drive_v)[-40000:]
    assert np.min(codes[:, 0]) * 10.0 / 32768.0 > 4.5
    smooth = codes[:, 1].astype(float)
    spikes = np.abs(np.diff(smooth, 2)) > 200
    starts = np.flatnonzero(spikes & ~np.concatenate(([False], spikes[:-1])))
    bursts = 1 + np.count_nonzero(np.diff(starts) > 400)
    assert bursts == pytest.approx(2.0 * FREQUENCY_HZ, abs=1)


def test_contact_latency_delays_both_edges() -> None:
    """1.0 ms late: the continuity channel is the ideal one shifted by twenty samples, noise apart."""
    drive_v = ramp_drive(4.0)
    ideal = record(Scenario("ideal"), drive_v)[:, 0] > 8192
    late = record(Scenario("late", {"contact_latency": {"delay_s": 1e-3}}), drive_v)[:, 0] > 8192
    assert np.count_nonzero(late[20:] != ideal[:-20]) <= 2


def test_overload_clips_at_the_converters_range() -> None:
    """The accelerometer's reading stays within 16 bits however hard the plate is driven."""
    loud = Scenario("loud", {}, {"accelerometer_v_per_g": 1.0})
    codes = record(loud, ramp_drive(1.0, top_v=9.5))
    assert codes[:, 1].max() == 32767
    assert codes[:, 1].min() == -32768


def test_nothing_of_the_scenario_is_public_but_its_hash() -> None:
    """Names and values of the hidden effect appear nowhere among the plant's public attributes."""
    secret = Scenario("secret-name", {"adhesion": {"pull_g": 0.123456}}, nonce="n")
    plant = Plant(secret, RATE_HZ, np.random.default_rng(0))
    public = {k: v for k, v in inspect.getmembers(plant) if not k.startswith("_") and not callable(v)}
    assert set(public) == {"channels", "channel_scales", "rate_hz", "scenario_sha256"}
    for leak in ("adhesion", "pull_g", "0.123456", "secret-name"):
        assert leak not in repr(public)


@pytest.mark.parametrize("bad", [np.array([0.0, np.nan]), np.zeros((3, 2))])
def test_a_drive_that_is_no_drive_is_refused(bad: np.ndarray) -> None:
    """NaN or a second dimension: refused before the plant moves."""
    with pytest.raises(ValueError, match="finite volts"):
        Plant(Scenario("ideal"), RATE_HZ, np.random.default_rng(0)).exchange(bad)


def test_a_displacement_sensor_reads_the_height_and_changes_no_other_channel() -> None:
    """The fourth channel is at its zero in contact and above it in flight; the other three have the same codes."""
    time_s = np.arange(40000) / RATE_HZ
    drive_v = -1.2 * np.minimum(time_s, 1.0) * np.sin(2.0 * np.pi * 25.0 * time_s)
    asked = (), ("drive", "displacement", "of another rig")
    plants = [Plant(Scenario("ideal"), RATE_HZ, np.random.default_rng(4), further=names) for names in asked]
    three, four = (plant.exchange(drive_v) for plant in plants)
    assert plants[1].channels == (*plants[0].channels, "displacement")
    assert np.array_equal(three, four[:, :3])
    height_v, is_open = four[:, 3] * plants[1].channel_scales["displacement"], four[:, 0] > 8192
    assert is_open.any() and height_v[is_open].max() > 0.05
    assert np.abs(height_v[~is_open][:1000]).max() < 0.006
