"""`bench virtual`: the simulated plant as a process of its own, behind a real audio driver."""

from __future__ import annotations

import time
from pathlib import Path

import typer

from bench.outputs import NPZ, File, Overwrite, Seed, check_outputs
from bench.outputs import Scenario as ScenarioFile


def command(
    profile: str = typer.Argument(help="A sound-card profile's path, or the name of a shipped one."),
    scenario: ScenarioFile = None,
    seed: Seed = 0,
    server: str = typer.Option("default", "--server", metavar="NAME", help="JACK server; started if it is not there."),
    period: int = typer.Option(256, "--period", min=16, help="Frames of one period of a server that is started here."),
    for_s: float | None = typer.Option(None, "--for", metavar="SECONDS", help="Leave by itself after so long."),
    log: Path | None = typer.Option(None, "--log", metavar="FILE", help="Keep all that the plant gave, for tests."),
    ppm: float = typer.Option(80.0, "--ppm", help="By how much the clock of a virtual serial device is off."),
    overwrite: Overwrite = False,
) -> None:
    """Start the plant as a sound card that `bench ramp` can run against, in real time; Ctrl-C ends it.

    Example: bench virtual soundcard   (and in another terminal: bench ramp soundcard --out rehearsal.h5)

    Where the profile's back end is soundcard+serial, the frames leave by a pseudo-terminal that backend.port leads to.
    The drive, the interlocks and the stops are then those of a real run. Where --server is not "default", the other
    terminal needs JACK_DEFAULT_SERVER set to the same name.

    Exits 0 when it was ended, 2 when the call was wrong or JACK is not there.
    """

    from bench.profiles.find import find_scenario, load
    from bench.terminal.run_console import stop_on_signals
    from rig.backends.kinds.soundcard import card_options
    from rig.sim.scenario import Scenario, load_scenario
    from rig.virtual.jack import JackPlant, PlantLog, jack_server
    from rig.virtual.serial import JackSerialPlant

    check_outputs(File("--log", log, NPZ), inputs=[profile, scenario], overwrite=overwrite)
    checked, _ = load(profile)
    device, rate_hz = card_options(checked.backend).device, checked.sampling.rate_hz
    hidden = Scenario("ideal") if scenario is None else load_scenario(find_scenario(scenario))
    with stop_on_signals() as request, jack_server(server, rate_hz, period) as started, PlantLog(log) as keep:
        plant = (
            JackSerialPlant(checked, hidden, seed, server, ppm=ppm, ppm_per_minute=0.0)
            if checked.backend.kind == "soundcard+serial"
            else JackPlant(checked, hidden, seed, server, keep)
        )
        with plant:
            was = "started" if started else "was there"
            typer.echo(f"{device!r} on JACK server {server!r} ({was}), {rate_hz:g} Hz: ready")
            until = None if for_s is None else time.monotonic() + for_s
            while request.wanted is None and plant.alive and (until is None or time.monotonic() < until):
                time.sleep(0.1)
            typer.echo(f"frames the server skipped: {plant.skipped_frames}")
