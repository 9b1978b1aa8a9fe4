"""A description as files: URDF, closures file and SRDF, with all digits of numbers."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator
from typing import Any
from xml.etree import ElementTree

import msgspec
import numpy as np

from pm3dof_pin.description.closures import DriveSchema
from pm3dof_pin.description.description import Body, Description, Drive, Inertial, Joint, Placement, Shape
from pm3dof_pin.description.mesh_files import find_mesh
from pm3dof_pin.description.robots import CLOSURES_SUFFIX, RobotFiles
from pm3dof_pin.description.simple_joints import NEGLIGIBLE, Floating, with_frames_as_bodies, with_simple_joints
from pm3dof_pin.description.yaml_file import yaml_text
from pm3dof_pin.exceptions import DescriptionError

_logger = logging.getLogger(__name__)

_URDF_TYPES = ("fixed", "revolute", "continuous", "prismatic", "floating")


def urdf_files(description: Description, *, floating: Floating = "any", own_meshes: bool = False) -> dict[str, str]:
    """Return the texts of a robot's files by suffix: ".urdf", ".closures.yaml", ".srdf" and, if any, ".errors.yaml".

    Those of a robot that was read from a URDF whose joints are as they were are unchanged; otherwise they are written,
    `floating` joints only those that are kept. Meshes are named by the paths of their files, and omitted where these
    are missing, or with `own_meshes` as in the description.

    Raises:
        DescriptionError: a joint type cannot be written.
    """
    files, errors = description.files, {}
    if files is not None and files.errors.is_file():
        errors[".errors.yaml"] = files.errors.read_text(encoding="utf-8")
    if files is not None and _is_plain_urdf(description, floating=floating):
        paths = {CLOSURES_SUFFIX: files.closures, ".srdf": files.srdf}
        others = {key: path.read_text(encoding="utf-8") for key, path in paths.items() if path is not None}
        return {".urdf": files.tree_text(), **others, **errors}
    simple = with_simple_joints(description, floating=floating)
    entries = closure_entries(simple)
    return {
        ".urdf": _document(_robot(with_frames_as_bodies(simple), own_meshes=own_meshes)),
        CLOSURES_SUFFIX: yaml_text(entries) if entries else "{}\n",
        ".srdf": _document(_configurations(simple)),
        **errors,
    }


def _is_plain_urdf(description: Description, *, floating: Floating = "any") -> bool:
    """Return whether a description is that of its URDF file, all of whose joints can stay."""
    if description.files is None or description.files.format != "urdf":
        return False
    if with_simple_joints(description, floating=floating) is not description or description.frames:
        return False
    if any(loop.length and loop.origin.path != description.files.closures for loop in description.closures):
        return False  # a rod in the tree, whose length may be another than there
    names = {joint.get("name") for joint in description.files.read_tree().iter("joint")}
    return {joint.name for joint in description.joints} <= names


def _document(root: ElementTree.Element) -> str:
    ElementTree.indent(root, "  ")
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


# The tree


def _robot(description: Description, *, own_meshes: bool) -> ElementTree.Element:
    robot = ElementTree.Element("robot", name=description.name)
    moving = {joint.child for joint in description.joints if not joint.is_fixed}
    files = None if own_meshes else description.files
    for body in description.bodies:
        _add_link(robot, body, files, needs_mass=body.name in moving)
    for joint in description.joints:
        _add_joint(robot, joint)
    return robot


def _add_link(robot: ElementTree.Element, body: Body, files: RobotFiles | None, *, needs_mass: bool) -> None:
    link = ElementTree.SubElement(robot, "link", name=body.name)
    if (inertial := body.inertial or (NEGLIGIBLE if needs_mass else None)) is not None:
        _add_inertial(link, inertial)
    for tag, shapes in (("visual", body.visuals), ("collision", body.collisions)):
        for shape in shapes:
            for kind, sizes, offset in _primitives(shape, files):
                element = ElementTree.SubElement(link, tag)
                _add_origin(element, shape.placement * Placement((0.0, 0.0, offset)) if offset else shape.placement)
                ElementTree.SubElement(ElementTree.SubElement(element, "geometry"), kind, sizes)
                if tag == "visual" and shape.colour is not None:
                    material = ElementTree.SubElement(element, "material", name=f"{body.name}_colour")
                    ElementTree.SubElement(material, "color", rgba=_text(shape.colour))


def _primitives(shape: Shape, files: RobotFiles | None) -> Iterator[tuple[str, dict[str, str], float]]:
    """Yield the shapes of URDF that a shape consists of: tag, sizes, and offset along its z axis; none for others."""
    match shape.kind:
        case "mesh":
            try:
                name = shape.mesh if files is None else str(find_mesh(files, shape.mesh))
            except DescriptionError as error:
                _logger.warning("%s: the shape is omitted", error)
                return
            yield "mesh", {"filename": name, "scale": _text(shape.sizes)}, 0.0
        case "box":
            yield "box", {"size": _text(shape.sizes)}, 0.0
        case "sphere":
            yield "sphere", {"radius": _text(shape.sizes)}, 0.0
        case "cylinder" | "capsule":
            radius, length = (_text([size]) for size in shape.sizes)
            yield "cylinder", {"radius": radius, "length": length}, 0.0
            if shape.kind == "capsule":
                yield from (("sphere", {"radius": radius}, side * shape.sizes[1]) for side in (-0.5, 0.5))
        case _:
            return


def _add_joint(robot: ElementTree.Element, joint: Joint) -> None:
    if joint.type not in _URDF_TYPES:
        raise joint.origin.error(f"joint '{joint.name}'", f"expected a joint type of URDF, not {joint.type}")
    element = ElementTree.SubElement(robot, "joint", name=joint.name, type=joint.type)
    ElementTree.SubElement(element, "parent", link=joint.parent)
    ElementTree.SubElement(element, "child", link=joint.child)
    _add_origin(element, joint.placement * joint.child_placement)
    if not joint.is_single:
        return
    ElementTree.SubElement(element, "axis", xyz=_text(joint.axis))
    limits = {"lower": joint.lower, "upper": joint.upper, "effort": joint.effort, "velocity": joint.velocity}
    given = {key: _text([value]) for key, value in limits.items() if value is not None}
    ElementTree.SubElement(element, "limit", {"effort": "0.0", "velocity": "0.0"} | given)
    if joint.damping or joint.friction:
        dynamics = {"damping": _text([joint.damping]), "friction": _text([joint.friction])}
        ElementTree.SubElement(element, "dynamics", dynamics)


def _add_origin(element: ElementTree.Element, placement: Placement) -> None:
    xyz, rpy = _text(placement.position), _text(placement.roll_pitch_yaw)
    ElementTree.SubElement(element, "origin", xyz=xyz, rpy=rpy)


def _add_inertial(link: ElementTree.Element, inertial: Inertial) -> None:
    element = ElementTree.SubElement(link, "inertial")
    _add_origin(element, inertial.placement)
    ElementTree.SubElement(element, "mass", value=_text([inertial.mass]))
    keys = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    moments = {key: _text([value]) for key, value in zip(keys, inertial.moments, strict=True)}
    ElementTree.SubElement(element, "inertia", moments)


def _configurations(description: Description) -> ElementTree.Element:
    root = ElementTree.Element("robot", name=description.name)
    for name, values in description.configurations.items():
        state = ElementTree.SubElement(root, "group_state", name=name, group="all")
        for joint, numbers in values.items():
            ElementTree.SubElement(state, "joint", name=joint, value=_text(numbers))
    for one, other in description.untouchable:
        ElementTree.SubElement(root, "disable_collisions", link1=one, link2=other, reason="Never")
    return root


# The closures file


def closure_entries(description: Description) -> dict[str, Any]:
    """Return the entries of a description's closures file; those that are empty are left out."""
    loops = description.closures
    axes = [_without_none({"axis": loop.axis, "axis_b": loop.axis_b}) for loop in loops]
    limits = [loop.swing_limit and {"swing_rad": loop.swing_limit} for loop in loops]
    lengths = [loop.length for loop in loops]
    known = {joint.name for joint in description.joints if not joint.is_fixed}
    content: dict[str, Any] = {
        "closed_loop": [[loop.frame_a, loop.frame_b] for loop in loops],
        "type": [loop.type for loop in loops],
        "closure_axes": [yaml_data(entry) or None for entry in axes] if any(axes) else [],
        "closure_lengths": lengths if any(lengths) else [],
        "couplings": [
            {
                "joint": coupling.joint,
                "of": {name: list(part) for name, part in zip(coupling.joints, coupling.coefficients, strict=True)},
                "offset": coupling.offset,
            }
            for coupling in description.couplings
        ],
        "name_mot": list(description.actuated_joints),
        "tool_frame": description.tool_frame,
        "motion_coordinates": list(description.motion_coordinates),
        "tool_motions": list(description.tool_motions),
        "closure_limits": limits if any(limits) else [],
        "commands": [msgspec.structs.asdict(command) for command in description.commands],
        "coordinates": [_coordinate(vars(coordinate)) for coordinate in description.coordinates],
        "limit_groups": {
            group.name: [*group.joints, *group.closures]
            for group in description.limit_groups
            if set(group.joints) <= known
        },
        "springs": [yaml_data(spring) for spring in description.springs],
        "joints": {joint.name: {"armature": joint.armature} for joint in description.joints if joint.armature},
        "drives": {drive.joint: said for drive in description.drives if (said := _drive(drive))},
    }
    return {key: value for key, value in content.items() if value}


def _drive(drive: Drive) -> dict[str, Any]:
    """Return the numbers of a drive that are not the usual ones."""
    usual = Drive(drive.name, drive.joint)
    numbers = {key: yaml_data(getattr(drive, key)) for key in DriveSchema.__struct_fields__}
    return {key: value for key, value in numbers.items() if value != getattr(usual, key)}


def _coordinate(entries: dict[str, Any]) -> dict[str, Any]:
    entries = dict(entries)
    ends = [entries.pop(key) for key in ("lower", "upper")]
    return _without_none(entries | ({"range": ends} if None not in ends else {}))


def _without_none(entries: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in entries.items() if value is not None}


def yaml_data(value: Any) -> Any:
    """Return a value as lists, mappings and numbers that YAML can write."""
    if hasattr(value, "items"):
        return {key: yaml_data(entry) for key, entry in value.items()}
    return [yaml_data(entry) for entry in value] if isinstance(value, (list, tuple)) else value


def _text(numbers: Iterable[float]) -> str:
    return " ".join(repr(float(number) + 0.0) for number in np.asarray(numbers, dtype=float))
