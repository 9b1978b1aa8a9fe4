"""`pm3dof export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, get_args

import typer

from pm3dof_pin.calibration.folder import read_compensation
from pm3dof_pin.cli.calibration_options import require_calibration_of
from pm3dof_pin.cli.options import MachineOptions
from pm3dof_pin.cli.output import message
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.export.controllers import export_controller, placed_by_tool
from pm3dof_pin.export.formats import export_robot
from pm3dof_pin.kinematics.robot import Robot

# as in pm3dof_pin.export.formats and .controllers, which are not imported just for the help
ExportFormat: TypeAlias = Literal["drake", "gepetto", "mjcf", "ros", "sdf", "urdf"]
ControllerFormat: TypeAlias = Literal["c", "grblhal", "linuxcnc", "ros2_control"]


def export(
    which: MachineOptions,
    format_name: Annotated[
        Literal[ExportFormat, ControllerFormat],
        typer.Argument(metavar="FORMAT", help="Output format."),
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Output folder, created if missing; by default results/FORMAT."),
    ] = None,
    meshes: Annotated[bool, typer.Option(help="Include meshes and their files.")] = True,
    calibration: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="For controllers: folder that `pm3dof calibrate` wrote; both sets of numbers."
        ),
    ] = None,
    header_only: Annotated[bool, typer.Option("--header-only", help="For c: functions in the header.")] = False,
    single: Annotated[bool, typer.Option("--float", help="For c: single precision, with its error stated.")] = False,
) -> None:
    """Export a robot for another tool, with its loops closed: mjcf, sdf, drake, gepetto, ros, urdf; or its kinematics.

    mjcf is for MuJoCo; sdf is SDFormat; drake is a URDF for Drake; gepetto is the layout of example-parallel-robots;
    ros is a ROS 2 package; urdf is the URDF with its closures file, error file and SRDF. Mesh files are written next to
    it; --no-meshes omits them.

    For controllers, commands from poses and back: c is C99 that needs only math.h; linuxcnc is a configuration that
    runs, grblhal a file of kinematics, ros2_control a package with a plugin and a transmission.
    """
    which.announce()
    folder = out if out is not None else Path("results") / format_name
    if format_name in get_args(ControllerFormat):
        options: dict[str, Any] = {"header_only": header_only, "real": "float" if single else "double"}
        written = _export_controller(which.load(), format_name, folder, calibration, options)
    else:
        given = {"--calibration": calibration, "--header-only": header_only, "--float": single}
        if refused := [name for name, value in given.items() if value]:
            raise typer.BadParameter(f"{refused[0]} is for controllers, not for {format_name}")
        written = _export_description(which, format_name, folder, meshes=meshes)
    for file in written:
        message(f"wrote {file}")


def _export_description(which: MachineOptions, format_name: str, folder: Path, *, meshes: bool) -> list[Path]:
    try:
        return export_robot(which.path, format_name, folder, meshes=meshes, **which.reading)
    except DescriptionError as error:
        if meshes and "mesh" in error.element:
            message("pm3dof: --no-meshes exports the robot without them")
        raise


def _export_controller(
    robot: Robot, name: Any, folder: Path, calibration: Path | None, options: dict[str, Any]
) -> list[Path]:
    if calibration is not None:
        known = read_compensation(calibration)
        require_calibration_of(robot, known.errors.robot, calibration)
        robot = known.errors.robot
        options |= {
            "calibrated": None if known.values is None else known.model,
            "deviations": None if known.learned is None else known.learned_deviations,
        }
        if known.learned is not None and known.learned.inputs.conditions:
            conditions = ", ".join(f"{name} = {value:.4g}" for name, value in known.learned.inputs.middle().items())
            message(f"pm3dof: the table of learned deviations is for {conditions}, the middle of the measured range")
    if name != "c" and (options["header_only"] or options["real"] != "double"):
        raise typer.BadParameter(f"--header-only and --float are for c, not for {name}")
    placed = placed_by_tool(robot)
    if placed.coordinates != robot.coordinates:
        names = ", ".join(coordinate.name for coordinate in placed.coordinates)
        message(f"pm3dof: the description has no coordinates; {names} place the tool")
    return export_controller(placed, name, folder, **options)
