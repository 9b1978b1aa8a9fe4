"""`pm3dof export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import typer

from pm3dof_pin.cli.options import MachineOptions
from pm3dof_pin.cli.output import message

# those of pm3dof_pin.export.formats, which is not imported for the help
_Format: TypeAlias = Literal["drake", "gepetto", "mjcf", "ros", "sdf", "urdf"]


def export(
    which: MachineOptions,
    format_name: Annotated[
        _Format,
        typer.Argument(metavar="FORMAT", help="What to write."),
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Folder to write to; made if it is not there. By default results/FORMAT."),
    ] = None,
    meshes: Annotated[bool, typer.Option(help="Shapes that are meshes, and their files.")] = True,
) -> None:
    """A robot's description for another tool, its loops closed: mjcf, sdf, drake, gepetto, ros, urdf.

    mjcf for MuJoCo, sdf for SDFormat, drake a URDF for Drake, gepetto the layout of example-parallel-robots, ros a ROS
    2 package, urdf the URDF with its closures file, error file and SRDF. Meshes are put beside it, or left out with
    --no-meshes.
    """
    from pm3dof_pin.exceptions import DescriptionError
    from pm3dof_pin.export.formats import export_robot

    folder = out if out is not None else Path("results") / format_name
    try:
        written = export_robot(which.path, format_name, folder, meshes=meshes, **which.reading)
    except DescriptionError as error:
        if meshes and "mesh" in error.element:
            message("pm3dof: --no-meshes exports the robot without them")
        raise
    for file in written:
        message(f"wrote {file}")
