"""Flights with effects, one event ahead: each force by an eighth-order integration, the plate mode by a fine march."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numba import njit
from scipy.integrate import solve_ivp

from model.effects.harmonic_distortion import harmonics
from model.effects.registry import effect, row
from model.integrator.one_step import law_of, one_ahead, simulate
from model.integrator.problem import Detection, Measured, PlateSteps
from model.tones import Plate

G_MPS2 = 9.80665
OMEGA_RADPS = 2.0 * math.pi * 25.0
PERIOD_S = 2.0 * math.pi / OMEGA_RADPS


def steps_of(*tones: complex) -> PlateSteps:
    """One step whose plate moves with ``tones`` at multiples of 25 Hz, m/s^2."""
    k = np.arange(1, len(tones) + 1)
    return PlateSteps(OMEGA_RADPS * k[None, :], np.array([tones], dtype=complex), np.array([PERIOD_S]))


def events(opening_s: np.ndarray, landing_s: np.ndarray) -> Measured:
    """Measured flights, each after a rest, one after the other."""
    n = len(opening_s)
    first = np.arange(n) == 0
    return Measured(opening_s, landing_s, np.zeros(n, bool), ~first, np.zeros(n, np.int64), ~first)


def accelerations(effect: str, p: dict[str, float], s: float, h: float, v: float, u: float) -> float:
    """Textbook acceleration of the ball in free flight besides gravity, m/s^2."""
    match effect:
        case "viscous_damping":
            return -p["rate_per_s"] * v
        case "quadratic_drag":
            return -p["k_per_m"] * abs(u) * u
        case "position_force":
            return -p["spring_per_s2"] * h
        case "coulomb_friction":
            return -G_MPS2 * (p["mu_up"] if v > 0 else -p["mu_down"])
        case "local_gravity":
            return -p["excess_mps2"]
    raise AssertionError(effect)


@pytest.mark.parametrize(
    ("effect", "p"),
    [
        ("viscous_damping", {"rate_per_s": 3.0}),
        ("quadratic_drag", {"k_per_m": 20.0}),
        ("position_force", {"spring_per_s2": 300.0}),
        ("coulomb_friction", {"mu_up": 0.2, "mu_down": 0.15}),
        ("local_gravity", {"excess_mps2": 0.4}),
    ],
)
def test_a_flight_with_one_force_lands_where_a_fine_integration_says(effect, p):
    """Take-off from rest, flight and landing agree with an eighth-order integration to 50 nanoseconds."""
    gamma, steps = 2.1, steps_of(2.1 * G_MPS2)  # a(t) = gamma g cos(w t)
    hold = accelerations(effect, p, 0.0, 0.0, 1e-9, 0.0) if effect in ("coulomb_friction", "local_gravity") else 0.0
    start_s = math.acos(-(G_MPS2 - hold) / (gamma * G_MPS2)) / OMEGA_RADPS
    if effect in ("viscous_damping", "quadratic_drag"):  # the ball moves with the plate, the rod and the air do not
        start_s = None

    def plate_speed(t):
        return gamma * G_MPS2 * math.sin(OMEGA_RADPS * t) / OMEGA_RADPS

    found = one_ahead(events(np.array([0.0, 0.02]), np.array([0.002, 0.06])), steps, row({effect: p}, G_MPS2))
    takeoff_s = float(found.takeoff_s[1])
    if start_s is not None:
        assert takeoff_s == pytest.approx(start_s, abs=1e-9)

    def rate(t, y):
        h, v = y
        u = v + plate_speed(t)
        plate = gamma * G_MPS2 * math.cos(OMEGA_RADPS * t)
        return [v, -G_MPS2 - plate + accelerations(effect, p, t - takeoff_s, h, v, u)]

    def lands(t, y):
        return y[0] if t > takeoff_s + 1e-3 else 1.0

    def turns(t, y):
        return y[1] if t > takeoff_s + 1e-3 else 1.0

    lands.terminal = turns.terminal = True  # friction changes its sign where the ball turns: go on from there
    t, y = takeoff_s, [0.0, 1e-13]
    for event in (turns, lands):
        run = solve_ivp(rate, (t, takeoff_s + 0.2), y, method="DOP853", rtol=1e-12, atol=1e-15, events=event)
        t, y = float(run.t_events[0][0]), [float(run.y_events[0][0][0]), -1e-13]
    assert found.landing_s[1] == pytest.approx(t, abs=5e-8)


def fall_with_friction(plate, takeoff_s, mu_up, mu_down, dt):
    """Landing of a ball left at rest, by small steps: the time, and how long each motion up or down lasted."""
    t, h, v, direction, turned_s, lasted = takeoff_s, 0.0, 0.0, 1.0, takeoff_s, []
    middle = np.arange(takeoff_s, takeoff_s + 2.0 * PERIOD_S, dt) + 0.5 * dt
    for free in -G_MPS2 - plate.acceleration_at(middle):
        if v == 0.0:
            direction = 1.0 if free > mu_up * G_MPS2 else -1.0
        a = free - direction * G_MPS2 * (mu_up if direction > 0.0 else mu_down)
        if direction * (v + a * dt) < 0.0:
            lasted.append(t - turned_s)
            h, v, turned_s = h - 0.5 * v * v / a, 0.0, t
        else:
            h, v = h + v * dt + 0.5 * a * dt * dt, v + a * dt
        t += dt
        if h < 0.0 and v < 0.0:
            return t - h / v, lasted
    raise AssertionError("it never lands")


def test_a_short_rise_in_mid_air_feels_the_friction_of_a_rise():
    """c = 3 under friction: a ball that rises for a fraction of a step within its fall lands when it should."""
    w, g = OMEGA_RADPS * np.array([1.0, 3.0]), 0.8 * G_MPS2
    plate = Plate(w, 1j * g * np.array([1.0, 9.0]))
    rod = {"coulomb_friction": {"mu_up": 0.12, "mu_down": 0.15}}
    orbit = simulate(rod, plate, g_mps2=G_MPS2, period_s=PERIOD_S, flights=20)
    landing_s, lasted = fall_with_friction(plate, orbit.takeoff_s[-1], 0.12, 0.15, 1e-7)
    assert len(lasted) == 5
    assert lasted[-1] < 0.5 * PERIOD_S / 48.0
    assert orbit.landing_s[-1] == pytest.approx(landing_s, abs=2e-6)


def test_a_gravity_that_differs_is_gravity_in_closed_form():
    """Bounces under g and an excess are those under their sum to the last bit; no force has to be integrated."""
    w = OMEGA_RADPS * np.array([1.0, 2.0])
    plate, bounces = Plate(w, 1j * 1.2 * G_MPS2 * np.array([1.0, 4.0])), {"restitution": {"e0": 0.4}}
    excess = {"local_gravity": {"excess_mps2": 0.4}}
    found = simulate({**bounces, **excess}, plate, g_mps2=G_MPS2, period_s=PERIOD_S, flights=30)
    same = simulate(bounces, plate, g_mps2=G_MPS2 + 0.4, period_s=PERIOD_S, flights=30)
    assert len(found.landing_s) == 30
    assert np.array_equal(found.landing_s, same.landing_s)
    law = law_of({**bounces, **excess}, G_MPS2)
    assert not (law.forced or law.rubbed)


@njit
def marched(tones, ratio, om, ze, seconds, dt, listen):
    """Ball, plate and its mode in small steps: take-offs, landings, and the mode's tones from the first landing on."""
    y, yd, h, v = -ratio * 9.80665 / om**2, 0.0, 0.0, 0.0
    off, land = np.zeros(200), np.zeros(200)
    n_off = n_land = 0
    resting = True
    heard, heard_s, kept, kept_s = np.zeros(listen.size, np.complex128), 0.0, np.zeros(listen.size, np.complex128), 0.0
    w = 2.0 * math.pi * 25.0
    for i in range(int(seconds / dt)):
        t = i * dt
        a0 = a1 = 0.0
        for k in range(tones.size):
            a0 += (tones[k] * np.exp(1j * (k + 1) * w * t)).real
            a1 += (tones[k] * np.exp(1j * (k + 1) * w * (t + dt))).real
        load = ratio if resting else 0.0
        yd2 = (-om * om * y - 2.0 * ze * om * yd - load * (9.80665 + a0)) / (1.0 + load)
        if n_land > 0:
            for k in range(listen.size):
                heard[k] += 2.0 * yd2 * np.exp(-1j * listen[k] * (t + 0.5 * dt)) * dt
            heard_s += dt
        if resting and 9.80665 + a0 + yd2 < 0.0:
            resting, off[n_off], h, v = False, t, 0.0, 0.0
            n_off += 1
            yd2 = -om * om * y - 2.0 * ze * om * yd
        half = yd + 0.5 * dt * yd2
        y_new = y + dt * half
        load = ratio if resting else 0.0
        end = (-om * om * y_new - 2.0 * ze * om * half - load * (9.80665 + a1)) / (1.0 + load)
        if not resting:
            now, then = -9.80665 - a0 - yd2, -9.80665 - a1 - end
            h_old = h
            h += dt * v + dt * dt * (2.0 * now + then) / 6.0
            v += 0.5 * dt * (now + then)
            if h < 0.0 and t - off[n_off - 1] > 1e-3:
                resting = True
                land[n_land] = t + dt * h_old / (h_old - h)
                n_land += 1
                y, yd = y_new, half + 0.5 * dt * end + ratio / (1.0 + ratio) * v
                kept[:], kept_s = heard, heard_s
                continue
        y, yd = y_new, half + 0.5 * dt * end
    return off[:n_land], land[:n_land], kept / max(kept_s, 1e-12)


