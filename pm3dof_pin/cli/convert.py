"""`pm3dof convert`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import typer

from pm3dof_pin.cli.options import Json
from pm3dof_pin.cli.output import print_result
from pm3dof_pin.export.convert import convert_robot

# as in pm3dof_pin.export.convert, which is not imported just for the help
Dialect: TypeAlias = Literal["urdf", "mjcf", "sdf", "drake"]


def convert(
    source: Annotated[str, typer.Argument(metavar="IN", help="Name or path of a robot, in any dialect.")],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="File to write: .urdf, .xml (MJCF) or .sdf.")],
    to: Annotated[Dialect | None, typer.Option("--to", help="Dialect, if the suffix does not say it.")] = None,
    strict: Annotated[bool, typer.Option("--strict", help="Fail if anything is lost, and write nothing.")] = False,
    meshes: Annotated[bool, typer.Option(help="Include meshes and their files.")] = True,
    as_json: Json = False,
) -> None:
    """Convert a robot to another dialect, and list what is lost.

    The result is read back and compared. What the dialect has no words for, such as springs and coordinates, is written
    next to it, in a closures file and an SRDF, which pm3dof finds. A closure or coupling that cannot be said is an
    error.
    """
    done = convert_robot(source, target, dialect=to, strict=strict, meshes=meshes)
    lines = [f"lost: {loss}" for loss in done.losses] or ["nothing is lost"]
    print_result({"losses": done.losses}, lines, as_json=as_json, files=done.files)
