"""One trial: a sealed recording, the verdict on it, and only then what was hidden.

Everything of a trial is drawn from its seed; the verdict is written down before the truth is read.
"""

from __future__ import annotations

import json
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.plants import other_plant as plant
from kernels.arrays import Floats

if TYPE_CHECKING:
    from analysis.loop.result import Predictions

STRONG_BELOW, WEAK_ABOVE = 0.35, 1.6  # sizes are drawn from the medium to the strong one, and about the weak one
DECLARED = ("coulomb_friction", "restitution", "viscous_damping")
BETWEEN_SAMPLES_HZ = (22.31, 25.37, 31.73)
WHOLE_SAMPLES_HZ = (20.0, 25.0, 40.0)  # a period of so many samples rounds every cycle alike
CONTACTS: dict[str, dict[str, float]] = {
    "jittered": {"jitter_s": 2e-5},
    "read once a sample": {"jitter_s": 0.0},
    "read once a sample, RC behind": {"jitter_s": 0.0, "contact_rc_s": 1e-4},
}
"""Contact circuits: edges that jitter, a comparator with the converter's clock, and one with a low-pass behind it."""


@dataclass(frozen=True)
class Job:
    """What to hide and where: ``kind`` is strong, weak, clean, declared, outside or pair.

    ``varied``: conditions are drawn from the seed, see `conditions`; ``longer``: 30 steps of 50 cycles.
    """

    kind: str
    plant: str
    effects: tuple[str, ...]
    c: int
    seed: int
    varied: bool = False
    longer: bool = False

    @property
    def key(self) -> str:
        """A name of its own."""
        hidden, how = "+".join(self.effects) or "-", "varied/" * self.varied + "longer/" * self.longer
        return f"{how}{self.kind}/{self.plant}/{hidden}/{self.c}/{self.seed}"


def run(job: Job) -> dict[str, Any]:
    """Make the recording, close the loop on it, then open the seal."""
    from analysis.loop.close_loop import fit_loop
    from analysis.loop.tables import loop_json
    from analysis.residuals.prediction_errors import scored_rows
    from model.effects.registry import effect

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recording = (other if job.plant == "other" else own)(job, folder)
        start = time.process_time()
        loop, fitted = fit_loop([recording])
        seconds = time.process_time() - start
        found = json.loads(json.dumps(loop_json(loop)))
        truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    model, best = fitted.model, fitted.selection.best.fitted.values
    rows, _ = scored_rows(model, best, loop.steps.held_out)
    discovered = None
    if loop.discovered is not None:
        d = loop.discovered
        discovered = {
            "term": d.term, "covariate": d.covariate.words, "description": d.description,
            "tied": list(d.tied_covariates),
            "rms_us": d.after.landing_rms_us, "robust_us": d.after.landing_nmad_us, "floor_us": d.noise_floor_us,
        }  # fmt: skip
    declared = fitted.selection.before.fitted.values
    kept = ("verdict", "effects", "tie_set", "before", "after", "noise_floor_us", "remainder", "rounds")
    z = _unit_landings(loop.flights.after)[rows]
    floor_z = float(np.sqrt(np.mean(z**2))) if len(rows) else None
    return {
        "job": job.key, "kind": job.kind, "plant": job.plant, "hidden": list(job.effects), "c": conditions(job)["c"],
        "conditions": conditions(job) if job.varied else None,
        "seconds": seconds, "flights": len(loop.flights), "steps": len(loop.steps),
        "size": size_of(model, {k: x for k, x in declared.items() if effect(k[0]).effect.nuisance}),
        "size_left": size_of(model, declared),
        "truth": truth, "discovered": discovered, "after_z": floor_z,
        **{k: found[k] for k in kept},
    }  # fmt: skip


def _unit_landings(p: Predictions) -> Floats:
    """Landing residuals over their uncertainty, clipped at 6, (n,)."""
    z = p.landing_residual_s / p.landing_sigma_s
    return np.asarray(np.clip(np.where(np.isfinite(p.landing_residual_s), z, 6.0), -6.0, 6.0))


def size_of(model: Any, values: Any) -> dict[str, float]:
    """Root mean square residual at ``values`` over the uncertainty, noise taken out, by channel; grazes left out."""
    from analysis.residuals.noise.uncertainty import uncertainty_at
    from analysis.residuals.prediction_errors import near_grazing

    u, r, ev = uncertainty_at(model, values), model.residuals(values), model.observations
    firm, out = ~near_grazing(model, values), {}
    for name, residual, sigma, rows in (
        ("landing", r.landing_s, u.landing_total_s, ev.scored & firm),
        ("opening", r.opening_s, u.opening_total_s, model.from_rest & firm),
    ):  # fmt: skip
        if rows.any():
            z = np.where(np.isfinite(residual), residual / sigma, 1e3)[rows]
            out[name] = _beyond_noise(z)
    plate = r.plate / ev.plate.sigma
    for kind in np.unique(ev.plate.kind):
        out[f"plate {kind}"] = _beyond_noise(plate[ev.plate.kind == kind])
    return out


def _beyond_noise(z: Floats) -> float:
    return float(np.sqrt(max(np.mean(np.clip(z, -1e3, 1e3) ** 2) - 1.0, 0.0)))