@pytest.mark.slow
def test_a_plate_mode_rings_as_a_fine_march_says():
    """With a mode struck by every impact, landings agree with a march in 2 microsecond steps to 5 % of its effect."""
    bare, ratio, om, ze = np.array([1.7 * G_MPS2 + 0j]), 0.03, 2.0 * math.pi * 6.3, 0.05
    listen = OMEGA_RADPS * np.array([1.0])
    off, land, rung = marched(bare, ratio, om, ze, 1.2, 2e-6, listen)
    assert len(land) > 12
    mode = row({"table_resonance": {"mass_ratio": ratio, "frequency_hz": om / 2 / math.pi, "damping": ze}}, G_MPS2)
    steps = steps_of(complex(bare[0] + rung[0]))
    found = one_ahead(events(off, land), steps, mode)
    deaf = one_ahead(events(off, land), steps_of(complex(bare[0])), row({}, G_MPS2))
    assert abs(found.mode_amplitudes[0, 0] - rung[0]) < 0.05 * abs(rung[0])
    with_mode, without = (np.sqrt(np.mean((p.landing_s - land)[4:] ** 2)) for p in (found, deaf))
    assert without > 5e-4  # what the mode does is no small thing here
    assert with_mode < 0.05 * without


def test_an_inelastic_ball_leaves_from_rest_whatever_the_contact_looked_like():
    """Contacts too short for the circuit to resolve strike the mode as they are, not as bounces with another speed."""
    bare, ratio, om, ze = np.array([1.7 * G_MPS2 + 0j]), 0.03, 2.0 * math.pi * 6.3, 0.05
    off, land, _ = marched(bare, ratio, om, ze, 1.2, 2e-6, OMEGA_RADPS * np.array([1.0]))
    mode = row({"table_resonance": {"mass_ratio": ratio, "frequency_hz": om / 2 / math.pi, "damping": ze}}, G_MPS2)
    seen = events(off, land)
    brief = replace(seen, relaunched=np.ones(len(off), dtype=bool))
    found, hasty = (one_ahead(m, steps_of(complex(bare[0])), mode) for m in (seen, brief))
    assert hasty.impact_mps[2:] == pytest.approx(found.impact_mps[2:], rel=1e-6)
    assert hasty.mode_amplitudes[0, 0] == pytest.approx(found.mode_amplitudes[0, 0], rel=1e-6)


