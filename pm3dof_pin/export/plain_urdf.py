"""The description itself, to be put into another folder: as it is, but for the names of mesh files."""

from __future__ import annotations

import copy
from xml.etree import ElementTree

from pm3dof_pin.description.robots import CLOSURES_SUFFIX
from pm3dof_pin.export.robot_document import RobotDocument
from pm3dof_pin.export.xml_text import document_text

_BANNER = "The URDF of {}, its meshes where `pm3dof export` puts them. Generated: edit the original."


def description_texts(robot: RobotDocument, mesh_prefix: str = "") -> dict[str, str]:
    """Return URDF, closures file, error file and SRDF, by their names: what pm3dof-pin loads a robot from.

    Args:
        robot: the robot.
        mesh_prefix: what file names of meshes, `meshes/...`, begin with.
    """
    texts = {
        f"{robot.file_name}.urdf": urdf_text(robot, mesh_prefix),
        f"{robot.file_name}{CLOSURES_SUFFIX}": robot.files.closures.read_text(encoding="utf-8"),
    }
    errors = robot.files.urdf.with_suffix(".errors.yaml")
    if errors.is_file():
        texts[f"{robot.file_name}.errors.yaml"] = errors.read_text(encoding="utf-8")
    if robot.files.srdf is not None:
        texts[f"{robot.file_name}.srdf"] = robot.files.srdf.read_text(encoding="utf-8")
    return texts


def urdf_text(robot: RobotDocument, mesh_prefix: str = "") -> str:
    """Return the URDF of a robot, to the letter if it has no meshes.

    Args:
        robot: the robot.
        mesh_prefix: what file names of meshes, `meshes/...`, begin with, such as `package://x/`.
    """
    if not len(robot.meshes):
        return robot.urdf.text
    return document_text(urdf_element(robot, mesh_prefix), _BANNER.format(robot.name))


def urdf_element(robot: RobotDocument, mesh_prefix: str = "") -> ElementTree.Element:
    """Return a copy of a robot's URDF with the meshes where an export puts them.

    Args:
        robot: the robot.
        mesh_prefix: what file names of meshes, `meshes/...`, begin with.
    """
    root = copy.deepcopy(robot.urdf.element)
    for mesh in root.iter("mesh"):
        mesh.set("filename", mesh_prefix + robot.meshes.exported(mesh.get("filename", "")))
    return root
