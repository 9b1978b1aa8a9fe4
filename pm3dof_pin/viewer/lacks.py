"""What a robot's description lacks of what the page could show, in one line each."""

from __future__ import annotations

from collections.abc import Sequence

from pm3dof_pin.elastic.springs import Spring
from pm3dof_pin.exceptions import PM3DofError, SingularConfigurationError
from pm3dof_pin.kinematics.branches import start_of
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.viewer.labels import display_title


def lacks_of(robot: Robot, springs: Sequence[Spring] | None = None) -> list[str]:
    """Return why a page has no sliders, or no stiffness; empty if it has both. Springs are by default the described."""
    title, said = display_title(robot), []
    if not robot.coordinates:
        said.append(f"{title} has no drives (--drives JOINT,..) in its description: there are no sliders")
    elif robot.command_coordinates != robot.coordinates and (why := reason_without_commands(robot)):
        said.append(f"no sliders of the commands: {why}")
    missing = [] if (robot.springs if springs is None else springs) else ["springs (--drive-stiffness)"]
    missing += [] if robot.tool_frame is not None else ["tool frame (--tool-frame)"]
    if missing:
        what = " and no ".join(missing)
        said.append(f"{title} has no {what} in its description: stiffness ellipsoids are not drawn")
    elif base := robot.description.floating_base:
        said.append(f"the base '{base[-1].child}' floats (--hold-base): stiffness ellipsoids are not drawn")
    return said


def immobile(robot: Robot) -> str | None:
    """Return why sliders cannot move a robot from home; None if they can."""
    try:
        if robot.closures and robot.coordinates:
            start_of(robot)
    except PM3DofError as error:
        return str(error)
    return reason_without_commands(robot) if robot.coordinates == robot.command_coordinates else None


def reason_without_commands(robot: Robot) -> str | None:
    """Return why commands do not place a robot; None if they do."""
    try:
        robot.require_regular_drives()
    except SingularConfigurationError as error:
        return str(error)
    return None
