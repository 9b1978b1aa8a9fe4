"""Entry point of the command `pm3dof`: its subcommands and its exit status."""

from __future__ import annotations

import logging
import os
import sys
from typing import Annotated

import typer

import pm3dof_pin
from pm3dof_pin.cli import (
    atlas,
    calibrate,
    calibration_plan,
    compensate,
    error_map,
    export,
    info,
    kinematics,
    measure,
    modes,
    statics,
    stiffness,
    stiffness_map,
    table,
    view,
    workspace,
)
from pm3dof_pin.cli.map_options import MapCommand
from pm3dof_pin.exceptions import PM3DofError

WORK_FAILED = 1

app = typer.Typer(
    name="pm3dof",
    help="Kinematics, stiffness and calibration of closed-chain robots. Angles in DEGREES, lengths in metres.",
    epilog="Exit status: 0 done, 1 the work failed or a joint limit is broken, 2 wrong usage.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)

# Unknown options are handed on as arguments, so that -15 is a number; a misspelt option is then one argument too many.
_NEGATIVE_NUMBERS = {"ignore_unknown_options": True}

app.command("info")(info.info)
app.command("ik", context_settings=_NEGATIVE_NUMBERS)(kinematics.ik)
app.command("fk", context_settings=_NEGATIVE_NUMBERS)(kinematics.fk)
app.command("stiffness", context_settings=_NEGATIVE_NUMBERS)(stiffness.stiffness)
app.command("statics", context_settings=_NEGATIVE_NUMBERS)(statics.statics)
app.command("modes", context_settings=_NEGATIVE_NUMBERS)(modes.modes)
app.command("stiffness-map", cls=MapCommand)(stiffness_map.stiffness_map)
app.command("table-8-3")(table.table_8_3)
app.command("workspace", cls=MapCommand)(workspace.workspace)
app.command("atlas", cls=MapCommand)(atlas.atlas)
app.command("error-map")(error_map.error_map)
app.command("calibration-plan")(calibration_plan.calibration_plan)
app.command("measure")(measure.measure)
app.command("calibrate")(calibrate.calibrate)
app.command("compensate", context_settings=_NEGATIVE_NUMBERS)(compensate.compensate)
app.command("export")(export.export)
app.command("view", context_settings=_NEGATIVE_NUMBERS)(view.view)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"pm3dof {pm3dof_pin.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and leave.")
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command; errors become one line on standard error and exit status 1.

    Those of the package, and what the machine it runs on refuses: memory, and a full disk behind standard output.
    """
    # the matrices here are small: threads inside BLAS only get in each other's way, and in that of other programs
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # which fonts it looks for is no news for a user
    try:
        app()
    except PM3DofError as error:
        typer.echo(f"pm3dof: {error}", err=True)
    except MemoryError as error:
        typer.echo(f"pm3dof: not enough memory{f': {error}' if str(error) else ''}", err=True)
    except OSError as error:
        typer.echo(f"pm3dof: {error}", err=True)
    else:
        return
    sys.exit(WORK_FAILED)
