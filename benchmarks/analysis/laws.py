"""Causes outside the library: covariate, error and formula, and what the formula foretells of another forcing.

    python -m benchmarks.analysis.laws RESULTS --seed-base 1000 --minutes 30 [--peers]

Each trial hides one strong cause that the library lacks. What is discovered on one ramp is carried, as it stands, to a
ramp of the same rig at another ``c``: only calibrations are fitted there. ``--peers`` has other people's regressions of
the same flights, as far as installed (``pip install gplearn pysindy``).
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from analysis.attribution.candidates import priors_of
from analysis.attribution.fit import Fitter
from analysis.discovery.discover import Discovery
from analysis.discovery.symbolic import curve_of
from analysis.discovery.terms import IN_FLIGHT, AugmentedModel, event_term, ranges_of
from analysis.loop.close_loop import fit_loop
from analysis.residuals.forward_model import ForwardModel
from analysis.residuals.noise.whitening import Whitener
from analysis.residuals.observations import observations_from
from analysis.residuals.prediction_errors import held_out_errors, noise_floors_us, scored_rows
from analysis.residuals.values import ParameterId
from benchmarks.analysis.law_peers import PEERS, peer_errors
from benchmarks.scoring.design import jobs
from benchmarks.scoring.tables import rate
from benchmarks.scoring.trial import Job, other, own
from benchmarks.scoring.truth import expected_covariate
from benchmarks.scoring.version import code_version
from daq.files.disk import Journal
from kernels.arrays import Floats
from model.effects.registry import effect, resolve

Row = dict[str, Any]


def carried(found: Discovery, model: ForwardModel) -> AugmentedModel:
    """Another recording's forward model with what was discovered: its formula, or its curve where it has none."""
    term, up = event_term(found.term, found.of), -1.0 if found.term == "force" else 1.0  # it is carried as a pull
    if found.within_flight:
        term, up = next(t for t in IN_FLIGHT if (t.name, t.of) == (found.term, found.of)), 1.0

    def at(x: Floats) -> Floats:
        along = np.interp(np.nan_to_num(x), found.curve.knots, found.curve.values)
        return up * (along if found.form is None else found.form.at(x))

    tables, span = model.covariates({}), (float(found.curve.knots[0]), float(found.curve.knots[-1]))
    if found.within_flight:  # flights of the other forcing may go farther
        low, high = ranges_of(tables, model.observations.scored)[found.of]
        span = min(span[0], low), max(span[1], high)
    return AugmentedModel(model, [curve_of(term, span, tables, at)], tables["dwell_s"])


def elsewhere(found: Discovery, named: dict[ParameterId, float], recording: Path) -> dict[str, float]:
    """Landing errors on another recording in us rms: of the ideal model, with the discovery, and what noise leaves."""
    observations = observations_from([recording])
    plain = ForwardModel(observations, resolve(observations.setup.declared_values()))
    every = np.ones(len(observations.steps), dtype=np.bool_)
    out: dict[str, float] = {}
    for name, model, start in (("before", plain, {}), ("after", carried(found, plain), named)):
        values = Fitter(model, priors_of(observations.setup), every).fit(Whitener.of(model, start), (), start).values
        rows, left_out = scored_rows(model, values, every)
        out[name] = held_out_errors(model, values, rows, left_out).landing_rms_us
        out["floor"] = noise_floors_us(model, values, rows)[0]
    return out


def run(job: Job, *, peers: bool) -> Row:
    """One trial."""
    make = other if job.plant == "other" else own
    with tempfile.TemporaryDirectory() as name:
        here, there = Path(name, "here"), Path(name, "there")
        for folder in (here, there):
            folder.mkdir()
        start = time.process_time()
        loop, fitted = fit_loop([make(job, here)])
        row: Row = {
            "job": job.key, "plant": job.plant, "hidden": job.effects[0], "c": job.c, "verdict": loop.verdict,
            "seconds": time.process_time() - start, "truth": json.loads((here / "truth.json").read_text("utf-8")),
        }  # fmt: skip
        if (found := loop.discovered) is not None:
            form, best = found.form, fitted.selection.best
            row |= {
                "covariate": found.covariate.words, "of": found.of, "rms_us": found.after.landing_rms_us,
                "floor_us": found.noise_floor_us, "words": found.description,
                "form": None if form is None else [form.expression, form.parameters, form.values, form.sigmas],
            }  # fmt: skip
            named = {k: v for k, v in best.fitted.values.items() if k in best.free and k[0] not in found.instead_of}
            second = dataclasses.replace(job, c=3 - job.c)
            recording = make(second, there)
            row["elsewhere"] = elsewhere(found, named, recording)
            if peers:
                observations, fitter = observations_from([recording]), best.fitter
                plain = ForwardModel(observations, resolve(observations.setup.declared_values()))
                beyond = Fitter(plain, fitter.priors, np.ones(len(observations.steps), dtype=np.bool_))
                values = {k: v for k, v in best.fitted.values.items() if effect(k[0]).effect.nuisance}
                row["peers"] = {peer: peer_errors(peer, fitter, values, beyond) for peer in PEERS}
    return row


def show(rows: list[Row]) -> None:
    """The table, and each trial."""
    print("| plant | covariate named | error after within 1.5 floors | a formula | another forcing within 2 floors |")
    print("|---|---|---|---|---|")
    for plant in ("other", "own"):
        some = [r for r in rows if r["plant"] == plant and expected_covariate(plant, r["hidden"])]
        right = rate(some, lambda r, plant=plant: r.get("covariate") == expected_covariate(plant, r["hidden"]))
        near = rate(some, lambda r: "form" in r and r["rms_us"] <= 1.5 * r["floor_us"])
        formula = rate(some, lambda r: r.get("form") is not None)
        far = rate(some, lambda r: "form" in r and r["elsewhere"]["after"] <= 2.0 * r["elsewhere"]["floor"])
        print(f"| {plant} | {right} | {near} | {formula} | {far} |")
    for peer in PEERS:
        some = [r for r in rows if peer in r.get("peers", ())]
        near = rate(some, lambda r, peer=peer: r["peers"][peer]["here"] <= 1.5 * r["floor_us"])
        far = rate(some, lambda r, peer=peer: r["peers"][peer]["there"] <= 2.0 * r["elsewhere"]["floor"])
        print(f"| {peer} | | {near} | | {far} |")
    for r in rows:
        print(json.dumps(r))


def main() -> None:
    """Run what is missing within the time, then print."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("results", type=Path)
    options.add_argument("--seed-base", type=int, default=1000)
    options.add_argument("--peers", action="store_true")
    options.add_argument("--minutes", type=float, default=60.0, help="no trial is begun later")
    args = options.parse_args()
    journal, version, end = Journal(args.results), code_version(), time.monotonic() + 60.0 * args.minutes
    for job in jobs(args.seed_base):
        if job.kind != "outside" or f"{version}:{job.key}" in journal.rows or time.monotonic() > end:
            continue
        journal.add(f"{version}:{job.key}", run(job, peers=args.peers))
    show([row for key, row in journal.rows.items() if key.startswith(f"{version}:")])


if __name__ == "__main__":
    main()
