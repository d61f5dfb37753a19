"""Instruments by name, and recordings made with them on three plants, with the flights that were truly flown."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.plants import other_plant, third_plant
from benchmarks.plants.handed_over import FLIGHTS, Afterwards, imported
from benchmarks.plants.instrument import Instrument
from benchmarks.plants.third_instrument import CARDS, drawn
from kernels.arrays import Floats
from rig.backends.simulated import SimulatedBackend
from rig.sim.scenario import RIG_DEFAULTS, Scenario

Values = dict[str, dict[str, float]]

LAG, HIGH_PASS, PICKUP, OFFSET = "accelerometer_lag", "accelerometer_high_pass", "mains_pickup", "accelerometer_offset"
LATENCY, CROSS_AXIS = "contact_latency", "accelerometer_cross_axis"
GAMMAS = {1: (0.5, 2.6), 2: (0.2, 1.5), 3: (0.1, 0.8)}
STEPS, CYCLES = 22, 20
HIDDEN: dict[str, Mapping[str, tuple[float, float]]] = {
    # name: effect.parameter of the library, and the range of its size
    "nothing": {},
    "friction": {"coulomb_friction.mu": (0.05, 0.2)},
    "restitution": {"restitution.e0": (0.15, 0.5)},
    "friction and restitution": {"coulomb_friction.mu": (0.05, 0.2), "restitution.e0": (0.15, 0.5)},
    "viscous damping": {"viscous_damping.rate_per_s": (1.5, 4.0)},
    "drive gain": {"drive_gain.relative": (0.03, 0.08)},
}


@dataclass(frozen=True)
class Chain:
    """An instrument, the rate it samples at, and what happens to its file.

    ``parts`` are fields of `Instrument` and keys of a scenario's ``[rig]`` alike. ``causes``: names of effects that the
    instrument itself may be given in a verdict. ``hides``: effects that do not show behind it. ``plants`` that have
    such an instrument.
    """

    parts: Mapping[str, float] = field(default_factory=dict)
    rate_hz: float = 20e3
    after: Afterwards = field(default_factory=Afterwards)
    causes: tuple[str, ...] = ()
    hides: tuple[str, ...] = ()
    plants: tuple[str, ...] = ("other", "own")

    def late_s(self) -> float:
        """By how much all channels of the file are late."""
        part = Instrument(**self.parts)
        return 0.0 if part.fir_accelerometer_only else part.fir_samples / self.rate_hz


def _low_pass(hz: float, poles: float, rate_hz: float = 20e3, **more: float) -> Chain:
    return Chain({"low_pass_hz": hz, "low_pass_poles": poles, **more}, rate_hz, causes=(LAG,))


FAST_SLOPES = {"rc_open_s": 1e-4, "rc_close_s": 3e-5}
USB_CARD = {
    "low_pass_hz": 5e3, "flicker_v": 2e-4, "bias_v": 2e-3, "mains_v": 5e-4, "mains_odd": 0.5,
    "between_channels_s": 5e-6, "bounce_s": 5e-4, "film_v": 0.05,
}  # fmt: skip

CHAINS: dict[str, Chain] = {
    "plain": Chain(),
    "low-pass 8 kHz, 2 poles": _low_pass(8e3, 2),
    "low-pass 5 kHz, 1 pole": _low_pass(5e3, 1),
    "low-pass 5 kHz, 2 poles": _low_pass(5e3, 2),
    "low-pass 5 kHz, 4 poles": _low_pass(5e3, 4),
    "low-pass 3 kHz, 2 poles": _low_pass(3e3, 2),
    "low-pass 3 kHz, 4 poles": _low_pass(3e3, 4),
    "low-pass 1.6 kHz, 1 pole": _low_pass(1.6e3, 1),
    "low-pass 1 kHz, 4 poles": _low_pass(1e3, 4),
    "low-pass 500 Hz, 2 poles": _low_pass(500.0, 2),
    "low-pass 5 kHz, 2 poles, 51.2 kHz": _low_pass(5e3, 2, 51.2e3),
    "10 kHz, low-pass 4 kHz": _low_pass(4e3, 4, 10e3),
    "44.1 kHz": Chain(rate_hz=44.1e3),
    "48 kHz": Chain(rate_hz=48e3),
    "51.2 kHz": Chain(rate_hz=51.2e3),
    "96 kHz, low-pass 10 kHz": _low_pass(10e3, 2, 96e3),
    "sigma-delta": Chain({"fir_samples": 32}),
    "sigma-delta, accelerometer only": Chain({"fir_samples": 32, "fir_accelerometer_only": 1}, causes=(LAG,)),
    "high-pass 0.05 Hz": Chain({"high_pass_hz": 0.05}, causes=(HIGH_PASS,)),
    "high-pass 0.5 Hz": Chain({"high_pass_hz": 0.5}, causes=(HIGH_PASS,)),
    "high-pass 3 Hz": Chain({"high_pass_hz": 3.0}, causes=(HIGH_PASS,)),
    "1/f noise, 2 mV an octave": Chain({"flicker_v": 2e-3}),
    "1/f noise behind a low-pass": _low_pass(5e3, 2, flicker_v=1e-3),
    "bias 10 mV": Chain({"bias_v": 0.01}, causes=(OFFSET,)),
    "bias that warms up by 3 mV": Chain({"warm_up_v": 3e-3}),
    "mains with odd harmonics, 10 mV": Chain({"mains_v": 0.01, "mains_odd": 1.0}, causes=(PICKUP,)),
    "mount rings at 4 kHz": Chain({"mount_hz": 4e3}),
    "sensitivity falls from 3 kHz": Chain({"mount_hz": 3e3, "mount_damping": 1.0}, causes=(LAG,)),
    "cross-axis 5 %": Chain({"cross_axis": 0.05}, causes=(CROSS_AXIS, HIGH_PASS)),
    "sensor ends at 6 g": Chain({"sensor_clip_g": 6.0}),
    "sensor ends at 4 g": Chain({"sensor_clip_g": 4.0}),
    "impacts are pulses": Chain({"pulse": 1}),
    "impacts are pulses behind a low-pass": _low_pass(5e3, 2, pulse=1),
    "multiplexed": Chain({"between_channels_s": 5e-6}),
    "contact chatters": Chain({"bounce_s": 8e-4}),
    "film on the contact": Chain({"film_v": 0.6}),
    "film, 1/f noise in the contact": Chain({"film_v": 0.35, "contact_flicker_v": 0.025}),
    "slow edges": Chain({"rc_open_s": 2e-4, "rc_close_s": 5e-5}),
    "hysteresis": Chain({"hysteresis_v": 2.0, **FAST_SLOPES}, causes=(LATENCY,)),
    "mains in the contact": Chain({"contact_mains_v": 0.15}),
    "mains in the drive": Chain({"drive_mains_v": 3e-3}),
    "ordinary USB card": Chain(USB_CARD, causes=(LAG, OFFSET, PICKUP)),
    # an RC of 20 us delays the edges of the contact, and no longer shows
    "resampled to 44.1 kHz by lines": Chain(after=Afterwards(resampled_hz=44.1e3), causes=(LATENCY,)),
    "resampled to 48 kHz, polyphase": Chain(after=Afterwards(resampled_hz=48e3, polyphase=True), causes=(LATENCY,)),
    "accelerometer of 10 kHz, filled": Chain(
        {"low_pass_hz": 4e3, "low_pass_poles": 4}, after=Afterwards(filled_hz=10e3), causes=(LAG,)
    ),
    "accelerometer of 6.4 kHz, filled": Chain(
        {"low_pass_hz": 2.5e3, "low_pass_poles": 2}, after=Afterwards(filled_hz=6.4e3), causes=(LAG,)
    ),
    "no drive": Chain(after=Afterwards(drive="missing"), hides=("drive_gain",)),
    "drive inverted": Chain(after=Afterwards(drive="inverted")),
    "drive before the amplifier": Chain(after=Afterwards(drive="scaled"), hides=("drive_gain",)),
    "drive a sample late": Chain(after=Afterwards(late_samples=(("drive_v", 1),))),
    "accelerometer two samples late": Chain(after=Afterwards(late_samples=(("accelerometer_v", 2),)), causes=(LAG,)),
    "three losses": Chain(after=Afterwards(losses=3)),
    "clock fast by 60 ppm": Chain(after=Afterwards(clock=6e-5)),
    "times jitter by 2 us": Chain(after=Afterwards(time_jitter_s=2e-6)),
    # each trial draws the sizes of the third plant's instrument
    **{card: Chain(causes=(LAG, HIGH_PASS, PICKUP, OFFSET), plants=("third",)) for card in CARDS},
}


@dataclass(frozen=True)
class Job:
    """A trial: names of a chain and of what is hidden, the plant (``other``, ``own`` or ``third``), and a seed."""

    chain: str
    hidden: str
    plant: str
    seed: int

    @property
    def key(self) -> str:
        """A name of its own."""
        return f"{self.plant}/{self.chain}/{self.hidden}/{self.seed}"

    def rng(self) -> np.random.Generator:
        """The same for each run of this trial."""
        return np.random.default_rng((self.seed, zlib.crc32(self.key.encode())))


def jobs(seeds: range) -> list[Job]:
    """Every trial that the plants allow, chain by chain within each hidden cause."""
    return [
        Job(chain, hidden, plant, seed)
        for seed in seeds for hidden in HIDDEN for chain in CHAINS for plant in CHAINS[chain].plants
        if plant != "own" or set(CHAINS[chain].parts) <= set(RIG_DEFAULTS)
    ]  # fmt: skip


def recorded(job: Job, folder: Path) -> tuple[Path, Floats, Values]:
    """A recording, the flights flown, take-off and landing (m, 2) in s by its clock, and the library's true values."""
    rng, chain = job.rng(), CHAINS[job.chain]
    sizes = {key: float(rng.uniform(*bounds)) for key, bounds in HIDDEN[job.hidden].items()}
    if job.plant == "third":
        path, flights = _third(job.chain, sizes, rng, folder)
    else:
        path, flights = (_other if job.plant == "other" else _own)(chain, sizes, rng, folder)
    truth: Values = {}
    for key, value in sizes.items():
        effect, _, name = key.partition(".")
        both = ("mu_up", "mu_down") if name == "mu" else (name,)
        truth[effect] = dict.fromkeys(both, value)
    return path, flights + chain.late_s(), truth


