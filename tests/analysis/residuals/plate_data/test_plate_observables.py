"""What effects say of the plate data, against a period of the bent wave and its Fourier series."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from analysis.residuals.plate_data.plate_observables import (
    CLOCK,
    GAIN,
    HUM,
    PHASE,
    SECOND,
    THIRD,
    PlateData,
    _instrument_rows,
    _wander,
    expected,
    share,
)
from model.effects.registry import effect

QUADRATIC, CUBIC = 0.004, -0.0015  # per g and per g^2
POINTS = 256


def _bent(first_g: float, others: dict[int, complex]) -> np.ndarray:
    """Complex amplitudes (of sines) of the bent plate's multiples, in g: index is the multiple."""
    x = 2 * np.pi * np.arange(POINTS) / POINTS
    a = first_g * (np.sin(x) + sum(np.imag(share * np.exp(1j * m * x)) for m, share in others.items()))
    return 2j * np.fft.fft(a + QUADRATIC * a**2 + CUBIC * a**3)[: POINTS // 2] / POINTS


def _data(kinds: list[int], multiples: list[int], others: dict[int, complex], first_g: float) -> PlateData:
    """Data of a drive whose further tones are ``others``, by multiple, over the first."""
    one = np.ones(len(kinds))
    whole = np.ones(len(kinds), dtype=np.int64)
    m = np.array(multiples, dtype=np.int64)
    return PlateData(
        np.array(kinds, dtype=np.int64),
        0 * whole,
        0 * one,
        one,
        159.4 * m,
        first_g * one,
        9.8 * first_g * one,
        m,
        np.tile(list(others), (len(kinds), 1)),
        np.tile(np.array(list(others.values()), dtype=complex), (len(kinds), 1)),
        0j * one,
    )


BEND = {"harmonic_distortion": {
    "second": np.zeros(1), "third": np.zeros(1), "phase_rad": np.zeros(1),
    "quadratic_per_g": np.array([QUADRATIC]), "cubic_per_g2": np.array([CUBIC]),
}}  # fmt: skip


def test_a_harmonic_is_a_part_of_the_first_tone_as_it_is() -> None:
    """Where a bend makes the first tone smaller, too, the harmonics are a larger part of it."""
    said = expected(_data([GAIN, SECOND, THIRD], [1, 2, 3], {}, 5.0), BEND)
    true = _bent(5.0, {})
    assert said[0] == pytest.approx(np.log(abs(true[1]) / 5.0), rel=1e-9)
    assert said[1:] == pytest.approx(np.abs(true[2:4] / true[1]) ** 2, rel=1e-9)


@pytest.mark.parametrize("share", [4.0 + 0j, -4.0 + 0j, 2.0 - 3.0j])
def test_two_tones_bend_with_the_phase_between_them(share: complex) -> None:
    """Gain and phase of both tones and the third harmonic, whatever the phase of the second tone."""
    said = expected(_data([GAIN, PHASE, GAIN, PHASE, THIRD], [1, 1, 2, 2, 3], {2: share}, 1.2), BEND)
    true = _bent(1.2, {2: share})
    one, two = np.log(true[1] / 1.2), np.log(true[2] / 1.2 / share)
    assert said[:4] == pytest.approx([one.real, one.imag, two.real, two.imag], rel=1e-9, abs=1e-12)
    assert said[4] == pytest.approx(abs(true[3] / true[1]) ** 2, rel=1e-9)


@pytest.mark.parametrize("others", [{}, {2: -4.0 + 0j}, {3: 9.0j}, {2: -4.0 + 0j, 3: 4.5j}])
def test_compression_goes_with_the_mean_square_of_all_that_is_asked_for(others: dict[int, complex]) -> None:
    """All tones, one to three, lose the same part, by the squares of all amplitudes."""
    values = {"gain_compression": {"per_g2": np.array([1e-3])}}
    said = expected(_data([GAIN, GAIN], [1, max(others, default=1)], others, 1.2), values)
    squares = 1.2**2 * (1.0 + sum(abs(share) ** 2 for share in others.values()))
    assert said == pytest.approx([-np.log1p(1e-3 * squares)] * 2, rel=1e-9)


def test_three_tones_bend_as_their_sum_does() -> None:
    """Gain and phase of each of three tones, as the bent wave's own spectrum has them."""
    others = {2: -4.0 + 0j, 3: 3.0 + 3.0j}
    said = expected(_data([GAIN, PHASE] * 3, [1, 1, 2, 2, 3, 3], others, 0.8), BEND)
    true = _bent(0.8, others)
    logs = [np.log(true[m] / 0.8 / share) for m, share in {1: 1.0, **others}.items()]
    assert said == pytest.approx([part for x in logs for part in (x.real, x.imag)], rel=1e-9, abs=1e-12)


def test_filters_of_first_and_second_order_pass_what_they_should() -> None:
    """A first-order roll-off, a shaker above its resonance, and nothing where nothing is set."""
    transfer = effect("phase_lag").hooks["transfer"]
    absent = effect("phase_lag").effect.null_values
    omega, accel_g = np.array([0.0, 159.4, 318.8]), np.ones(3)
    assert transfer(absent, omega, accel_g) == pytest.approx(np.ones(3))
    low = transfer({**absent, "low_pass_s": 1e-3, "sharpness": 0.0}, omega, accel_g)
    assert low == pytest.approx(1.0 / (1.0 + 1e-3j * omega))
    damping, own_hz = 0.4, 3.0
    high = transfer({**absent, "high_pass_hz": 2.0 * damping * own_hz, "sharpness": 0.25 / damping**2}, omega, accel_g)
    s, own = 1j * omega[1:], 2.0 * np.pi * own_hz
    assert high[1:] == pytest.approx(s**2 / (s**2 + 2.0 * damping * own * s + own**2))


@pytest.mark.parametrize(("uncertainty_hz", "data"), [(1e-4, 1), (np.inf, 0), (0.0, 0)])
def test_a_frequency_that_is_not_known_says_nothing_of_the_clock(uncertainty_hz: float, data: int) -> None:
    """A step whose frequency could not be fitted has no clock datum: an infinite uncertainty spoils every fit."""
    step = SimpleNamespace(
        flight_log_gain=None, frequency_hz=25.0, frequency_uncertainty_hz=uncertainty_hz, omega_radps=157.0
    )
    channel = SimpleNamespace(coupling="ac", offset_v=None)
    setup = SimpleNamespace(channels=SimpleNamespace(accelerometer=channel), forcing=SimpleNamespace(frequency_hz=25.0))
    rows = _instrument_rows(0, step, setup, 1.0, 9.8)  # type: ignore[arg-type]
    assert [row[0] for row in rows] == [CLOCK] * data


def test_what_an_accelerometer_shows_late_is_in_gain_and_phase() -> None:
    """A low-pass of first order and of second order, at two tones, against the textbook's transfer function."""
    data = _data([GAIN, PHASE, GAIN, PHASE], [1, 1, 2, 2], {2: 1.0}, 1.0)
    for sharpness in (0.0, 0.25):
        values = {"delay_s": 0.0, "low_pass_s": 1e-3, "sharpness": sharpness}
        low = 1j * data.omega_radps * 1e-3
        shown = 1.0 / (1.0 + low + sharpness * low**2)
        found = expected(data, {"accelerometer_lag": {k: np.array([x]) for k, x in values.items()}})
        assert found == pytest.approx(np.where(data.kind == GAIN, np.log(np.abs(shown)), np.angle(shown)))


def test_a_high_pass_leads_and_tones_that_are_absent_pass_it() -> None:
    """Gain and phase of a first-order high-pass at two tones; a tone of frequency 0 stands for none."""
    data = _data([GAIN, PHASE, GAIN, PHASE], [1, 1, 2, 2], {2: 1.0}, 1.0)
    corner = 1j * 2.0 * np.pi * 3.0
    shown = data.omega_radps / (data.omega_radps - corner)
    found = expected(data, {"accelerometer_high_pass": {"corner_hz": np.array([3.0])}})
    assert found == pytest.approx(np.where(data.kind == GAIN, np.log(np.abs(shown)), np.angle(shown)))
    assert effect("accelerometer_high_pass").hooks["accelerometer_response"]({"corner_hz": 3.0}, np.zeros(1)) == 1.0


def test_a_zero_that_wanders_is_told_from_one_that_is_off_or_drifts() -> None:
    """Noise about any line is no wander; a random walk is one, of about its own scatter."""
    rng, sample = np.random.default_rng(5), 16000 * np.arange(22)
    sigma = np.full(22, 1e-3)
    noise = sigma * rng.standard_normal(22)
    for line in (0.0, 0.3, 1e-5 * sample):
        assert _wander(sample, line + noise, sigma) == 0.0
    walk = 0.02 * np.cumsum(rng.standard_normal(22))
    about = walk - np.polynomial.Polynomial.fit(sample, walk, 1)(sample)
    assert _wander(sample, walk + noise, sigma) == pytest.approx(np.sqrt(np.sum(about**2) / 20), rel=0.1)
    assert _wander(sample[:2], walk[:2], sigma[:2]) == 0.0


@pytest.mark.parametrize("name, values", [
    ("phase_lag", {"delay_s": 2e-5}), ("accelerometer_lag", {"delay_s": 3e-5}), ("gain_compression", {"per_g2": 1e-4}),
    ("harmonic_distortion", {"quadratic_per_g": QUADRATIC, "cubic_per_g2": CUBIC}),
    ("mains_hum", {"amplitude_mps2": 0.02}),
])  # fmt: skip
def test_an_effect_that_stays_the_same_is_its_share_of_every_step(name: str, values: dict[str, float]) -> None:
    """What changes from step to step is, in each step, what it would be if it stayed as it is there."""
    kinds = [GAIN, PHASE, SECOND, THIRD, HUM]
    one = _data(kinds, [1, 1, 2, 3, 1], {}, 4.0)
    two = PlateData.join([one, one], np.array([0, 1]))
    entry = effect(name).effect
    sides = [entry.null_values | {q: v * by for q, v in values.items()} for by in (1.0, 2.5)]
    table = {q: np.array([side[q] for side in sides]) for q in entry.null_values}
    apart = np.concatenate([share(one, name, side) for side in sides])
    assert np.any(apart)
    assert expected(two, {name: table}) == pytest.approx(apart, rel=1e-12)
