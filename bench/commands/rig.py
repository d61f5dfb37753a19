"""`bench devices`, `check`, `calibrate`, `virtual`: what is plugged in, wired how, its scales; a plant in its place."""

from __future__ import annotations

import time
from pathlib import Path

import typer
from rich.table import Table

from bench.outputs import JSON, NPZ, PROFILE, File, Json, Overwrite, Scenario, Seed, check_outputs
from bench.terminal.console import fail, print_lines, print_table, write_json
from daq.setup.errors import InputError

KINDS = ("accelerometer", "drive", "contact")


def devices(
    profiles: list[str] = typer.Argument(None, metavar="[PROFILE]...", help="Profiles to hold against what is there."),
    json: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """List sound cards and serial ports, and which profiles (the shipped ones, and those named) fit them.

    Example: bench devices my_rig.toml

    Exits 0, also when nothing is there; 2 when a profile cannot be read.
    """
    from bench.jobs.run_ramp import found_devices

    check_outputs(File("--json", json, JSON), inputs=profiles or [], overwrite=overwrite)
    found = found_devices(profiles or [])
    if not write_json(found, json):
        return
    listed, ports, why = found["cards"], found["ports"], found["problem"]
    table = Table("sound card", "driver", "in", "out", "rate (Hz)", "profiles that fit", box=None, pad_edge=False)
    for card in listed:
        keys = ("name", "driver", "inputs", "outputs", "rate_hz")
        table.add_row(*(str(card[key]) for key in keys), ", ".join(card["profiles"]))
    if listed:
        print_table(table)
    else:
        print_lines(f"no sound card{': ' + why if why else ''}")
    print_lines(*(f"serial port {p['port']}  {p['description']}" for p in ports) if ports else ["no serial port"])


def check(
    profile: str = typer.Argument(help="A profile's path, or the name of a shipped one."),
    scenario: Scenario = None,
    seed: Seed = 0,
    tap: bool = typer.Option(False, "--tap", help="Wait for one hit on the resting table, and say how it rings."),
    json: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Play a chirp, a quiet tone and a short flight, and say of each channel whether it is what the profile says.

    Examples: bench check soundcard

    bench check soundcard --tap

    Exits 0 when everything passed, 1 when something did not, 2 when the call was wrong.
    """
    from bench.jobs.run_ramp import check_rig, open_rig

    check_outputs(File("--json", json, JSON), inputs=[profile, scenario], overwrite=overwrite)
    checked, backend = open_rig(profile, "check", scenario, seed)
    findings = check_rig(checked, backend, tap=tap)
    if write_json({"profile": checked.name, "findings": findings}, json):
        table = Table("", "what", "seen", "what to do", box=None, pad_edge=False)
        words = {True: "[green]pass[/]", False: "[red]FAIL[/]", None: "[yellow]?[/]"}
        for found in findings:
            table.add_row(words[found.passed], found.what, found.seen, "" if found.passed else found.remedy)
        print_table(table)
    if bad := [finding.what for finding in findings if finding.passed is False]:
        fail(f"not as the profile says: {', '.join(bad)}")


def calibrate(
    kind: str = typer.Argument(help="accelerometer, drive or contact; in this order on a new rig."),
    into: Path = typer.Option(..., "--into", metavar="PROFILE", help="The profile's file, used and written."),
    scenario: Scenario = None,
    seed: Seed = 0,
    json: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Measure the rig's scales and write them into its profile, each with its uncertainty, date and source.

    accelerometer: flip test (rest, upside down, rest; nothing is driven). drive: gain and phase of the plate for a
    volt, the block resting on it. contact: levels of the circuit, and how late it is to the impacts.

    Example: bench calibrate accelerometer --into my_rig.toml

    Exits 0 when the values were written, 1 when the device failed, 2 when the call was wrong or nothing could be
    measured; the profile is then left as it was.
    """
    from bench.jobs.calibrate import calibrate_into

    if kind not in KINDS:
        raise InputError(f"{kind}: wanted one of {', '.join(KINDS)}")
    edited = File("--into", into, PROFILE, edited=True)
    check_outputs(edited, File("--json", json, JSON), inputs=[scenario], overwrite=overwrite)
    profile, backend, measured = calibrate_into(into, kind, scenario, seed, _ask)
    answer = {"profile": into, "simulated": backend.simulated, "measured": measured}
    if not write_json(answer, json):
        return
    table = Table("key", "before", "measured", "uncertainty", box=None, pad_edge=False)
    for one in measured:
        before: object = profile
        for name in one.key.split("."):
            before = before.get(name) if isinstance(before, dict) else getattr(before, name, None)
        shown = "-" if before is None else f"{getattr(before, 'value', before):.6g}"
        table.add_row(one.key, shown, f"{one.value:.6g}", f"{one.uncertainty:.2g}")
    print_table(table)
    typer.echo(f"written into {into}")


def _ask(over: bool) -> None:
    """Have the operator turn the sensor."""
    how = "upside down (its axis plumb)" if over else "as it is mounted (its axis plumb)"
    typer.prompt(f"Lay the accelerometer {how}, let it lie still, and press Enter", default="", show_default=False)


def virtual(
    profile: str = typer.Argument(help="A sound-card profile's path, or the name of a shipped one."),
    scenario: Scenario = None,
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
    from rig.sim.scenario import Scenario as Hidden
    from rig.sim.scenario import load_scenario
    from rig.virtual import JackPlant, JackSerialPlant, jack_server

    check_outputs(File("--log", log, NPZ), inputs=[profile, scenario], overwrite=overwrite)
    checked, _ = load(profile)
    device, rate_hz = card_options(checked.backend).device, checked.sampling.rate_hz
    hidden = Hidden("ideal") if scenario is None else load_scenario(find_scenario(scenario))
    with stop_on_signals() as request, jack_server(server, rate_hz, period) as started:
        plant = (
            JackSerialPlant(checked, hidden, seed, server, ppm=ppm, ppm_per_minute=0.0)
            if checked.backend.kind == "soundcard+serial"
            else JackPlant(checked, hidden, seed, server, log)
        )
        with plant:
            was = "started" if started else "was there"
            typer.echo(f"{device!r} on JACK server {server!r} ({was}), {rate_hz:g} Hz: ready")
            until = None if for_s is None else time.monotonic() + for_s
            while request.wanted is None and plant.alive and (until is None or time.monotonic() < until):
                time.sleep(0.1)
            typer.echo(f"frames the server skipped: {plant.skipped_frames}")