@pytest.mark.parametrize("beside", [False, True])
def test_a_mode_whose_motion_was_measured_is_a_tone_more(beside):
    """A light mode that hardly dies away, its states given: flights are those over a plate with that tone.

    A second one beside it, at rest and of another frequency, rings on at its own frequency.
    """
    bare, own, size_m = complex(1.7 * G_MPS2), 2.0 * math.pi * 6.3, 2e-4
    off, land, _ = marched(np.array([bare]), 0.0, own, 0.05, 1.2, 2e-6, OMEGA_RADPS * np.array([1.0]))
    seen = events(off, land)
    state = np.column_stack(
        [f for t in (off, land) for f in (size_m * np.sin(own * t), size_m * own * np.cos(own * t))]
    )
    if beside:
        state = np.column_stack([0.0 * state, state[:, :2], np.full(len(off), own), np.full(len(off), 1e-6)])
    first = {"mass_ratio": 1e-9, "frequency_hz": 9.1 if beside else 6.3, "damping": 1e-6}
    mode = row({"table_resonance": first}, G_MPS2)
    rung = one_ahead(replace(seen, mode=state), steps_of(bare), mode)
    two = PlateSteps(
        np.array([[OMEGA_RADPS, own]]), np.array([[bare, 1j * size_m * own**2]]), np.array([PERIOD_S])
    )  # its acceleration is -w^2 size sin(w t)
    np.testing.assert_allclose(rung.landing_s[1:], one_ahead(seen, two, row({}, G_MPS2)).landing_s[1:], atol=1e-7)
    still = one_ahead(seen, steps_of(bare), mode)
    assert np.nanmax(np.abs(rung.landing_s - still.landing_s)) > 1e-4


