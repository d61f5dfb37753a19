"""The table of commands and the entry point; commands are functions of the files in `bench/commands`.

Nothing heavy is imported before a command runs, so `bench --help` stays instant. A command is registered as ``name:
(module:function, one-line help)``; its module is imported only when it is called. Without a function's name it is
``command``; ``app`` is a command with commands of its own.
"""

from __future__ import annotations

import difflib
import errno
import importlib
import os
import sys
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperGroup

from bench.terminal.console import DEFECTS, EXIT_FAILED, EXIT_USAGE, end_with_defect, fail
from kernels import BLAS_THREADS
from kernels.errors import InputError

COMMANDS: dict[str, tuple[str, str]] = {
    "profile": ("profile:app", "List, show and make profiles of rigs."),
    "plan": ("profile:plan", "Print every step of a profile's ramp, and refuse what a limit forbids."),
    "devices": ("rig:devices", "List sound cards and serial ports, and which profile fits."),
    "check": ("rig:check", "Before a run: is the rig wired as its profile says?"),
    "calibrate": ("rig:calibrate", "Measure a rig's scales and write them into its profile."),
    "ramp": ("ramp:ramp", "Run a profile's ramp and record it."),
    "live": ("live", "A page to start, watch and stop runs, in a browser."),
    "explore": ("ramp:explore", "Let the rig choose its own steps until one explanation stands."),
    "import": ("exchange:import_", "Turn somebody's CSV, HDF5, WAV, MATLAB or other file into a recording."),
    "export": ("exchange:export", "Write a recording as CSV, HDF5, Parquet, MATLAB and other forms."),
    "reprocess": ("reprocess", "Recording to flights, plate motion and pictures."),
    "compare": ("compare", "Hold a recording against the model, step by step."),
    "predict": ("predict", "Predicted orbits, diagrams and bifurcations."),
    "close-loop": ("close_loop", "Find the residual, name the missing effect, report before and after."),
    "stake": ("close_loop:stake", "Hold a later run against the prediction that a verdict staked on it."),
    "batch": ("batch:batch", "Folders of recordings, one row each; resumable, on many cores."),
    "report": ("batch:report", "One page of recordings: verdict, figures, steps, provenance; also PDF."),
    "drop": ("drop", "Drop tests by camera, sound or contact."),
    "info": ("recordings:info", "Contents of a recording: note, keys, profile, steps, state."),
    "runs": ("runs", "Table of the recordings in a folder, filtered and sorted."),
    "tag": ("runs:tag", "Tag a recording, or take tags away."),
    "note": ("runs:note", "Add a note to a recording."),
    "verify": ("recordings:verify", "Check whether a recording is complete, stopped, incomplete or damaged."),
    "recover": ("recordings:recover", "Rebuild a verified recording from one that was cut off or is damaged."),
    "mcp": ("mcp", "An agent's door: plan, ramp and verdicts over the Model Context Protocol."),
    "virtual": ("rig:virtual", "The simulated plant as a process of its own, behind a real driver."),
    "paper": ("paper", "The seed paper, figure by figure, each number with the effect that moves it."),
    "demo": ("demo", "The main job on a simulated rig, end to end."),
}


class LazyGroup(TyperGroup):
    """A group that knows its commands' names without importing them, and ends a command that fails with one line."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Every command, in the order a person meets them."""
        return list(COMMANDS)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the overview from the table only."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, summary) for name, (_, summary) in COMMANDS.items()])

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Import the module of ``cmd_name`` and build its command from the function there, or ``app``."""
        if cmd_name not in COMMANDS:
            return None
        place, summary = COMMANDS[cmd_name]
        module_name, _, function = place.partition(":")
        module: Any = importlib.import_module(f"bench.commands.{module_name}")
        command = getattr(module, function or "command")
        if isinstance(command, typer.Typer):
            return typer.main.get_command(command)
        single = typer.Typer(add_completion=False, rich_markup_mode=None)
        single.command(name=cmd_name, help=command.__doc__ or summary)(command)
        return typer.main.get_command(single)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Answer a name that is nearly right with the right one."""
        if args and args[0] not in COMMANDS and not args[0].startswith("-") and not ctx.resilient_parsing:
            near = difflib.get_close_matches(args[0], COMMANDS, n=2)
            hint = f"did you mean {' or '.join(near)}?" if near else f"there are: {', '.join(COMMANDS)}"
            ctx.fail(f"no such command {args[0]!r}; {hint}")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run a command: status 2 where the call was wrong, 1 where the run, a device, the disk or this code failed."""
        try:
            return super().invoke(ctx)
        except InputError as error:
            fail(str(error), EXIT_USAGE)
        except OSError as error:
            if error.errno == errno.ENAMETOOLONG:
                name = str(error.filename)
                fail(f"{name[:40]}...: a name of {len(name)} characters is too long for this system", EXIT_USAGE)
            wrong = isinstance(error, FileNotFoundError | PermissionError | IsADirectoryError | NotADirectoryError)
            remedy = "name files that can be read and written" if wrong else "free some space, or name another place"
            fail(f"{error}; {remedy}", EXIT_USAGE if wrong else EXIT_FAILED)
        except RuntimeError as error:
            devices = sys.modules.get("rig.backends.base")  # where it was not imported, no device was opened
            if devices is None or not isinstance(error, devices.BackendError):
                raise
            fail(str(error), EXIT_FAILED)
        except DEFECTS as error:
            end_with_defect(error)

    def shell_complete(self, ctx: Any, incomplete: str) -> Any:
        """The names that begin so, from the table only."""
        from typer._click.shell_completion import CompletionItem

        return [CompletionItem(name, help=text) for name, (_, text) in COMMANDS.items() if name.startswith(incomplete)]


app = typer.Typer(
    cls=LazyGroup, invoke_without_command=True, rich_markup_mode=None, pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)  # fmt: skip


def _print_version(wanted: bool) -> None:
    """Version and Python, and leave."""
    if wanted:
        from daq.setup.provenance import software_version

        typer.echo(f"bench {software_version()} (shakerbench; Python {sys.version.split()[0]})")
        raise typer.Exit


def _use_effects(folder: str | None) -> None:
    """Name the folder of the user's effects for this process and those that it starts; it must be there."""
    if folder is not None:
        for part in filter(None, folder.split(os.pathsep)):
            if not Path(part).is_dir():
                fail(f"--effects {part}: no such folder; make it first, or name another", EXIT_USAGE)
        os.environ["SHAKERBENCH_EFFECTS"] = folder


@app.callback()
def _options(
    context: typer.Context,
    version: bool = typer.Option(False, "--version", callback=_print_version, is_eager=True, help="Show the version."),
    effects: str | None = typer.Option(
        None, "--effects", metavar="FOLDER", callback=_use_effects, help="Folder of effects in place of the user's own."
    ),
) -> None:
    """A completely inelastic ball on a shaken plate: drive it, record it, predict it, explain it.

    Without a command: the page in a browser, from the card to the cause, in this folder.
    """
    if context.invoked_subcommand is None:
        from bench.commands.live import open_page

        open_page(Path(), None)


def main() -> None:
    """Entry point of the console script."""
    from bench.terminal.streams import make_safe

    make_safe()
    for name in BLAS_THREADS:
        # tables of some hundred rows gain nothing by threads, and these wait for each other on a core each
        os.environ.setdefault(name, "1")
    if os.environ.get("COLUMNS") == "0":
        del os.environ["COLUMNS"]  # a terminal that does not know its width
    try:
        app(prog_name="bench")
    finally:
        sys.stdout.flush()


if __name__ == "__main__":
    main()
