"""Another experiment, built by other means, to try the analysis on recordings it was never tuned on.

It shares nothing with `rig.sim`: a fixed 5 microsecond velocity-Verlet march in absolute coordinates along an analytic
plate, edges jittered rather than filtered, an accelerometer that reads gravity and shows no impacts unless there is an
`Instrument`. It writes a CSV of volts without a step table, a profile, and, in a file of its own, the sealed truth.

    python -m benchmarks.plants.other_plant OUT_FOLDER --c 2 --effect coulomb_friction --strength strong --seed 7
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import asdict, dataclass, field
from pathlib import Path
from string import Template

import numpy as np

from benchmarks.plants.command import G, commanded, commands
from benchmarks.plants.instrument import DRIVE, Instrument, accelerometer_v, contact_v
from benchmarks.plants.sensors import blocked, converted, edge_times, late, square_contact
from kernels import njit

STEPS_PER_SAMPLE = 10
FINE_HZ = 30e3  # from this rate on, a grid of half the steps is fine enough for an instrument

SIZES: dict[str, dict[str, tuple[float, float, float]]] = {
    # effect: parameter: (weak, medium, strong)
    "coulomb_friction": {"mu": (0.004, 0.02, 0.2)},
    "friction_asymmetry": {"up": (0.006, 0.03, 0.2), "down": (0.0, 0.0, 0.05)},
    "viscous_damping": {"rate_per_s": (0.05, 0.3, 4.0)},
    "quadratic_drag": {"per_m": (0.5, 3.0, 25.0)},
    "restitution": {"e0": (0.02, 0.1, 0.5), "slope_s_per_m": (0.0, 0.0, 0.1)},
    "restitution_scatter": {"sd": (0.001, 0.005, 0.03)},  # of `restitution.e0`, from impact to impact
    "adhesion": {"pull_g": (0.01, 0.04, 0.25)},
    "spring": {"per_s2": (2.0, 10.0, 150.0)},
    "magnet": {"pull_g": (0.005, 0.02, 0.15), "range_m": (0.002, 0.002, 0.002)},
    "local_gravity": {"relative": (0.001, 0.005, 0.05)},
    "table_resonance": {"ratio": (0.0005, 0.002, 0.03), "hz": (6.3, 6.3, 6.3), "damping": (0.05, 0.05, 0.05)},
    "drive_gain": {"relative": (0.002, 0.01, 0.08)},
    "gain_compression": {"per_gamma2": (0.0002, 0.001, 0.02)},
    "phase_lag": {"delay_s": (2e-5, 1e-4, 5e-4)},
    "harmonic_distortion": {"second": (0.0005, 0.003, 0.02), "third": (0.0005, 0.003, 0.02)},
    "mains_hum": {"g": (0.002, 0.01, 0.08)},
    "amplitude_modulation": {"depth": (0.001, 0.006, 0.05), "hz": (0.7, 0.7, 0.7)},
    "accelerometer_gain": {"relative": (0.002, 0.01, 0.06)},
    "accelerometer_offset": {"g": (0.003, 0.02, 0.2)},
    "contact_latency": {"delay_s": (2e-5, 1e-4, 5e-4)},
    "accelerometer_lag": {"delay_s": (2e-5, 1e-4, 5e-4)},
    "mains_pickup": {"g": (0.002, 0.01, 0.08)},
    "accelerometer_high_pass": {"hz": (0.1, 0.4, 3.0)},
    # not among the agreed candidates
    "friction_with_height": {"per_m": (0.3, 2.0, 30.0)},
    "friction_with_speed": {"per_mps": (0.02, 0.1, 0.6)},
    "friction_with_dwell": {"mu": (0.01, 0.04, 0.3), "seconds": (0.01, 0.01, 0.01)},
    "friction_with_level": {"per_gamma": (0.002, 0.01, 0.08)},
    "friction_drift": {"per_s": (0.002, 0.01, 0.05)},  # of `coulomb_friction.mu`, relative
    "pull_after_long_flight": {"g": (0.005, 0.02, 0.15), "seconds": (0.03, 0.03, 0.03)},
    "restitution_at_one_speed": {"e": (0.05, 0.15, 0.4), "mps": (0.25, 0.25, 0.25)},
    "upper_stop": {"pull_g": (0.03, 0.1, 0.8), "above_m": (0.001, 0.001, 0.001)},
}
NAMES = tuple(f"{effect}.{key}" for effect, table in SIZES.items() for key in table)
PLACE = {name: k for k, name in enumerate(NAMES)}

LATENCY, SCATTER = "contact_latency.delay_s", "restitution_scatter.sd"
_LAG, _GAIN = PLACE["phase_lag.delay_s"], PLACE["drive_gain.relative"]
_COMPRESSION = PLACE["gain_compression.per_gamma2"]
_AM, _AM_HZ, _HUM = PLACE["amplitude_modulation.depth"], PLACE["amplitude_modulation.hz"], PLACE["mains_hum.g"]
_SECOND, _THIRD = PLACE["harmonic_distortion.second"], PLACE["harmonic_distortion.third"]
_MU, _MU_UP, _MU_DOWN = PLACE["coulomb_friction.mu"], PLACE["friction_asymmetry.up"], PLACE["friction_asymmetry.down"]
_MU_H, _MU_V, _MU_L = (
    PLACE["friction_with_height.per_m"], PLACE["friction_with_speed.per_mps"], PLACE["friction_with_level.per_gamma"],
)  # fmt: skip
_DRIFT = PLACE["friction_drift.per_s"]
_DWELL, _DWELL_S = PLACE["friction_with_dwell.mu"], PLACE["friction_with_dwell.seconds"]
_VISCOUS, _DRAG, _SPRING = PLACE["viscous_damping.rate_per_s"], PLACE["quadratic_drag.per_m"], PLACE["spring.per_s2"]
_MAGNET, _MAGNET_M = PLACE["magnet.pull_g"], PLACE["magnet.range_m"]
_STOP, _STOP_M = PLACE["upper_stop.pull_g"], PLACE["upper_stop.above_m"]
_LONG, _LONG_S = PLACE["pull_after_long_flight.g"], PLACE["pull_after_long_flight.seconds"]
_GRAVITY, _ADHESION = PLACE["local_gravity.relative"], PLACE["adhesion.pull_g"]
_E0, _E1 = PLACE["restitution.e0"], PLACE["restitution.slope_s_per_m"]
_E_AT, _E_MPS = PLACE["restitution_at_one_speed.e"], PLACE["restitution_at_one_speed.mps"]
_RATIO, _TABLE_HZ, _TABLE_D = (
    PLACE["table_resonance.ratio"], PLACE["table_resonance.hz"], PLACE["table_resonance.damping"],
)  # fmt: skip


@dataclass(frozen=True)
class Run:
    """One experiment: the forcing, the amplitude steps, the sensors and the hidden values."""

    c: int = 1
    frequency_hz: float = 25.37
    gammas: tuple[float, ...] = tuple(np.round(np.linspace(0.5, 2.6, 22), 4).tolist())
    cycles: int = 20
    fade_cycles: int = 1
    rate_hz: float = 20000.0
    g_per_volt: float = 1.6
    jitter_s: float = 2e-5
    accelerometer_noise_g: float = 0.03
    reads_gravity: bool = True
    spikes: bool = False
    closure_s: float = 0.0
    contact_rc_s: float = 0.0  # time constant of a low-pass behind the comparator that is read once a sample
    contact_noise_v: float = 0.01
    bits: int = 0  # of the converters, +-10 V; 0: fine enough not to matter
    seed: int = 0
    hidden: dict[str, float] = field(default_factory=dict)
    instrument: Instrument | None = None  # with one, `spikes` and `contact_rc_s` do not count

    def values(self) -> np.ndarray:
        """Hidden numbers in the order of `NAMES`; absent ones are zero."""
        vector = np.zeros(len(NAMES))
        vector[[PLACE[name] for name in self.hidden]] = list(self.hidden.values())
        return vector


@njit()
def _plate(q, gammas, step_s, fade_s, w, c, t):
    """What the driven table does: the command with the hidden gain, lag, bend, hum and breathing."""
    level = gammas[max(min(int(t / step_s), gammas.size - 1), 0)]
    x, v, a = commanded(gammas, step_s, fade_s, w, c, t - q[_LAG])
    gain = (1.0 + q[_GAIN]) / (1.0 + q[_COMPRESSION] * level * level)
    if q[_AM] != 0.0:
        gain *= 1.0 + q[_AM] * math.sin(2.0 * math.pi * q[_AM_HZ] * t)
    x, v, a = gain * x, gain * v, gain * a
    for k, share in ((2.0, q[_SECOND]), (3.0, q[_THIRD])):
        if share != 0.0:
            size = share * level * 9.80665 / (w * w)
            x += size * math.cos(k * w * t)
            v -= size * k * w * math.sin(k * w * t)
            a -= size * k * k * w * w * math.cos(k * w * t)
    if q[_HUM] != 0.0:
        m = 2.0 * math.pi * 50.0
        size = q[_HUM] * 9.80665 / (m * m)
        x += size * math.sin(m * t + 0.4)
        v += size * m * math.cos(m * t + 0.4)
        a -= size * m * m * math.sin(m * t + 0.4)
    return x, v, a


@njit()
def _mu(q, height, speed, level, up):
    """Sliding friction over weight."""
    mu = q[_MU] + (q[_MU_UP] if up else q[_MU_DOWN])
    return mu + q[_MU_H] * height + q[_MU_V] * abs(speed) + q[_MU_L] * level


@njit()
def _push(q, g, height, speed, absolute, last_flight):
    """Acceleration of the free ball, friction apart."""
    a = -g - q[_VISCOUS] * speed - q[_DRAG] * abs(absolute) * absolute - q[_SPRING] * height
    if q[_MAGNET] > 0.0:
        a -= q[_MAGNET] * 9.80665 * math.exp(-height / q[_MAGNET_M])
    if q[_STOP] > 0.0 and height > q[_STOP_M]:
        a -= q[_STOP] * 9.80665 * (height - q[_STOP_M]) / q[_STOP_M]
    if q[_LONG] > 0.0:
        a -= q[_LONG] * 9.80665 * last_flight / (last_flight + q[_LONG_S])
    return a


@njit()
def _rebound(q, speed, off):
    """Restitution at this impact speed, by so much ``off``."""
    e = min(max(q[_E0] - q[_E1] * speed + off, 0.0), 0.95)
    if q[_E_AT] > 0.0:
        e = max(e, q[_E_AT] * math.exp(-(((speed - q[_E_MPS]) / 0.1) ** 2)))
    return e


@njit()
def _slide(q, g, height, speed, free, here):
    """Acceleration of a ball that slides, friction included."""
    up = speed > 0.0 or (speed == 0.0 and free > 0.0)
    return free - (1.0 if up else -1.0) * _mu(q, height, speed, here, up) * g


@njit()
def _holding(q, g, here, rested_s):
    """Pull that the resting ball withstands, m/s^2."""
    dwell = q[_DWELL] * (1.0 - math.exp(-rested_s / q[_DWELL_S])) if q[_DWELL] > 0.0 else 0.0
    return q[_ADHESION] * 9.80665 + (_mu(q, 0.0, 0.0, here, True) + dwell) * g


@njit()
def _march(q, off, gammas, step_s, fade_s, w, c, dt, every, plate, edges, impacts):
    """March; fill plate at ``every`` step, edges (+t opens, -t closes), impacts; ``off`` (k,) adds to restitutions."""
    g = 9.80665 * (1.0 + q[_GRAVITY])
    slow_w = 2.0 * math.pi * q[_TABLE_HZ]
    y = yv = load = h = u = rested = left = last = 0.0  # h, u: height and speed above the plate
    touching, hanging, n_edges, n_impacts = True, False, 0, 0
    _, v, a = _plate(q, gammas, step_s, fade_s, w, c, 0.0)
    q, mu = q.copy(), q[_MU]
    for k in range(plate.size * every):
        t = k * dt
        q[_MU] = mu * (1.0 + q[_DRIFT] * t)
        here = gammas[min(int(t / step_s), gammas.size - 1)]
        ya = -slow_w * slow_w * y - 2.0 * q[_TABLE_D] * slow_w * yv - q[_RATIO] * load
        table_a = a + ya
        if k % every == 0:
            plate[k // every] = table_a
        load = table_a if touching or hanging else -g
        free = _push(q, g, h, u, v + yv + u, last) - table_a
        if touching and free > _holding(q, g, here, t - rested):
            touching, left = False, t
            edges[n_edges] = t
            n_edges += 1
        if hanging and abs(free) > _mu(q, h, 0.0, here, free > 0.0) * g:
            hanging, u = False, (1e-12 if free > 0.0 else -1e-12)
        _, v, a_next = _plate(q, gammas, step_s, fade_s, w, c, t + dt)
        y, yv = y + dt * (yv + 0.5 * dt * ya), yv + dt * ya
        slide = _slide(q, g, h, u, free, here)
        far = slide - (a_next - a)  # second order: the plate's acceleration at the step's far end
        a = a_next
        if touching or hanging:
            continue
        h_old, u_old = h, u
        h, u = h + dt * u + dt * dt * (2.0 * slide + far) / 6.0, u + 0.5 * dt * (slide + far)
        if u_old * u < 0.0 and h > 1e-9 and abs(free) <= _mu(q, h, 0.0, here, free > 0.0) * g:
            hanging, u = True, 0.0
        elif h < 0.0:
            share = h_old / (h_old - h)
            hit, speed = t + share * dt, max(-(u_old + share * (u - u_old)), 0.0)
            e = _rebound(q, speed, off[n_impacts])
            last, yv, u = hit - left, yv - q[_RATIO] / (1.0 + q[_RATIO]) * (1.0 + e) * speed, e * speed
            impacts[n_impacts, 0], impacts[n_impacts, 1] = hit, speed
            edges[n_edges] = -hit
            n_impacts, n_edges = n_impacts + 1, n_edges + 1
            touching = u < 2.0 * g * dt
            if touching:
                u, h, rested = 0.0, 0.0, hit
            else:
                # the ball flies on for the rest of the step; left out, each rebound would last half a step longer
                rest = (1.0 - share) * dt
                back = _slide(q, g, 0.0, u, _push(q, g, 0.0, u, v + yv + u, last) - a - ya, here)
                h, u, left = rest * (u + 0.5 * rest * back), u + rest * back, hit
                edges[n_edges] = hit
                n_edges += 1
        if n_edges > edges.size - 4 or n_impacts == impacts.shape[0]:
            break
    return n_edges, n_impacts


def _felt_g(run: Run, plate: np.ndarray, rate_hz: float) -> np.ndarray:
    """What the accelerometer feels without noise or impacts, hidden faults included; ``plate`` (n,) at this rate."""
    time_s = np.arange(plate.size) / rate_hz
    felt = plate / G * (1.0 + run.hidden.get("accelerometer_gain.relative", 0.0)) + float(run.reads_gravity)
    if late_s := run.hidden.get("accelerometer_lag.delay_s", 0.0):
        felt = late(felt, late_s * rate_hz)
    if corner_hz := run.hidden.get("accelerometer_high_pass.hz", 0.0):
        felt = float(run.reads_gravity) + blocked(felt - float(run.reads_gravity), corner_hz / rate_hz)
    felt += run.hidden.get("mains_pickup.g", 0.0) * np.sin(2.0 * math.pi * 50.0 * time_s + 0.9)
    return np.asarray(felt + run.hidden.get("accelerometer_offset.g", 0.0))


def simulate(run: Run) -> dict[str, np.ndarray]:
    """Run the experiment.

    Returns
    -------
    dict of float64 arrays
        ``time_s, continuity_v, accelerometer_v, drive_v`` (n,), and the truth: ``impacts`` (k, 2), seconds and m/s;
        ``flights`` (m, 2), take-off and landing, seconds.
    """
    rng = np.random.default_rng(run.seed)
    q, gammas = run.values(), np.array(run.gammas)
    w = 2.0 * math.pi * run.frequency_hz
    period_s = 1.0 / run.frequency_hz
    step_s, fade_s = run.cycles * period_s, max(run.fade_cycles, 1) * period_s
    n = int(len(gammas) * step_s * run.rate_hz)
    most = 200 * len(gammas) * run.cycles
    over = 1 if run.instrument is None else STEPS_PER_SAMPLE if run.rate_hz < FINE_HZ else STEPS_PER_SAMPLE // 2
    plate, edges, impacts = np.zeros(n * over), np.zeros(2 * most), np.zeros((most, 2))
    dt, every = 1.0 / (run.rate_hz * STEPS_PER_SAMPLE), STEPS_PER_SAMPLE // over
    # from a generator of its own, so that other noise is the same with it and without
    off = np.random.default_rng([run.seed, 1]).laplace(0.0, run.hidden.get(SCATTER, 0.0) / math.sqrt(2.0), most)
    n_edges, n_impacts = _march(q, off, gammas, step_s, fade_s, w, float(run.c), dt, every, plate, edges, impacts)
    impacts, edges = impacts[:n_impacts], edges[:n_edges]
    measured = _ideally if run.instrument is None else _by_instrument
    felt_v, circuit_v, drive_s = measured(run, plate, over, impacts, edges, rng)
    command_v = commands(gammas, step_s, fade_s, w, float(run.c), drive_s) / (G * run.g_per_volt)
    command_v = command_v + 0.0005 * rng.standard_normal(n)
    if run.instrument is not None:
        command_v += run.instrument.mains(run.instrument.drive_mains_v, 0.0, drive_s)
    return {
        "time_s": np.arange(n) / run.rate_hz,
        "continuity_v": converted(run.bits, circuit_v),
        "accelerometer_v": converted(run.bits, felt_v),
        "drive_v": converted(run.bits, command_v),
        "impacts": impacts,
        "flights": np.abs(edges[: edges.size // 2 * 2]).reshape(-1, 2),  # edges open and close in turn
    }


def _ideally(
    run: Run, plate: np.ndarray, over: int, impacts: np.ndarray, edges: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Volts of ideal accelerometer and contact, and the times at which the drive is read."""
    n = plate.size // over
    felt = _felt_g(run, plate, run.rate_hz) + run.accelerometer_noise_g * rng.standard_normal(n)
    if run.spikes:
        at = np.minimum((impacts[:, 0] * run.rate_hz).astype(int) + 1, n - 1)
        for lag, size in enumerate((-12.0, 7.0, -4.0, 2.0, -1.0)):
            np.add.at(felt, np.minimum(at + lag, n - 1), size * impacts[:, 1])
    times, opens = edge_times(edges, run.hidden.get(LATENCY, 0.0), run.closure_s, run.jitter_s, rng)
    circuit_v = square_contact(times, opens, n, run.rate_hz, run.contact_rc_s)
    return 0.1 * felt, circuit_v + run.contact_noise_v * rng.standard_normal(n), np.arange(n) / run.rate_hz


