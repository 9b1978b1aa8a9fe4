"""Entry point of the command `pm3dof`: its subcommands and its exit status."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Iterable
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

import pm3dof_pin
from pm3dof_pin.cli.options import with_groups
from pm3dof_pin.exceptions import PM3DofError

_WORK_FAILED = 1
NEGATIVE_NUMBERS = {"ignore_unknown_options": True}
"""Settings of commands that take a pose: -15 is a number, and a misspelt option is an argument that is not a number."""

COMMANDS = {
    "info": ("info", "Summary of a robot and of what its description lacks"),
    "ik": ("kinematics", "Drive commands for a pose"),
    "fk": ("kinematics", "Pose for drive commands"),
    "stiffness": ("stiffness", "Stiffness of the tool at a pose"),
    "statics": ("statics", "Drive forces that hold the weight and a load"),
    "modes": ("modes", "Natural frequencies and mode shapes at a pose"),
    "stiffness-map": ("stiffness_map", "Stiffness maps: data, spreadsheet, pictures"),
    "table-8-3": ("table", "Table 8.3 of the chapter, published and computed"),
    "workspace": ("workspace", "Reachable workspace, and the limits that bound it"),
    "atlas": ("atlas", "Maps of any quantity over the workspace"),
    "evaluate": ("evaluate", "Stiffness statistics over the workspace; weakest parts"),
    "error-parameters": ("error_parameters", "Geometric error parameters of a robot"),
    "error-map": ("error_map", "Tool errors caused by errors of the parts"),
    "calibration-plan": ("calibration_plan", "Poses to measure for a calibration"),
    "measure": ("measure", "Simulated measurements of a machine with errors"),
    "calibrate": ("calibrate", "Calibrate a machine from measurements"),
    "compensate": ("compensate", "Commands that take a calibrated machine to a pose"),
    "export": ("export", "Files for MuJoCo, Drake, SDFormat, ROS and others"),
    "view": ("view", "The robot in a browser: move it, watch its stiffness"),
}
"""For each command: its module in pm3dof_pin.cli (the function has the command's name) and its line in the list."""

_OF_MAPS = {"stiffness-map", "workspace", "atlas", "evaluate", "error-map"}
_WITH_POSE = {"ik", "fk", "stiffness", "statics", "modes", "compensate", "view"}


def _make_app(commands: Iterable[str] = COMMANDS) -> typer.Typer:
    """Return the command with the given subcommands, importing only their modules."""
    app = typer.Typer(
        name="pm3dof",
        help="Kinematics, stiffness and calibration of closed-chain robots. Angles in DEGREES, lengths in metres.",
        epilog="Exit status: 0 done, 1 failure or broken joint limit, 2 wrong usage.",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_options)
    for name in commands:
        module, summary = COMMANDS[name]
        function = getattr(import_module(f"pm3dof_pin.cli.{module}"), name.replace("-", "_"))
        settings = NEGATIVE_NUMBERS if name in _WITH_POSE else None
        kind = _map_command() if name in _OF_MAPS else None
        app.command(name, cls=kind, context_settings=settings, short_help=summary)(with_groups(function))
    return app


def _map_command() -> type[TyperCommand]:
    from pm3dof_pin.cli.map_options import MapCommand

    return MapCommand


def __getattr__(name: str) -> Any:
    """Build the whole command, `app`, on first access."""
    if name != "app":
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return _make_app()


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"pm3dof {pm3dof_pin.__version__}")
        raise typer.Exit


def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    trust_xacro: Annotated[
        bool,
        typer.Option("--trust-xacro", help="Run xacro files without the sandbox."),
    ] = False,
) -> None:
    if trust_xacro:
        from pm3dof_pin.description import expand

        expand.trust_xacro()


def main() -> None:
    """Run the command; errors become one line on standard error and exit status 1.

    This covers errors of the package, running out of memory, and operating system errors such as a full disk.
    """
    # the matrices are small: BLAS threads would only contend with each other
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # it logs its font search
    command = next((word for word in sys.argv[1:] if not word.startswith("-")), None)
    try:
        _make_app([command] if command in COMMANDS else COMMANDS)(prog_name="pm3dof")
    except PM3DofError as error:
        typer.echo(f"pm3dof: {error}", err=True)
    except MemoryError as error:
        typer.echo(f"pm3dof: not enough memory{f': {error}' if str(error) else ''}", err=True)
    except OSError as error:
        typer.echo(f"pm3dof: {error}", err=True)
    else:
        return
    sys.exit(_WORK_FAILED)
