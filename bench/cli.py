"""The command line `bench`: one line a command; each command lives in a file of its own under `bench/commands`.

The rule kept here: nothing heavy is imported before a command runs, so `bench --help` stays instant. A command is
registered as ``name: (module, one-line help)``; its module is imported only when it is called.
"""

from __future__ import annotations

import importlib
from typing import Any

import typer
from typer.core import TyperGroup

COMMANDS: dict[str, tuple[str, str]] = {
    "plan": ("bench.commands.plan", "Print every step of a profile's ramp, and refuse what a limit forbids."),
    "devices": ("bench.commands.devices", "List sound cards and serial ports, and which profile fits."),
    "check": ("bench.commands.check", "Before a run: is the rig wired as its profile says?"),
    "calibrate": ("bench.commands.calibrate", "Measure a rig's scales and write them into its profile."),
    "ramp": ("bench.commands.ramp", "Run a profile's ramp and record it."),
    "import": ("bench.commands.import_", "Turn somebody's CSV, HDF5, NPZ or WAV into a recording."),
    "export": ("bench.commands.export", "Write a recording as CSV, NPZ or gzip HDF5."),
    "reprocess": ("bench.commands.reprocess", "Recording to flights, plate motion and pictures."),
    "compare": ("bench.commands.compare", "Hold a recording against the model, step by step."),
    "predict": ("bench.commands.predict", "What the model says: orbits, diagrams, bifurcations."),
    "close-loop": ("bench.commands.close_loop", "Find the residual, name the missing effect, report before and after."),
    "drop": ("bench.commands.drop", "Drop tests by camera, sound or contact."),
    "verify": ("bench.commands.verify", "Say whether a recording is complete, stopped, incomplete or damaged."),
    "recover": ("bench.commands.recover", "Rebuild a verified recording from one that was cut off."),
    "virtual": ("bench.commands.virtual", "The simulated plant as a process of its own, behind a real driver."),
    "demo": ("bench.commands.demo", "The main job on a simulated rig, end to end."),
}


class LazyGroup(TyperGroup):
    """A group that knows its commands' names without importing them."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Every command, in the order a person meets them."""
        return list(COMMANDS)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the overview from the table alone."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, summary) for name, (_, summary) in COMMANDS.items()])

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Import the module of ``cmd_name`` and build its command from the module's function ``command``."""
        if cmd_name not in COMMANDS:
            return None
        module_name, summary = COMMANDS[cmd_name]
        module: Any = importlib.import_module(module_name)
        single = typer.Typer(add_completion=False, rich_markup_mode=None)
        single.command(name=cmd_name, help=module.command.__doc__ or summary)(module.command)
        return typer.main.get_command(single)


app = typer.Typer(cls=LazyGroup, add_completion=False, no_args_is_help=True, rich_markup_mode=None)


@app.callback()
def _desk() -> None:
    """A completely inelastic ball on a shaken plate: drive it, record it, predict it, explain it."""


def main() -> None:
    """Entry point of the console script."""
    app()
