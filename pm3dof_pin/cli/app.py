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
"""Settings of commands with a pose: -15 is a number; a misspelt option is then an argument that is not a number."""

COMMANDS = {
    "info": ("info", "What a robot is and what is missing, in numbers"),
    "ik": ("kinematics", "Commands of the drives for a pose"),
    "fk": ("kinematics", "Pose for commands of the drives"),
    "stiffness": ("stiffness", "Stiffness of the tool at a pose"),
    "statics": ("statics", "Forces of the drives that hold the weight and a load"),
    "modes": ("modes", "Natural frequencies and mode shapes at a pose"),
    "stiffness-map": ("stiffness_map", "Maps of the stiffness: data, spreadsheet, pictures"),
    "table-8-3": ("table", "Table 8.3 of the chapter, published and computed"),
    "workspace": ("workspace", "What can be reached under all limits, and what ends it"),
    "atlas": ("atlas", "Any quantities over the whole workspace"),
    "evaluate": ("evaluate", "Mean, spread, extremes of the stiffness; weakest parts"),
    "error-parameters": ("error_parameters", "Which geometric errors a robot has"),
    "error-map": ("error_map", "What errors of the parts do to the tool"),
    "calibration-plan": ("calibration_plan", "Poses to measure for a calibration"),
    "measure": ("measure", "Simulated measurements of a machine with errors"),
    "calibrate": ("calibrate", "From measurements to a calibrated machine"),
    "compensate": ("compensate", "Commands that bring a calibrated machine to a pose"),
    "export": ("export", "Files for MuJoCo, Drake, SDFormat, ROS and others"),
    "view": ("view", "The robot in a browser: drag it, see what it does"),
}
"""Module of pm3dof_pin.cli that each command is in, a function named after it, and what the list of commands says."""

_OF_MAPS = {"stiffness-map", "workspace", "atlas", "evaluate", "error-map"}
_WITH_POSE = {"ik", "fk", "stiffness", "statics", "modes", "compensate", "view"}


def _make_app(commands: Iterable[str] = COMMANDS) -> typer.Typer:
    """Return the command with some of its subcommands; the modules of the others are not imported."""
    app = typer.Typer(
        name="pm3dof",
        help="Kinematics, stiffness and calibration of closed-chain robots. Angles in DEGREES, lengths in metres.",
        epilog="Exit status: 0 done, 1 the work failed or a joint limit is broken, 2 wrong usage.",
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
    """Make the whole command, `app`, when it is asked for."""
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
        typer.Option("--trust-xacro", help="Let xacro files run with all rights; by default they may do little."),
    ] = False,
) -> None:
    if trust_xacro:
        from pm3dof_pin.description import expand

        expand.trust_xacro()


def main() -> None:
    """Run the command; errors become one line on standard error and exit status 1.

    Those of the package, and what the machine it runs on refuses: memory, and a full disk behind standard output.
    """
    # the matrices here are small: threads inside BLAS only contend with each other
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # it reports which fonts it looks for
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
