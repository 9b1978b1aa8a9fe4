"""`pm3dof export function`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pm3dof_pin.cli.options import RobotOptions
from pm3dof_pin.cli.output import message
from pm3dof_pin.export.function_quantities import KINEMATICS, QUANTITIES
from pm3dof_pin.export.functions import Target, export_functions

_AT_COORDINATES = (*(name for name in KINEMATICS if name != "coordinates"), *QUANTITIES)


def export_function(
    which: RobotOptions,
    of: Annotated[
        str,
        typer.Option(
            metavar="A,B",
            help=f"Quantities at coordinates: {', '.join(_AT_COORDINATES)}; Jacobians A_by_B and A_by_B_derivatives, "
            "such as tool_by_commands; coordinates, at commands; or all.",
        ),
    ] = "commands,coordinates",
    to: Annotated[Target, typer.Option(help="Library that the functions are for.")] = "numpy",
    out: Annotated[Path, typer.Option("--out", help="Output folder, created if missing.")] = Path("results/function"),
) -> None:
    """Write a robot's quantities as functions for other code: one Python file, batched and differentiable, or C.

    The functions take radians and metres. Each file has a _selftest() against values computed by Pinocchio.
    """
    which.announce()
    names = [name.strip() for name in of.split(",") if name.strip()]
    known = ("all", *KINEMATICS, *QUANTITIES)
    if unknown := [name for name in names if name not in known and "_by_" not in name]:
        raise typer.BadParameter(
            f"--of {unknown[0]}: expected A_by_B, A_by_B_derivatives, or one of {', '.join(known)}"
        )
    for file in export_functions(which.load(), names, to, out):
        message(f"wrote {file}")