# -- the other plant ----------------------------------------------------------------------------------------------
def other(job: Job, folder: Path) -> Path:
    """A foreign recording (CSV of volts, no step table), imported with its profile."""
    from daq.importers.formats.open import open_source
    from daq.importers.import_recording import import_recording
    from rig.profile import load_setup

    rng = np.random.default_rng(job.seed)
    under = conditions(job)
    usual = {1: (0.5, 2.6), 2: (0.2, 1.5), 3: (0.1, 0.8)}[under["c"]]
    gammas = rng.permutation(np.round(np.linspace(*usual, under.pop("steps")), 4))
    contact = CONTACTS.get(under.pop("contact", ""), {})
    hidden: dict[str, float] = {}
    for effect in job.effects:
        hidden |= _drawn(plant.SIZES[effect], effect, job.kind, rng)
    sensors = {
        "spikes": bool(rng.random() < 0.5), "closure_s": float(rng.choice((1e-4, 5e-4))),
        "jitter_s": float(rng.choice((5e-6, 2e-5))), "frequency_hz": float(rng.choice(BETWEEN_SAMPLES_HZ)),
        "reads_gravity": bool(rng.random() < 0.5),
    }  # fmt: skip
    gamma = tuple(gammas.tolist())
    sealed = plant.Run(**{**sensors, **contact, **under}, gammas=gamma, seed=job.seed, hidden=hidden)
    raw = plant.write(sealed, folder, ".npz" if job.varied else ".csv")
    profile = folder / "profile.toml"
    if job.kind == "declared":
        _declare(profile, hidden)
    setup, text = load_setup(profile)
    out = folder / "recording.h5"
    import_recording(open_source(raw), out, setup, text)
    raw.unlink()
    (folder / "truth.json").write_text(json.dumps(hidden), encoding="utf-8")
    return out


def conditions(job: Job) -> dict[str, Any]:
    """The recording's c and number of steps; where they vary, also length, rate, noise, contact, converters and drive.

    A third of the drives have a period of a whole number of samples.
    """
    if not job.varied:
        return {"c": job.c, **({"steps": 30, "cycles": 50} if job.longer else {"steps": 22})}
    rng = np.random.default_rng((job.seed, 1))
    return {
        "c": int(rng.choice((1, 2, 3))),
        "steps": int(rng.choice((12, 22, 33))),
        "cycles": int(rng.choice((14, 20, 40))),
        "rate_hz": float(rng.choice((20e3, 50e3, 100e3, 200e3), p=(0.4, 0.3, 0.2, 0.1))),
        "accelerometer_noise_g": float(rng.choice((0.01, 0.03, 0.1))),
        "contact": str(rng.choice(list(CONTACTS))),
        "bits": int(rng.choice((12, 16))),
        "frequency_hz": float(rng.choice(WHOLE_SAMPLES_HZ if rng.random() < 1.0 / 3.0 else BETWEEN_SAMPLES_HZ)),
    }


def _drawn(sizes: dict[str, tuple[float, float, float]], effect: str, kind: str, rng: Any) -> dict[str, float]:
    """Values of an effect: its sizes drawn together, what is the same at every strength drawn apart."""
    share = rng.random()
    out = {}
    for name, (weak, medium, strong) in sizes.items():
        if weak == strong:
            out[f"{effect}.{name}"] = weak * float(np.exp(rng.uniform(-0.25, 0.25)))
            continue
        low, high = (weak, WEAK_ABOVE * weak) if kind == "weak" else (max(medium, STRONG_BELOW * strong), strong)
        out[f"{effect}.{name}"] = float(low * (high / low) ** share) if low > 0 else float(share * high)
    return out


def _declare(profile: Path, hidden: dict[str, float]) -> None:
    """Write what the rig has into its profile, as an owner who knows it would."""
    from benchmarks.scoring.truth import OTHER_PARAMETERS

    tables: dict[str, list[str]] = {}
    for key, value in hidden.items():
        for effect, parameter, factor in OTHER_PARAMETERS.get(key, ()):
            size = value * factor
            tables.setdefault(effect, []).append(
                f'{parameter} = {{ value = {size!r}, uncertainty = {0.01 * abs(size)!r}, source = "known" }}'
            )
    if "restitution.slope_s_per_m" in hidden:
        tables["restitution"].append(f"e1_s_per_m = {hidden['restitution.slope_s_per_m']!r}")
    text = "".join(f"\n[declared.{effect}]\n" + "\n".join(rows) + "\n" for effect, rows in tables.items())
    profile.write_text(profile.read_text(encoding="utf-8") + text, encoding="utf-8")


# -- the own rig --------------------------------------------------------------------------------------------------
def own(job: Job, folder: Path) -> Path:
    """A ramp on the simulated rig, as `bench ramp` drives it."""
    from bench.jobs.run_ramp import make_backend, record
    from bench.profiles.find import load
    from rig.sim.scenario import sealed_scenario

    rng = np.random.default_rng(job.seed)
    strength = "weak" if job.kind == "weak" else "strong"
    scenario = sealed_scenario(
        rng,
        job.effects,
        strength=strength,
        count=len(job.effects),
        nuisances=bool(rng.random() < 0.5),  # type: ignore[arg-type]
    )
    sealed = folder / "sealed.toml"
    sealed.write_text(scenario.to_toml(), encoding="utf-8")
    profile, text = load("simulated")
    ramp = profile.ramp.model_copy(update={"order": "shuffled"})
    forcing = profile.forcing.model_copy(update={"ratio": job.c})
    gamma = np.round(np.linspace(*{1: (0.4, 2.6), 2: (0.2, 1.5), 3: (0.1, 0.8)}[job.c], 22), 4)
    ramp = ramp.model_copy(update={"gamma": tuple(gamma.tolist())})
    profile = profile.model_copy(update={"ramp": ramp, "forcing": forcing})
    out = folder / "recording.h5"
    record(profile, text, make_backend(profile, scenario=sealed, seed=job.seed), out, quiet=True)
    (folder / "truth.json").write_text(json.dumps(scenario.effects), encoding="utf-8")
    return out