def test_stretches_of_time_add_up_to_the_whole():
    """What a mode does in two halves of every cycle is, together, what it does all the time."""
    bare, ratio, om, ze = np.array([1.7 * G_MPS2 + 0j]), 0.03, 2.0 * math.pi * 6.3, 0.05
    off, land, _ = marched(bare, ratio, om, ze, 0.6, 2e-6, OMEGA_RADPS * np.array([1.0]))
    mode = row({"table_resonance": {"mass_ratio": ratio, "frequency_hz": om / 2 / math.pi, "damping": ze}}, G_MPS2)

    @dataclass
    class Parts:
        span_s: np.ndarray
        omega_radps = np.full((1, 1), OMEGA_RADPS)

        @property
        def first(self):
            return np.array([0, len(self.span_s)])

        def of_tones(self, projection, observed_s):
            return np.atleast_2d(2.0 * projection.sum(axis=0) / observed_s.sum())

    edges = np.linspace(-1.0, 2.0, 300)
    whole, parts = (
        one_ahead(events(off, land), steps_of(complex(bare[0])), mode, probe=Parts(np.column_stack([at[:-1], at[1:]])))
        for at in (edges[[0, -1]], edges)
    )
    assert parts.observed_s.sum() == pytest.approx(whole.observed_s.sum(), rel=1e-9)
    assert parts.projection.sum() == pytest.approx(whole.projection.sum(), rel=1e-9)
    assert np.count_nonzero(parts.observed_s) > 20


