"""`pm3dof export`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from pm3dof_pin.cli.options import THE_TRIPOD
from pm3dof_pin.cli.output import message


class Format(StrEnum):
    """The formats of pm3dof_pin.export.formats, which is not imported for the help."""

    DRAKE = "drake"
    GEPETTO = "gepetto"
    MJCF = "mjcf"
    ROS = "ros"
    SDF = "sdf"
    URDF = "urdf"


def export(
    format_name: Annotated[Format, typer.Argument(metavar="FORMAT", help="What to write.")],
    robot: Annotated[
        str, typer.Option("--robot", metavar="NAME|URDF", help="A robot by name, or by the path of its URDF.")
    ] = THE_TRIPOD,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Folder to write to; made if it is not there. By default results/FORMAT."),
    ] = None,
) -> None:
    """A robot's description for another tool, its loops closed: mjcf, sdf, drake, gepetto, ros, urdf.

    mjcf for MuJoCo, sdf for SDFormat, drake a URDF for Drake, gepetto the layout of example-parallel-robots, ros a ROS
    2 package, urdf the URDF with its closures file, error file and SRDF. Meshes are put beside it.
    """
    from pm3dof_pin.export.formats import export_robot

    folder = out if out is not None else Path("results") / format_name.value
    for file in export_robot(robot, format_name.value, folder):
        message(f"wrote {file}")
