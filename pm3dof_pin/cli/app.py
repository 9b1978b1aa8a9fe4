"""Entry point of the command `pm3dof`: its subcommands and its exit status."""

from __future__ import annotations

import logging
import os
import sys
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

import pm3dof_pin
from pm3dof_pin.cli.command import PlainWords, RepeatableCommand, with_groups
from pm3dof_pin.description.expand import trust_xacro as allow_xacro
from pm3dof_pin.exceptions import PM3DofError

_WORK_FAILED = 1
_HELP = "Kinematics, stiffness and calibration of closed-chain robots. Angles in DEGREES, lengths in metres."

COMMANDS = {
    "info": ("info", "Summary of a robot and of what its description lacks"),
    "ik": ("kinematics", "Drive commands for a pose"),
    "fk": ("kinematics", "Pose for drive commands"),
    "stiffness": ("stiffness", "Stiffness of the tool at a pose"),
    "statics": ("statics", "Drive forces that hold the weight and a load"),
    "equilibrium": ("equilibrium", "Where the tool rests under load; contacts, play, preload"),
    "modes": ("modes", "Natural frequencies and mode shapes at a pose"),
    "receptance": ("receptance", "Motion per force by frequency; dynamic stiffness and chatter"),
    "capability": ("capability", "How hard the tool can push and how fast it can go"),
    "path": ("path", "A tool path judged: limits, speeds, forces, deflection"),
    "transmission": ("transmission", "What a serial model must know of joints driven through loops"),
    "stiffness-map": ("stiffness_map", "Stiffness maps: data, spreadsheet, pictures"),
    "table-8-3": ("table", "Table 8.3 of the chapter, published and computed"),
    "workspace": ("workspace", "Reachable workspace, and the limits that bound it"),
    "atlas": ("atlas", "Maps of any quantity over the workspace"),
    "evaluate": ("evaluate", "Stiffness statistics over the workspace; weakest parts"),
    "error-parameters": ("error_parameters", "Geometric error parameters of a robot"),
    "error-map": ("error_map", "Tool errors caused by errors of the parts"),
    "calibration-plan": ("calibration_plan", "Poses to measure for a calibration"),
    "measure": ("measure", "Simulated measurements of a machine with errors"),
    "measurements": ("measurements", "Check a file of measurements, or join two"),
    "calibrate": ("calibrate", "Calibrate a machine from measurements"),
    "recheck": ("recheck", "Whether a calibration still holds, from a few rows"),
    "acceptance": ("acceptance", "Tests of ISO 230: planned, and evaluated"),
    "certificate": ("certificate", "A report of a calibration to sign"),
    "compensate": ("compensate", "Commands that take a calibrated machine to a pose"),
    "export": ("export", "Files for MuJoCo, Drake, SDFormat, ROS and others"),
    "export function": ("export_function", "A robot's quantities as functions: NumPy, JAX, PyTorch, CasADi, C"),
    "export serial": ("export_serial", "A robot without its loops, and the numbers to type into it"),
    "convert": ("convert", "A robot in another dialect, and what it does not say"),
    "view": ("view", "The robot in a browser: move it, watch its stiffness"),
}
"""By command, of one word or two: its module in pm3dof_pin.cli (the function has its name); its line in the list."""

# -15 is a number for these, and a misspelt option an argument that is not a number
_WITH_POSE = {
    "ik",
    "fk",
    "stiffness",
    "statics",
    "equilibrium",
    "modes",
    "receptance",
    "compensate",
    "view",
    "transmission",
    "capability",
    "export serial",
}


class _Commands(PlainWords, TyperGroup):
    """The subcommands; the module of one is imported when it is run, or its options are asked for."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return their names."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> TyperCommand | None:
        """Return a command with its line in the list, which is all that the help and completion of names need."""
        return TyperCommand(cmd_name, short_help=COMMANDS[cmd_name][1]) if cmd_name in COMMANDS else None

    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
        """Return completions of one word."""
        return [item for item in super().shell_complete(ctx, incomplete) if " " not in item.value]

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the name, the command itself, and its arguments."""
        if " ".join(args[:2]) in COMMANDS:
            args = [" ".join(args[:2]), *args[2:]]
        name, command, arguments = super().resolve_command(ctx, args)
        return name, command and _command(command.name or ""), arguments


def _command(name: str) -> Any:
    function = getattr(import_module(f"pm3dof_pin.cli.{COMMANDS[name][0]}"), name.replace("-", "_").replace(" ", "_"))
    alone = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    settings = {"ignore_unknown_options": True} if name in _WITH_POSE else None
    alone.command(name, cls=RepeatableCommand, context_settings=settings)(with_groups(function))
    return typer.main.get_command(alone)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"pm3dof {pm3dof_pin.__version__}")
        raise typer.Exit


app = typer.Typer(
    name="pm3dof",
    cls=_Commands,
    epilog="Exit status: 0 done, 1 failure or broken joint limit, 2 wrong usage.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback(
    help="Kinematics, stiffness and calibration of closed-chain robots. Angles in DEGREES, lengths in metres."
)
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    trust_xacro: Annotated[bool, typer.Option("--trust-xacro", help="Run xacro files without the sandbox.")] = False,
) -> None:
    if trust_xacro:
        allow_xacro()


def main() -> None:
    """Run the command; errors become one line on standard error and exit status 1.

    This covers errors of the package, running out of memory, and operating system errors such as a full disk.
    """
    # the matrices are small: BLAS threads would only contend with each other
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # it logs its font search
    try:
        try:
            app(prog_name="pm3dof")
        finally:
            sys.stdout.flush()
    except MemoryError as error:
        typer.echo(f"Error: not enough memory{f': {error}' if str(error) else ''}", err=True)
    except BrokenPipeError:
        _discard_output()  # the reader has seen enough
    except (PM3DofError, OSError) as error:
        if isinstance(error, OSError):
            _discard_output()
        typer.echo(f"Error: {error}", err=True)
    else:
        return
    sys.exit(_WORK_FAILED)


def _discard_output() -> None:
    """Write what is left of standard output to nowhere: Python would try again, and fail again, when it ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