def test_a_ball_that_never_leaves_moves_with_its_plate():
    """Where nothing flies, the mode's share of a measured tone is what the resting ball's mass does to the plate."""
    ratio, om, ze = 0.02, 2.0 * math.pi * 6.3, 0.05
    bare = 0.6 * G_MPS2 + 0j
    stiff = om * om - (1.0 + ratio) * OMEGA_RADPS**2 + 2j * ze * om * OMEGA_RADPS
    loaded = bare * (1.0 + ratio * OMEGA_RADPS**2 / stiff)  # y'' of (1 + r) y'' + 2 z om y' + om^2 y = -r a
    one = events(np.array([0.1]), np.array([0.2]))
    nowhere = Measured(one.opening_s, one.landing_s, one.relaunched, one.linked, one.step + 1, one.wanted)
    two = PlateSteps(np.full((2, 1), OMEGA_RADPS), np.array([[loaded], [G_MPS2]]), np.full(2, PERIOD_S))
    mode = row({"table_resonance": {"mass_ratio": ratio, "frequency_hz": om / 2 / math.pi, "damping": ze}}, G_MPS2)
    assert one_ahead(nowhere, two, mode).mode_amplitudes[0, 0] == pytest.approx(loaded - bare, rel=1e-9)


NO_HARMONICS = effect("harmonic_distortion").effect.null_values


def test_harmonics_of_a_bent_amplifier_are_those_of_trigonometry():
    """sin^2, sin^3 and the products of two tones give the multiples of the addition theorems."""
    square, cube = ({**NO_HARMONICS, key: 1.0} for key in ("quadratic_per_g", "cubic_per_g2"))
    k, one, same = np.array([1, 2, 3]), np.ones(3), np.ones((3, 1))
    assert harmonics(square, k, np.full((3, 1), 1), same, one)[1] == pytest.approx(-0.5j)  # sin^2 x = (1 - cos 2x) / 2
    found = harmonics(cube, k, np.full((3, 1), 1), same, one)  # sin^3 x = (3 sin x - sin 3x) / 4
    assert found[[0, 2]] == pytest.approx([0.75, -0.25])
    found = harmonics(square, k, np.full((3, 1), 2), same, one)  # 2 sin x sin 2x = cos x - cos 3x
    assert found[[0, 2]] == pytest.approx([1j, -1j])
    p = {**NO_HARMONICS, "second": 0.02, "third": 0.01, "phase_rad": 0.5 * math.pi}
    found = harmonics(p, k, np.full((3, 1), 2), same, one)
    assert found == pytest.approx([0.0, 0.02j, 0.01])
    found = harmonics(p, k, np.tile([2, 3], (3, 1)), np.tile([1.0, 1j], (3, 1)), one)
    assert found == pytest.approx([0.0, 0.02j, -0.01])  # each against the tone on which it falls


def test_a_flight_after_a_bounce_that_no_circuit_showed_ends_as_it_was_flown():
    """A bounce that the contact closed over leaves the next landing as slow as it was: no plate threw the ball."""
    steps = steps_of(1.07 * G_MPS2)
    plate = Plate(steps.omega_radps[0], steps.acceleration_mps2[0])
    effects = {"restitution": {"e0": 0.28}}
    flown = simulate(effects, plate, g_mps2=G_MPS2, period_s=PERIOD_S, flights=600)
    lasts = flown.landing_s - flown.takeoff_s
    follows = np.append(False, np.abs(flown.takeoff_s[1:] - flown.landing_s[:-1]) < 1e-9)
    unseen = [i for i in range(6, 590) if 3e-4 < lasts[i] < 2e-3 < lasts[i - 1] and follows[i : i + 2].all()]
    unseen = [i for i in unseen if lasts[i + 1] < 1.5e-3]
    assert unseen
    for i in unseen:
        kept = np.delete(np.arange(i - 5, i + 2), 5)
        first, n = np.arange(len(kept)) == 0, len(kept)
        opening = flown.takeoff_s[kept] + np.where(kept == i + 1, 0.5 * lasts[i + 1], 0.0)
        left_at_once = follows[kept] & (kept != i + 1)
        seen = Measured(opening, flown.landing_s[kept], left_at_once, ~first, np.zeros(n, np.int64), ~first)
        found = one_ahead(seen, steps, row(effects, G_MPS2), Detection(closure_s=5e-4))
        assert found.impact_mps[-1] == pytest.approx(flown.impact_mps[i + 1], rel=0.05, abs=1e-4)
