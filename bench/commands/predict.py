"""`bench predict`: what the model says, at one gamma, or over a range of gammas."""

from __future__ import annotations

from pathlib import Path

import typer

from bench.outputs import Json, Overwrite
from daq.setup.errors import InputError


def command(
    c: int = typer.Option(1, "--c", min=1, help="Second tone's multiple of the first; 1 is one sine."),
    gamma: float | None = typer.Option(None, help="A w^2 / g, the paper's Gamma."),
    gamma_peak: float | None = typer.Option(None, help="Peak plate acceleration / g, in place of --gamma, at c = 1."),
    gamma_range: tuple[float, float] | None = typer.Option(None, help="From and to, in gamma."),
    bifurcations: bool = typer.Option(False, "--bifurcations", help="List every bifurcation in --gamma-range."),
    branches: bool = typer.Option(False, "--branches", help="Cycles of one and two flights, unstable ones too."),
    effect: list[str] = typer.Option([], help="name.parameter=value, such as restitution.e0=0.514; repeatable."),
    frequency_hz: float | None = typer.Option(None, help="First tone, Hz: flight times in seconds, effects in SI."),
    profile: str | None = typer.Option(None, help="Forcing, frequency, effects of a profile; only that: its steps."),
    what_if: list[str] = typer.Option([], help="KEY=number in the profile, such as ball.mass_kg=0.1; repeatable."),
    sweep: str | None = typer.Option(None, help="up or down: carry the state from gamma to gamma, as a bench does."),
    phase_deg: float = typer.Option(0.0, help="Phase of the second tone, degrees."),
    steps: int = typer.Option(1000, min=2, help="Gammas of a diagram over --gamma-range."),
    adaptive: bool = typer.Option(False, "--adaptive", help="More gammas where something happens."),
    narrowest: float | None = typer.Option(None, help="Narrowest window of gamma listed; 1e-6, bouncing 1e-3."),
    grid: list[str] = typer.Option([], help="name.parameter=from:to:count: one more axis of a diagram."),
    keep: int = typer.Option(64, min=1, help="Flight times stored of each point of a diagram."),
    workers: int = typer.Option(1, min=1, help="Processes for a diagram."),
    cluster: str | None = typer.Option(None, help="Dask scheduler for a diagram: tcp://host:port, or 'local'."),
    json: Json = None,
    out: Path | None = typer.Option(None, help="HDF5 file for a diagram; continued if it is there, unfinished."),
    figure: Path | None = typer.Option(None, help="Picture of a diagram (PNG, PDF or SVG)."),
    overwrite: Overwrite = False,
) -> None:
    """Predict orbits, bifurcation diagrams and bifurcations.

    The orbit starts from rest on the plate; --sweep carries the state from one gamma to the next instead.

    Examples: bench predict --c 2 --gamma 1.28 --json -

    bench predict --c 1 --gamma-range 0.5 6 --bifurcations --json -

    bench predict --c 2 --gamma-range 0.2 3 --out diagram.h5 --figure diagram.png

    bench predict --c 1 --gamma-range 1.6 3 --branches --figure branches.png

    bench predict --profile better.toml --what-if ball.mass_kg=0.1

    bench predict --gamma-range 0.5 4 --grid restitution.e0=0:0.9:100 --keep 1 --workers 2 --out map.h5 --figure map.png
    """
    given = dict(locals())
    from bench.predict.answer import run
    from bench.predict.request import DiagramOptions, Files, GivenProfile, Request

    axes, name, what_if = (given.pop(key) for key in ("grid", "profile", "what_if"))
    if what_if and name is None:
        raise InputError("--what-if replaces values of a profile: give --profile with it")
    diagram, files = (
        {name: given.pop(name) for name in names.split()}
        for names in ("steps adaptive keep workers cluster", "json out figure overwrite")
    )
    run(
        Request(
            ratio=given.pop("c"), effects=tuple(given.pop("effect")), **given,
            profile=None if name is None else GivenProfile(name, tuple(what_if)),
            diagram=DiagramOptions(grid=tuple(axes), **diagram), files=Files(**files),
        )
    )  # fmt: skip
