"""The export formats, and the functions that write them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Unpack

from pm3dof_pin.description.robots import robots_directory
from pm3dof_pin.description.simple_joints import Floating
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.export import drake, mjcf
from pm3dof_pin.export.drake import drake_text
from pm3dof_pin.export.gepetto import gepetto_files
from pm3dof_pin.export.mjcf import mjcf_text
from pm3dof_pin.export.plain_urdf import description_texts
from pm3dof_pin.export.robot_document import RobotDocument, read_robot
from pm3dof_pin.export.ros import OUR_MANIFEST, ros_files, ros_package_name
from pm3dof_pin.export.sdf import sdf_text
from pm3dof_pin.files import write_text_atomically
from pm3dof_pin.kinematics.robot import LoadOptions

_WRITERS: dict[str, Callable[[RobotDocument], dict[str, str]]] = {
    "drake": lambda robot: {f"{robot.file_name}.urdf": drake_text(robot)},
    "gepetto": gepetto_files,
    "mjcf": lambda robot: {f"{robot.file_name}.xml": mjcf_text(robot)},
    "ros": lambda robot: ros_files(robot, **(OUR_MANIFEST if _is_ours(robot) else {})),
    "sdf": lambda robot: {f"{robot.file_name}.sdf": sdf_text(robot)},
    "urdf": description_texts,
}

MESH_KINDS = {"drake": drake.MESH_KINDS, "mjcf": mjcf.MESH_KINDS}
"""Suffixes of the mesh files that a format takes, if not all."""

FLOATING: dict[str, Floating] = {"drake": "root", "mjcf": "root", "sdf": "root", "urdf": "any"}
"""Floating joints that a format has, if any."""

FORMATS = tuple(_WRITERS)
"""Names of the formats."""


def exported_files(robot: RobotDocument, format_name: str) -> dict[str, str]:
    """Write a robot in one of :data:`FORMATS`: texts by path; for meshes see :attr:`RobotDocument.meshes`.

    Raises:
        InvalidValueError: no such format.
        DescriptionError: the robot has something that the format cannot express.
        ConvergenceError: the loops do not close near the home configuration.
    """
    if format_name not in _WRITERS:
        raise InvalidValueError("format", format_name, f"one of {', '.join(FORMATS)}")
    return _WRITERS[format_name](robot)


def export_robot(
    robot: str | Path,
    format_name: str,
    folder: str | Path,
    *,
    meshes: bool = True,
    **options: Unpack[LoadOptions],
) -> list[Path]:
    """Write a robot's description for another tool, with its mesh files.

    Example:
        >>> import pm3dof_pin as pm
        >>> [file.name for file in pm.export_robot("hexapod", "mjcf", "mujoco")]
        ['hexapod.xml']

    Args:
        robot: name or path of a robot, see :func:`~pm3dof_pin.description.robots.find_robot`.
        format_name: one of :data:`FORMATS`.
        folder: output folder, created if missing. A ROS package becomes a folder in it.
        meshes: whether mesh shapes are exported, and their files written.
        options: see :meth:`Robot.load <pm3dof_pin.kinematics.robot.Robot.load>`.

    Returns:
        The files written.

    Raises:
        UnknownRobotError: no such robot.
        InvalidValueError: no such format.
        DescriptionError: a file of the robot is missing, unreadable or malformed, or the robot has something that
            the format cannot express.
        FrameNotFoundError: the closures file names a frame that the URDF does not have.
        JointNotFoundError: the closures file or the SRDF names a joint that the URDF does not have.
        ConvergenceError: the loops do not close near the home configuration.
        OutputError: a file cannot be written.
    """
    floating = FLOATING.get(format_name, "none")
    document = read_robot(robot, meshes=meshes, unique_names=format_name == "sdf", floating=floating, **options)
    files = exported_files(document, format_name)
    target = Path(folder) / ros_package_name(document.name) if format_name == "ros" else Path(folder)
    kinds = MESH_KINDS.get(format_name)
    copies = document.meshes if kinds is None else document.meshes.for_kinds(kinds)
    return [*(write_text_atomically(target / name, text) for name, text in files.items()), *copies.write(target)]


def _is_ours(robot: RobotDocument) -> bool:
    return robot.files.path.resolve().is_relative_to(robots_directory().resolve())
