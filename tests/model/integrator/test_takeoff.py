"""From a measured flight back to its launch: what can leave a plate, and lands when it was seen to land."""

import math

import numpy as np
import pytest

from model.integrator.flight import flight
from model.integrator.one_step import law_of
from model.integrator.plate import step_length
from model.integrator.problem import Mode, Plate, tones_for_kernel
from model.integrator.takeoff import launch_of
from model.tones import Plate as Motion

G_MPS2 = 9.80665
PERIOD_S = 0.04
START_S = 1.1 * PERIOD_S
WITHIN_MPS = 4.0 * G_MPS2 * 1e-9  # an integrated landing errs by up to a nanosecond
NO_MODE = Mode(0.0, 0.0, 1.0, 0.0)


def _rig(effects):
    """A plate, and what acts on a ball with ``effects``."""
    w = 2.0 * math.pi / PERIOD_S
    motion = Motion([w], [3.0j * G_MPS2])
    tones = tones_for_kernel(motion.omega_radps, motion.acceleration)
    law = law_of(effects, G_MPS2)
    law = law._replace(step_s=step_length(PERIOD_S, tones), turning=np.empty((len(tones) + 2, 6)))
    return Plate(tones, NO_MODE), law


@pytest.mark.parametrize("excess_mps2", [0.0, 0.3])
@pytest.mark.parametrize(("launch_mps", "seconds"), [(0.3, None), (None, 0.01)])
def test_a_ball_leaves_upwards_and_lands_when_it_was_seen_to(excess_mps2, launch_mps, seconds):
    """A flight as long as one from 0.3 m/s has that launch; one too short for any launch is that of a ball at rest."""
    plate, law = _rig({"local_gravity": {"excess_mps2": excess_mps2}})
    lasts, hit_mps, *_ = flight(START_S, launch_mps or 0.0, plate, law, 0.0, np.inf)
    assert seconds is None or seconds < lasts
    found_mps, found_hit = launch_of(START_S, START_S + (seconds or lasts), (-1.0, 0.0, 0.0), plate, law)
    assert found_mps == pytest.approx(launch_mps or 0.0, abs=WITHIN_MPS)
    assert found_hit == pytest.approx(hit_mps, abs=WITHIN_MPS)


@pytest.mark.parametrize("near_mps", [None, 0.3001, 0.31])
def test_a_launch_under_friction_and_drag_is_found_from_any_flight_nearby(near_mps):
    """From a flight that is known, or from the drag-free answer, launch and impact are those of the flight."""
    plate, law = _rig({"coulomb_friction": {"mu_up": 0.1, "mu_down": 0.1}, "viscous_damping": {"rate_per_s": 0.5}})
    lasts, hit_mps, *_ = flight(START_S, 0.3, plate, law, 0.0, np.inf)
    near = (-1.0, 0.0, 0.0)
    if near_mps is not None:
        near_lasts, near_hit, _, reach = flight(START_S, near_mps, plate, law, 0.0, np.inf)
        near = near_mps, START_S + near_lasts, reach / near_hit
    found_mps, found_hit = launch_of(START_S, START_S + lasts, near, plate, law)
    assert found_mps == pytest.approx(0.3, abs=WITHIN_MPS)
    assert found_hit == pytest.approx(hit_mps, abs=WITHIN_MPS)


@pytest.mark.parametrize("mu", [0.0, 0.1, 1.0])
def test_the_reach_of_a_flight_tells_how_much_later_a_faster_one_lands(mu):
    """Under dry friction the ball turns a little later, or is held in mid-air, and both count."""
    plate, law = _rig({"coulomb_friction": {"mu_up": mu, "mu_down": mu}})
    (before, *_), (_, hit_mps, _, reach), (after, *_) = (
        flight(START_S, 0.3 + d, plate, law, 0.0, np.inf) for d in (-1e-5, 0.0, 1e-5)
    )
    assert reach / hit_mps == pytest.approx((after - before) / 2e-5, rel=1e-3)


@pytest.mark.parametrize("mu", [0.0, 0.02])
def test_where_no_launch_lands_in_time_the_slowest_that_passes_the_plate_is_found(mu):
    """The plate comes near in mid-flight: slower balls land on it there, faster ones much later than asked for."""
    plate, law = _rig({"coulomb_friction": {"mu_up": mu, "mu_down": mu}})
    start_s, launches = 1.6 * PERIOD_S, np.linspace(0.2, 0.5, 101)
    lasts = np.array([flight(start_s, v, plate, law, 0.0, np.inf)[0] for v in launches])
    jump = int(np.argmax(np.diff(lasts)))
    assert lasts[jump + 1] - lasts[jump] > 0.1 * PERIOD_S
    wanted_s = 0.5 * (lasts[jump] + lasts[jump + 1])
    found_mps, hit_mps = launch_of(start_s, start_s + wanted_s, (-1.0, 0.0, 0.0), plate, law)
    assert launches[jump] < found_mps <= launches[jump + 1]
    assert flight(start_s, found_mps, plate, law, 0.0, np.inf)[1] == hit_mps
    assert flight(start_s, found_mps - 2e-6, plate, law, 0.0, np.inf)[0] < wanted_s


def test_a_flight_is_flown_only_as_far_as_its_end_matters():
    """Within the time given the flight is the same to the last bit; beyond it there is none."""
    plate, law = _rig({})
    whole = flight(START_S, 0.3, plate, law, 0.0, np.inf)
    assert flight(START_S, 0.3, plate, law, 0.0, 1.01 * whole[0]) == whole
    assert flight(START_S, 0.3, plate, law, 0.0, 0.5 * whole[0])[0] == -1.0
