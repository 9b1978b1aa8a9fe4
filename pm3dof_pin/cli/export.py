"""`pm3dof export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import typer

from pm3dof_pin.cli.options import MachineOptions
from pm3dof_pin.cli.output import message
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.export.formats import export_robot

# as in pm3dof_pin.export.formats, which is not imported just for the help
_Format: TypeAlias = Literal["drake", "gepetto", "mjcf", "ros", "sdf", "urdf"]


def export(
    which: MachineOptions,
    format_name: Annotated[
        _Format,
        typer.Argument(metavar="FORMAT", help="Output format."),
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Output folder, created if missing; by default results/FORMAT."),
    ] = None,
    meshes: Annotated[bool, typer.Option(help="Include meshes and their files.")] = True,
) -> None:
    """Export a robot for another tool, with its loops closed: mjcf, sdf, drake, gepetto, ros, urdf.

    mjcf is for MuJoCo; sdf is SDFormat; drake is a URDF for Drake; gepetto is the layout of example-parallel-robots;
    ros is a ROS 2 package; urdf is the URDF with its closures file, error file and SRDF. Mesh files are written next to
    it; --no-meshes omits them.
    """
    which.announce()
    folder = out if out is not None else Path("results") / format_name
    try:
        written = export_robot(which.path, format_name, folder, meshes=meshes, **which.reading)
    except DescriptionError as error:
        if meshes and "mesh" in error.element:
            message("pm3dof: --no-meshes exports the robot without them")
        raise
    for file in written:
        message(f"wrote {file}")