def _other(chain: Chain, sizes: Mapping[str, float], rng: np.random.Generator, folder: Path) -> tuple[Path, Floats]:
    c = int(rng.choice((1, 2)))
    run = other_plant.Run(
        c=c, frequency_hz=float(rng.choice((22.31, 25.37, 25.0, 31.73))), rate_hz=chain.rate_hz, cycles=CYCLES,
        closure_s=float(rng.choice((1e-4, 5e-4))), jitter_s=float(rng.choice((5e-6, 2e-5))), bits=16,
        reads_gravity=bool(rng.random() < 0.5) and "high_pass_hz" not in chain.parts,
        gammas=tuple(rng.permutation(np.round(np.linspace(*GAMMAS[c], STEPS), 4)).tolist()),
        seed=int(rng.integers(2**31)), hidden=dict(sizes), instrument=Instrument(**chain.parts),
    )  # fmt: skip
    volts = chain.after.apply(other_plant.simulate(run), chain.rate_hz, rng)
    return imported(volts, chain.after.profile(other_plant.profile_of(run)), folder), volts[FLIGHTS]


def _third(card: str, sizes: Mapping[str, float], rng: np.random.Generator, folder: Path) -> tuple[Path, Floats]:
    c = int(rng.choice((1, 2)))
    rig = third_plant.Rig(
        c=c, frequency_hz=float(rng.choice((21.7, 24.0, 27.3, 33.1))), cycles=CYCLES, instrument=drawn(card, rng),
        gammas=tuple(rng.permutation(np.round(np.linspace(*GAMMAS[c], STEPS), 4)).tolist()),
        seed=int(rng.integers(2**31)), **{third_plant.HIDDEN[key]: value for key, value in sizes.items()},
    )  # fmt: skip
    volts = third_plant.simulate(rig)
    return imported(volts, third_plant.profile_of(rig), folder), volts[FLIGHTS]


