"""`pm3dof export serial`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pm3dof_pin.capability.mapping_fit import fit_mapping
from pm3dof_pin.capability.serial_constants import serial_constants
from pm3dof_pin.cli.options import Json, PlaceOptions, RobotOptions
from pm3dof_pin.cli.output import print_result
from pm3dof_pin.cli.poses import place
from pm3dof_pin.cli.transmission_options import TransmissionOptions
from pm3dof_pin.export.serial import constant_lines, serial_entries, serial_tree, write_serial
from pm3dof_pin.kinematics.robot import Robot


def export_serial(
    which: RobotOptions,
    chosen: PlaceOptions,
    options: TransmissionOptions,
    at: Annotated[bool, typer.Option("--at", help="Constants at POSE; by default so if one is given.")] = False,
    worst: Annotated[
        bool, typer.Option("--worst", help="The cautious end of each range: promises nothing the machine cannot do.")
    ] = False,
    least_wrong: Annotated[
        bool, typer.Option("--least-wrong", help="The constants with the smallest greatest error; the default.")
    ] = False,
    degree: Annotated[
        int | None, typer.Option(metavar="N", help="Also fit the drives' positions by polynomials of this degree.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", help="Output folder, created if missing.")] = Path("results/serial"),
    meshes: Annotated[bool, typer.Option(help="Include meshes and their files.")] = True,
    as_json: Json = False,
) -> None:
    """Write a robot without its loops, as URDF and MJCF, with the numbers that its loops give the joints.

    Limits, effort, velocity, armature, damping, friction and gains of the joints, of POSE (angles in degrees, lengths
    in metres) or over the box of --over, each with its error over the box in a comment, and in a JSON file. Joints in
    loops other than those of --joints, and those of --hold, are fixed at home. The closed robot is written next to it
    as MJCF, and with --to the mapping as in `pm3dof export function`.
    """
    given = [name for name, value in (("--at", at), ("--worst", worst), ("--least-wrong", least_wrong)) if value]
    if len(given) > 1:
        raise typer.BadParameter(f"expected one of {' and '.join(given)}")
    robot, part = options.whole_and_part(which.load())
    tree = serial_tree(robot, part, options.held)
    box = options.box(part)
    at_pose = at or not (worst or least_wrong or chosen.is_empty)
    constants = serial_constants(
        box,
        Robot.load(tree),
        choice="worst" if worst else "least-wrong",
        at=options.at(place(part, chosen)) if at_pose else None,
        **options.gains_of(part),
    )
    fit = None if degree is None else fit_mapping(box, degree)
    functions = options.write_functions(part, out)
    files = [*write_serial(robot, tree, constants, out, fit=fit, meshes=meshes), *functions]
    result = {"robot": robot.name} | serial_entries(constants, fit)
    print_result(result, constant_lines(constants, fit), as_json=as_json, files=files)
