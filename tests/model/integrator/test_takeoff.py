"""From a measured flight back to its launch: what can leave a plate, and lands when it was seen to land."""

import math

import numpy as np
import pytest

from model.integrator.flight import flight
from model.integrator.one_step import law_of
from model.integrator.plate import step_length
from model.integrator.problem import tones_for_kernel
from model.integrator.records import Mode, Plate
from model.integrator.takeoff import launch_of
from model.tones import Plate as Motion

G_MPS2 = 9.80665
PERIOD_S = 0.04
WITHIN_MPS = 4.0 * G_MPS2 * 1e-9  # an integrated landing errs by up to a nanosecond
NO_MODE = Mode(0.0, 0.0, 1.0, 0.0)


@pytest.mark.parametrize("excess_mps2", [0.0, 0.3])
@pytest.mark.parametrize(("launch_mps", "seconds"), [(0.3, None), (None, 0.01)])
def test_a_ball_leaves_upwards_and_lands_when_it_was_seen_to(excess_mps2, launch_mps, seconds):
    """A flight as long as one from 0.3 m/s has that launch; one too short for any launch is that of a ball at rest."""
    w = 2.0 * math.pi / PERIOD_S
    motion = Motion([w], [3.0j * G_MPS2])
    tones = tones_for_kernel(motion.omega_radps, motion.acceleration)
    law = law_of({"local_gravity": {"excess_mps2": excess_mps2}}, G_MPS2)
    law = law._replace(step_s=step_length(PERIOD_S, tones), turning=np.empty((len(tones) + 1, 6)))
    plate, start_s = Plate(tones, NO_MODE), 1.1 * PERIOD_S
    lasts, hit_mps, _ = flight(start_s, launch_mps or 0.0, plate, law, 0.0, np.inf)
    assert seconds is None or seconds < lasts
    found_mps, found_hit = launch_of(start_s, start_s + (seconds or lasts), (-1.0, 0.0, 0.0), plate, law)
    assert found_mps == pytest.approx(launch_mps or 0.0, abs=WITHIN_MPS)
    assert found_hit == pytest.approx(hit_mps, abs=WITHIN_MPS)
