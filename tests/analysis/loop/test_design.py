"""Which run would separate what ties: the simulation behind the ranking."""

from dataclasses import replace

import numpy as np
import pytest

from analysis.attribution.candidates import priors_of
from analysis.attribution.fit import Fitter
from analysis.loop.design import Design, designs_for, simulate_design
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.whitening import Whitener
from analysis.residuals.observations import ContactCircuit, Observations, Steps
from analysis.residuals.plate_data.plate_observables import GAIN, SECOND, PlateData
from daq.channels.accelerometer import AccelerometerChannel
from daq.channels.registry import Channels
from daq.setup.setup import Ball, Forcing, Setup
from kernels.arrays import Bools
from model.integrator.problem import Measured, PlateSteps

FRICTION = {("coulomb_friction", "mu_up"): 0.2, ("coulomb_friction", "mu_down"): 0.2}


def seen_observations() -> Observations:
    """The least that a simulation needs of the run that was made: one step, its uncertainties, no plate data."""
    setup = Setup(
        name="t",
        forcing=Forcing(frequency_hz=25.37),
        ball=Ball(mass_kg=0.25),
        channels=Channels(accelerometer=AccelerometerChannel(sensitivity=0.1, unit="V/g")),  # type: ignore[arg-type]
    )
    nothing = np.zeros(0)
    none = np.zeros(0, dtype=np.int64)
    steps = Steps(
        np.zeros(1, np.int64),
        np.zeros(1, np.int64),
        np.array([1.0]),
        np.ones(1, np.int64),
        np.zeros(1),
        PlateSteps(np.full((1, 8), 159.4), np.zeros((1, 8), complex), np.array([1 / 25.37])),
        np.full((1, 16, 8), 0.001 + 0j),
        np.array([[True] + 7 * [False]]),
    )
    one = np.full(3, 1e-5)
    yes: Bools = np.ones(3, dtype=bool)
    return Observations(
        Measured(np.zeros(3), np.ones(3), ~yes, yes, np.zeros(3, np.int64), yes),
        one,
        one,
        yes,
        np.ones(3),
        np.full(3, np.inf),
        steps,
        PlateData(none, none, *(nothing,) * 5, none, none[:, None], nothing[:, None], nothing),
        setup,
    )


@pytest.fixture(scope="module")
def simulated() -> ForwardModel:
    """A simulation of a c = 2 ramp under friction 0.2."""
    model = ForwardModel(seen_observations(), {})
    return ForwardModel(simulate_design(Design("test", "c = 2", 2, (0.3, 0.5, 0.8, 1.1)), model, FRICTION), {})


def test_plate_data_of_a_run_are_as_sharp_as_its_amplitudes_allow() -> None:
    """Noise stays what it was seen to be, so the second tone, four times as large, is known four times as well; a
    harmonic on which a tone of the forcing falls is none."""
    seen = seen_observations()
    kind, step, one = np.array([GAIN, SECOND]), np.zeros(2, dtype=np.int64), np.ones(2)
    data = PlateData(
        kind, step, 0.0 * one, 1e-3 * one, 159.4 * np.array([1.0, 2.0]), one, 9.81 * one, np.array([1, 2]),
        step[:, None] + 1, one[:, None] + 0j, 0j * one,
    )  # fmt: skip
    model = ForwardModel(replace(seen, plate=data), {})
    made = simulate_design(Design("test", "c = 2", 2, (0.5, 1.0)), model, {}).plate
    assert made.kind.tolist() == [GAIN] * 4
    assert made.sigma == pytest.approx(1e-3 * 9.81 / 9.80665 / np.array([0.5, 2.0, 1.0, 4.0]), rel=1e-9)
    assert abs(made.shares[:, 0]) == pytest.approx([4.0] * 4)


def test_the_simulation_holds_what_it_was_made_of(simulated: ForwardModel) -> None:
    """Under the effects of which it was made, a simulated run leaves nothing; without them, milliseconds."""
    true, ideal = simulated.residuals(FRICTION), simulated.residuals({})
    rows = simulated.observations.scored
    assert rows.sum() > 40
    assert np.nanmax(np.abs(true.landing_s[rows])) < 1e-7
    assert np.nanmedian(np.abs(ideal.landing_s[rows])) > 1e-4


def test_a_run_of_which_some_landings_were_only_heard_has_designs() -> None:
    """What is known of single landings of the run that was made is not carried over to the simulated ones."""
    seen = replace(seen_observations(), circuit=ContactCircuit(heard=np.array([False, True, False])))
    model = ForwardModel(seen, {})
    made = simulate_design(Design("d", "", 1, (0.8, 1.2)), model, FRICTION)
    assert len(made) != len(seen)
    ForwardModel(made, {}).residuals(FRICTION)


def test_a_rival_loses_on_the_simulation(simulated: ForwardModel) -> None:
    """Viscous damping, fitted to a run simulated under friction, keeps a loss that friction does not have."""
    fitter = Fitter(simulated, priors_of(simulated.observations.setup), np.ones(4, dtype=bool))
    whitener = Whitener.of(simulated, FRICTION)
    right = fitter.fit(whitener, tuple(FRICTION), FRICTION).loss
    wrong = fitter.fit(whitener, (("viscous_damping", "rate_per_s"),), {("viscous_damping", "rate_per_s"): 1.0}).loss
    assert wrong > right + 100.0


def test_designs_go_beyond_the_run_that_was_made() -> None:
    """The candidate runs offer another ratio, a farther range, another order and a calibration."""
    designs = designs_for(np.array([0.8, 1.0]), 1)
    assert len({d.id for d in designs}) == len(designs)
    assert {d.ratio for d in designs} == {1, 2, 3}
    assert any(max(d.gammas) > 1.5 and d.ratio == 1 for d in designs)
    assert any(d.order == "shuffled" for d in designs)
    assert any(d.priors for d in designs)