def _by_instrument(
    run: Run, plate: np.ndarray, over: int, impacts: np.ndarray, edges: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same by the run's instrument, from the plate's acceleration on a grid ``over`` times as fine."""
    part, n = run.instrument or Instrument(), plate.size // over
    felt = _felt_g(run, plate, over * run.rate_hz)
    felt_v = accelerometer_v(part, felt, impacts, run.rate_hz, over, run.accelerometer_noise_g, rng)
    times, opens = edge_times(edges, run.hidden.get(LATENCY, 0.0), run.closure_s, run.jitter_s, rng)
    circuit_v = contact_v(part, times, opens, run.rate_hz, over, n, rng) + run.contact_noise_v * rng.standard_normal(n)
    return felt_v, circuit_v, np.arange(n) / run.rate_hz + part.shown_at_s(DRIVE, run.rate_hz)


def profile_of(run: Run) -> str:
    """The profile that goes with a recording: what its owner would declare, nothing hidden."""
    settle = min(8, run.cycles // 2)
    form = Template(Path(__file__).with_name("other_profile.toml.in").read_text(encoding="utf-8"))
    return form.safe_substitute(
        rate_hz=run.rate_hz, frequency_hz=run.frequency_hz, c=run.c, g_per_volt=run.g_per_volt,
        reads_gravity=str(run.reads_gravity).lower(), gammas=sorted(run.gammas), settle_cycles=settle,
        hold_cycles=run.cycles - settle,
    )  # fmt: skip


def write(run: Run, folder: Path, ending: str = ".csv") -> Path:
    """Write ``recording.csv`` (or ``.npz``), ``profile.toml`` and the sealed ``truth.json``; the table's path."""
    folder.mkdir(parents=True, exist_ok=True)
    data = simulate(run)
    names = ("time_s", "continuity_v", "accelerometer_v", "drive_v")
    path = folder / f"recording{ending}"
    if ending == ".npz":
        np.savez(path, **{name: data[name] for name in names})
    else:
        table = np.column_stack([data[name] for name in names])
        layout = ("%.6f", "%.4f", "%.5f", "%.5f")
        np.savetxt(path, table, fmt=layout, delimiter=",", header=",".join(names), comments="")
    (folder / "profile.toml").write_text(profile_of(run), encoding="utf-8")
    (folder / "truth.json").write_text(json.dumps(asdict(run), indent=1), encoding="utf-8")
    return path


def hidden_by(effect: str, strength: str) -> dict[str, float]:
    """Values of one effect at a strength: weak, medium or strong."""
    place = ("weak", "medium", "strong").index(strength)
    return {f"{effect}.{key}": sizes[place] for key, sizes in SIZES[effect].items()}


def main() -> None:
    """Write one recording from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--c", type=int, default=1)
    parser.add_argument("--effect", action="append", default=[], choices=sorted(SIZES))
    parser.add_argument("--strength", default="strong", choices=("weak", "medium", "strong"))
    parser.add_argument("--gamma", nargs=3, type=float, default=None, metavar=("START", "STOP", "STEPS"))
    parser.add_argument("--cycles", type=int, default=20)
    parser.add_argument("--shuffle", action="store_true", help="steps in random order")
    parser.add_argument("--spikes", action="store_true", help="impacts show in the accelerometer")
    parser.add_argument("--closure-ms", type=float, default=0.0, help="an impact holds the circuit closed this long")
    parser.add_argument("--contact-rc-us", type=float, default=0.0, help="low-pass behind the sampled comparator")
    parser.add_argument("--contact-noise-mv", type=float, default=10.0, help="noise of the contact circuit")
    parser.add_argument("--jitter-us", type=float, default=20.0, help="jitter of the contact's edges")
    parser.add_argument("--bits", type=int, default=0, help="of the converters, +-10 V; 0: fine")
    parser.add_argument("--frequency", type=float, default=25.37, help="Hz")
    parser.add_argument("--rate", type=float, default=20000.0, help="samples a second")
    parser.add_argument("--no-gravity", action="store_true", help="the accelerometer does not read gravity")
    parser.add_argument("--part", action="append", default=[], metavar="NAME=VALUE", help="of the instrument")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    parts = {name: float(value) for name, _, value in (part.partition("=") for part in args.part)}
    usual = {1: (0.5, 2.6, 22), 2: (0.2, 1.5, 22), 3: (0.1, 0.8, 22)}
    start, stop, steps = args.gamma or usual.get(args.c, (0.1, 0.5, 22))
    gammas = np.round(np.linspace(start, stop, int(steps)), 4)
    if args.shuffle:
        gammas = np.random.default_rng(args.seed).permutation(gammas)
    hidden = {key: value for effect in args.effect for key, value in hidden_by(effect, args.strength).items()}
    run = Run(
        c=args.c, gammas=tuple(gammas.tolist()), cycles=args.cycles, spikes=args.spikes,
        closure_s=1e-3 * args.closure_ms, seed=args.seed, hidden=hidden, frequency_hz=args.frequency,
        rate_hz=args.rate, reads_gravity=not args.no_gravity, contact_rc_s=1e-6 * args.contact_rc_us,
        contact_noise_v=1e-3 * args.contact_noise_mv, jitter_s=1e-6 * args.jitter_us, bits=args.bits,
        instrument=Instrument(**parts) if parts else None,
    )  # fmt: skip
    print(write(run, args.folder))


if __name__ == "__main__":
    main()