class _Watched(SimulatedBackend):
    """The simulated rig, whose flights are noted as they end."""

    LOOK_S = 2e-4

    def _new_plant(self) -> None:
        super()._new_plant()
        self.flights: list[tuple[float, float]] = []
        marched, state = self._plant.exchange, self._plant._state
        samples = int(self.LOOK_S * self.rate_hz)

        def exchange(drive_v: Floats) -> NDArray[np.int16]:
            codes = []
            for start in range(0, len(drive_v), samples):
                seen = int(state["impacts"][0])
                codes.append(marched(drive_v[start : start + samples]))
                if int(state["impacts"][0]) != seen:
                    landing_s = float(state["landed_s"][0])
                    self.flights.append((landing_s - float(state["flight_s"][0]), landing_s))
            return np.concatenate(codes)

        self._plant.exchange = exchange  # type: ignore[method-assign]


def _own(chain: Chain, sizes: Mapping[str, float], rng: np.random.Generator, folder: Path) -> tuple[Path, Floats]:
    from bench.jobs.run_ramp import record
    from bench.profiles.edit import with_values
    from bench.profiles.find import load
    from daq.recording import open_recording

    effects: Values = {}
    for key, value in sizes.items():
        effect, _, name = key.partition(".")
        effects[effect] = {"mu_up": value, "mu_down": value} if name == "mu" else {name: value}
    c = int(rng.choice((1, 2)))
    asked = {
        "ramp.gamma": np.round(np.linspace(*GAMMAS[c], STEPS), 4).tolist(), "ramp.order": "shuffled",
        "forcing.ratio": c, "sampling.rate_hz": chain.rate_hz,
    }  # fmt: skip
    described = folder / "own.toml"
    described.write_text(with_values(load("simulated")[1], asked, "simulated"), encoding="utf-8")
    profile, text = load(str(described))
    scenario = Scenario("chain", effects, dict(chain.parts))
    rig = _Watched(chain.rate_hz, scenario, int(rng.integers(2**31)))
    path = folder / "own.h5"
    summary = record(profile, text, rig, path, quiet=True)
    if summary.how != "complete":
        raise RuntimeError(f"the run was {summary.how}: {summary.why}")
    flights = np.array(rig.flights).reshape(-1, 2)
    if chain.after == Afterwards():
        return path, flights
    with open_recording(path) as recording:
        volts = {f"{name}_v": recording.read_v(name) for name in ("continuity", "accelerometer", "drive")}
        times = {"time_s": np.arange(recording.n_samples) / recording.rate_hz, FLIGHTS: flights}
    handed = chain.after.apply({**volts, **times}, chain.rate_hz, rng)
    return imported(handed, chain.after.profile(text), folder), handed[FLIGHTS]
