"""Options for the limits of drives, where the description has none or others."""

from __future__ import annotations

from typing import Annotated

import typer

from pm3dof_pin.cli.options import numbers_by_name
from pm3dof_pin.kinematics.robot import Robot

NUMBER_OF_DRIVES = "N|JOINT=N,.."
"""How one number for all drives, or one for some, is written."""

DriveEffort = Annotated[
    str | None,
    typer.Option(
        "--effort",
        metavar=NUMBER_OF_DRIVES,
        help="Greatest effort of the drives [N, N m]; the description's by default.",
    ),
]
DriveSpeed = Annotated[
    str | None,
    typer.Option(
        "--speed",
        metavar=NUMBER_OF_DRIVES,
        help="Greatest speed of the drives [m/s, rad/s]; the description's by default.",
    ),
]


def limits_of_drives(robot: Robot, **texts: str | None) -> dict[str, float | dict[str, float] | None]:
    """Read limits of the drives by the names of their options; wrong usage ends the command with status 2."""
    given = {name: numbers_by_name(f"--{name}", text) for name, text in texts.items()}
    for name, limits in given.items():
        numbers = limits if isinstance(limits, dict) else {} if limits is None else {"": limits}
        for drive, value in numbers.items():
            if drive and drive not in robot.actuated_joints:
                known = ", ".join(robot.actuated_joints)
                raise typer.BadParameter(f"--{name}: {robot.name} has no drive '{drive}': expected one of {known}")
            if value < 0.0 or (value == 0.0 and name != "armature"):
                expected = "nonnegative" if name == "armature" else "positive"
                raise typer.BadParameter(
                    f"--{name} {drive + '=' if drive else ''}{value:g}: expected a {expected} number"
                )
    return given
