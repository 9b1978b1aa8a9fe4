"""The description itself, for another folder: unchanged except for the names of mesh files."""

from __future__ import annotations

from xml.etree import ElementTree

import yaml

from pm3dof_pin.description.robots import CLOSURES_SUFFIX
from pm3dof_pin.description.urdf_files import urdf_files
from pm3dof_pin.export.robot_document import RobotDocument
from pm3dof_pin.export.xml_text import document_text

_BANNER = "The URDF of {}, its meshes where `pm3dof export` puts them. Generated: edit the original."


def description_texts(robot: RobotDocument, mesh_prefix: str = "", banner: str | None = None) -> dict[str, str]:
    """Return URDF, closures file, error file and SRDF, by name; names of meshes begin with a prefix.

    With a banner, the URDF is written anew under it.
    """
    texts = urdf_files(robot.described, floating=robot.floating, own_meshes=True)
    if banner is None:
        texts[".urdf"] = _with_meshes(robot, texts[".urdf"], mesh_prefix)
    else:
        texts[".urdf"] = document_text(_element(robot, texts[".urdf"], mesh_prefix), banner)
    if (tool_frame := robot.mechanism.tool_frame) is not None:
        texts[CLOSURES_SUFFIX] = _with_tool_frame(robot, texts.get(CLOSURES_SUFFIX), tool_frame)
    order = (".urdf", CLOSURES_SUFFIX, ".errors.yaml", ".srdf")
    return {robot.file_name + suffix: texts[suffix] for suffix in order if suffix in texts}


def _with_tool_frame(robot: RobotDocument, closures: str | None, tool_frame: str) -> str:
    """Return the text of the closures file, if any, with the tool frame that the robot was loaded with."""
    line = f"tool_frame: {tool_frame}\n"
    if closures is None:
        return f"name_mot: [{', '.join(robot.mechanism.actuated_joints)}]\n{line}"
    if (yaml.safe_load(closures) or {}).get("tool_frame") == tool_frame:
        return closures
    return "".join(kept for kept in closures.splitlines(True) if not kept.startswith("tool_frame:")) + line


def urdf_text(robot: RobotDocument) -> str:
    """Return the URDF of a robot, verbatim if it is one without meshes."""
    return _with_meshes(robot, urdf_files(robot.described, floating=robot.floating, own_meshes=True)[".urdf"], "")


def _with_meshes(robot: RobotDocument, text: str, mesh_prefix: str) -> str:
    if "<mesh" not in text:
        return text
    return document_text(_element(robot, text, mesh_prefix), _BANNER.format(robot.name))


def urdf_element(robot: RobotDocument) -> ElementTree.Element:
    """Return a robot's URDF with its meshes named as in the export, and without limits that stand for none."""
    return _element(robot, urdf_files(robot.described, floating=robot.floating, own_meshes=True)[".urdf"], "")


def _element(robot: RobotDocument, text: str, mesh_prefix: str) -> ElementTree.Element:
    root = ElementTree.fromstring(text)
    for link in root.findall("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            if (mesh := shape.find("geometry/mesh")) is None:
                continue
            if len(robot.meshes):
                mesh.set("filename", mesh_prefix + robot.meshes.exported(mesh.get("filename", "")))
            else:
                link.remove(shape)
    for joint in robot.description.joints:
        if joint.lower is None:
            for limit in root.iterfind(f"joint[@name='{joint.name}']/limit"):
                limit.attrib.pop("lower", None)
                limit.attrib.pop("upper", None)
    return root
