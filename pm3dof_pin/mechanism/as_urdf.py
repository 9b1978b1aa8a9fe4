"""Any robot as a plain URDF with a closures file, for tools that read or edit URDF.

A spherical joint, which URDF does not have, becomes revolute joints about x, y and z through one point: equivalent as
long as the second stays away from 90 degrees. For tools without floating joints, prismatic joints along x, y and z
precede these. The links between them, and other moving links without mass, get a mass of 0.01 g, which simulators need
and which is negligible in statics.
"""

from __future__ import annotations

import atexit
import copy
import logging
import math
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import msgspec
import numpy as np
import pinocchio as pin
import yaml
from numpy.typing import ArrayLike

from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.description.robots import CLOSURES_SUFFIX, RobotFiles
from pm3dof_pin.description.xml_file import read_xml
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.mechanism.visuals import Visual, read_visuals
from pm3dof_pin.typing import Matrix, Vector

NEGLIGIBLE_MASS = 1e-5
"""Mass of moving links that have none [kg]."""

NEGLIGIBLE_MOMENT = 1e-9
"""Moment of inertia of such links about every axis [kg m^2]."""

_logger = logging.getLogger(__name__)
_LIMITS = {
    kind: {"lower": f"-{most}", "upper": most, "effort": "0.0", "velocity": "0.0"}
    for kind, most in {"revolute": "6.283185307179586", "prismatic": "1000.0"}.items()
}
_BALL = (("", "x", "revolute"), ("_y", "y", "revolute"), ("_z", "z", "revolute"))
_SIMPLE_JOINTS = {
    "Spherical": _BALL,
    "Planar": (("", "x", "prismatic"), ("_along_y", "y", "prismatic"), ("_about_z", "z", "revolute")),
    "FreeFlyer": (
        ("", "x", "prismatic"),
        ("_along_y", "y", "prismatic"),
        ("_along_z", "z", "prismatic"),
        *((f"_about_{axis}", axis, kind) for _, axis, kind in _BALL),
    ),
}
"""Replacements of joints that URDF, or a tool, does not have: name suffix, axis and type."""


def as_urdf(mechanism: Mechanism, *, floating: bool = True) -> RobotFiles:
    """Return the files of a robot as a URDF with revolute and prismatic joints only, except for a `floating` base.

    A URDF without replaced joints is returned unchanged; otherwise temporary files are written, which last as long as
    the process.

    Raises:
        DescriptionError: the mechanism was not read from files, or a joint type cannot be written.
    """
    files = mechanism.files
    if files is None:
        raise DescriptionError(mechanism.source, "files", "expected a mechanism that was read from files")
    names = (
        {str(joint.get("name")) for joint in read_xml(files.path).iter("joint")} if files.format == "urdf" else set()
    )
    kept = ("FreeFlyer",) if floating else ()
    joints = list(mechanism.model.joints)[1:]
    plain = all(joint.nv == 1 or any(kind in joint.shortname() for kind in kept) for joint in joints)
    if names and plain and set(list(mechanism.model.names)[1:]) <= names:
        return files
    folder = Path(tempfile.mkdtemp(prefix="pm3dof_"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    urdf = folder / f"{files.name}.urdf"
    _write(urdf, _tree(mechanism, files, floating))
    closures = urdf.with_name(files.name + CLOSURES_SUFFIX)
    closures.write_text(yaml.safe_dump(_closures(mechanism), sort_keys=False, width=120), encoding="utf-8")
    _write(urdf.with_suffix(".srdf"), _named_configurations(mechanism, files, floating))
    if files.errors.is_file():
        shutil.copy(files.errors, urdf.with_suffix(".errors.yaml"))
    return replace(
        files,
        path=urdf,
        closures=closures,
        srdf=urdf.with_suffix(".srdf"),
        format="urdf",
        own_folders=(*files.own_folders, *_mesh_folders(urdf)),  # checked when they were read
    )


def _mesh_folders(urdf: Path) -> set[Path]:
    return {Path(mesh.get("filename", "")).parent for mesh in read_xml(urdf).iter("mesh")}


def _write(path: Path, root: ElementTree.Element) -> None:
    ElementTree.indent(root, "  ")
    text = ElementTree.tostring(root, encoding="unicode")
    path.write_text(f'<?xml version="1.0"?>\n{text}\n', encoding="utf-8")


# The tree


def _tree(mechanism: Mechanism, files: RobotFiles, floating: bool) -> ElementTree.Element:
    model = mechanism.model
    robot = ElementTree.Element("robot", name=mechanism.name)
    frames = [frame for frame in list(model.frames)[1:] if frame.type in (pin.FrameType.BODY, pin.FrameType.OP_FRAME)]
    links = [_name_of_link(model, joint) for joint in range(model.njoints)]
    shapes = _shapes(mechanism, files)
    for joint, link in enumerate(links):
        element = ElementTree.SubElement(robot, "link", name=link)
        if joint:
            _add_inertial(element, model.inertias[joint])
        element.extend(shapes.get(joint, []))
    for joint in range(1, model.njoints):
        _add_joint(robot, mechanism, joint, (links[model.parents[joint]], links[joint]), floating)
    for frame in frames:
        if frame.name != links[frame.parentJoint]:
            ElementTree.SubElement(robot, "link", name=frame.name)
            fixed = ElementTree.SubElement(robot, "joint", name=f"{frame.name}_fixed", type="fixed")
            _add_ends(fixed, links[frame.parentJoint], frame.name, frame.placement)
    return robot


def _name_of_link(model: pin.Model, joint: int) -> str:
    """Name the link of a joint: the body in the joint's frame, if there is one."""
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY and frame.parentJoint == joint and frame.placement.isIdentity(0.0):
            return str(frame.name)
    return "base" if joint == 0 else f"{model.names[joint]}_link"


def _add_joint(
    robot: ElementTree.Element, mechanism: Mechanism, index: int, links: tuple[str, str], floating: bool
) -> None:
    parent, child = links
    model, name, joint = mechanism.model, mechanism.model.names[index], mechanism.model.joints[index]
    kind = joint.shortname()
    if "FreeFlyer" in kind and floating:
        element = ElementTree.SubElement(robot, "joint", name=name, type="floating")
        _add_ends(element, parent, child, model.jointPlacements[index])
        return
    parts = _SIMPLE_JOINTS.get(next((known for known in _SIMPLE_JOINTS if known in kind), ""), ())
    if parts:
        placement = model.jointPlacements[index]
        for suffix, axis, moves in parts:
            link = child if suffix == parts[-1][0] else f"{name}_{moves}_{axis}"
            if link != child:
                carrier = ElementTree.SubElement(robot, "link", name=link)
                _add_inertial(carrier, pin.Inertia.Zero())
            along = np.eye(3)["xyz".index(axis)]
            _add_hinge(robot, name + suffix, moves, parent, link, placement, along, _LIMITS[moves])
            parent, placement = link, pin.SE3.Identity()
        return
    if joint.nv != 1:
        raise DescriptionError(mechanism.source, f"joint '{name}'", f"expected a joint type of URDF, not {kind}")
    data = joint.createData()
    joint.calc(data, pin.neutral(model)[joint.idx_q : joint.idx_q + joint.nq])
    subspace = np.asarray(data.S).reshape(6)
    slides = mechanism.single_joint(name).translates
    limits = {
        "lower": float(mechanism.lower_limits[joint.idx_q]),
        "upper": float(mechanism.upper_limits[joint.idx_q]),
        "effort": float(model.upperEffortLimit[joint.idx_v]),
        "velocity": float(model.upperVelocityLimit[joint.idx_v]),
    }
    written = {key: repr(value) for key, value in limits.items() if abs(value) < 1e300}
    kind = "prismatic" if slides else "continuous" if joint.nq == 2 else "revolute"
    along = subspace[:3] if slides else subspace[3:]
    _add_hinge(robot, name, kind, parent, child, model.jointPlacements[index], along, written)


def _add_hinge(
    robot: ElementTree.Element,
    name: str,
    kind: str,
    parent: str,
    child: str,
    placement: pin.SE3,
    axis: ArrayLike,
    limits: dict[str, str],
) -> None:
    element = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    _add_ends(element, parent, child, placement)
    ElementTree.SubElement(element, "axis", xyz=_text(np.asarray(axis)))
    ElementTree.SubElement(element, "limit", {"effort": "0.0", "velocity": "0.0"} | limits)


def _add_ends(element: ElementTree.Element, parent: str, child: str, placement: pin.SE3) -> None:
    ElementTree.SubElement(element, "parent", link=parent)
    ElementTree.SubElement(element, "child", link=child)
    _add_origin(element, placement)


def _add_origin(element: ElementTree.Element, placement: pin.SE3) -> None:
    rpy = _roll_pitch_yaw(placement.rotation)
    ElementTree.SubElement(element, "origin", xyz=_text(placement.translation), rpy=_text(rpy))


def _add_inertial(link: ElementTree.Element, inertia: pin.Inertia) -> None:
    if inertia.mass == 0.0:
        inertia = pin.Inertia(NEGLIGIBLE_MASS, np.zeros(3), NEGLIGIBLE_MOMENT * np.eye(3))
    inertial = ElementTree.SubElement(link, "inertial")
    _add_origin(inertial, pin.SE3(np.eye(3), inertia.lever))
    ElementTree.SubElement(inertial, "mass", value=repr(float(inertia.mass)))
    moments = {
        f"i{a}{b}": inertia.inertia["xyz".index(a), "xyz".index(b)] for a, b in ("xx", "yy", "zz", "xy", "xz", "yz")
    }
    ElementTree.SubElement(inertial, "inertia", {key: repr(float(value)) for key, value in moments.items()})


def _shapes(mechanism: Mechanism, files: RobotFiles) -> dict[int, list[ElementTree.Element]]:
    """The visual elements, by joint; shapes that URDF does not have are omitted."""
    shapes: dict[int, list[ElementTree.Element]] = {}
    try:
        visuals = read_visuals(mechanism.description)
    except DescriptionError as error:
        _logger.warning("%s: its shapes are omitted", error)
        return shapes
    for each in visuals:
        frame = mechanism.model.frames[mechanism.frame_id(each.body)]
        for tag, sizes, offset in _primitives(each):
            visual = ElementTree.Element("visual")
            placement = frame.placement * each.shape.placement.se3
            _add_origin(visual, placement * pin.SE3(np.eye(3), np.array([0.0, 0.0, offset])))
            ElementTree.SubElement(ElementTree.SubElement(visual, "geometry"), tag, sizes)
            if each.shape.colour is not None:
                material = ElementTree.SubElement(visual, "material", name=f"{each.shape.name}_colour")
                ElementTree.SubElement(material, "color", rgba=_text(np.asarray(each.shape.colour)))
            shapes.setdefault(frame.parentJoint, []).append(visual)
    return shapes


def _primitives(visual: Visual) -> Iterator[tuple[str, dict[str, str], float]]:
    """Yield the URDF shapes that a shape consists of: tag, sizes, and offset along its z axis."""
    shape = visual.shape
    if shape.kind == "mesh":
        yield "mesh", {"filename": str(visual.path), "scale": _text(shape.sizes)}, 0.0
    elif shape.kind == "box":
        yield "box", {"size": _text(shape.sizes)}, 0.0
    elif shape.kind == "sphere":
        yield "sphere", {"radius": repr(shape.sizes[0])}, 0.0
    elif shape.kind in ("cylinder", "capsule"):
        radius, length = shape.sizes
        yield "cylinder", {"radius": repr(radius), "length": repr(length)}, 0.0
        if shape.kind == "capsule":
            yield from (("sphere", {"radius": repr(radius)}, end) for end in (-0.5 * length, 0.5 * length))


# The other files


def _closures(mechanism: Mechanism) -> dict[str, Any]:
    content: dict[str, Any] = {
        "closed_loop": [[loop.frame_a, loop.frame_b] for loop in mechanism.closures],
        "type": [loop.type for loop in mechanism.closures],
        **closure_entries(mechanism),
        "name_mot": list(mechanism.actuated_joints),
        "tool_frame": mechanism.tool_frame,
        "motion_coordinates": list(mechanism.motion_coordinates),
        "tool_motions": [] if mechanism.tool_motions == TOOL_COMPONENTS else list(mechanism.tool_motions),
        "closure_limits": [loop.swing_limit and {"swing_rad": loop.swing_limit} for loop in mechanism.closures],
        "commands": [msgspec.structs.asdict(command) for command in mechanism.commands],
        "coordinates": [_coordinate(vars(coordinate)) for coordinate in mechanism.declared_coordinates],
        "limit_groups": {
            group.name: [*group.joints, *group.closures]
            for group in mechanism.limit_groups
            if set(group.joints) <= set(list(mechanism.model.names)[1:])
        },
        "springs": [_plain(spring) for spring in mechanism.springs],
    }
    return {key: value for key, value in content.items() if value}


def closure_entries(mechanism: Mechanism) -> dict[str, Any]:
    """Return axes and lengths of closures, and couplings, as entries of a closures file."""
    axes = [_without_none({"axis": loop.axis, "axis_b": loop.axis_b}) for loop in mechanism.closures]
    lengths = [loop.length for loop in mechanism.closures]
    couplings = [
        {
            "joint": coupling.joint,
            "of": {name: list(powers) for name, powers in zip(coupling.joints, coupling.coefficients, strict=True)},
            "offset": coupling.offset,
        }
        for coupling in mechanism.couplings
    ]
    return {
        "closure_axes": [_plain(entry) or None for entry in axes] if any(axes) else [],
        "closure_lengths": lengths if any(lengths) else [],
        "couplings": couplings,
    }


def _coordinate(entries: dict[str, Any]) -> dict[str, Any]:
    entries = dict(entries)
    ends = [entries.pop(key) for key in ("lower", "upper")]
    return _without_none(entries | ({"range": ends} if None not in ends else {}))


def _without_none(entries: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in entries.items() if value is not None}


def _plain(value: Any) -> Any:
    if hasattr(value, "items"):
        return {key: _plain(entry) for key, entry in value.items()}
    return [_plain(entry) for entry in value] if isinstance(value, (list, tuple)) else value


def _named_configurations(mechanism: Mechanism, files: RobotFiles, floating: bool) -> ElementTree.Element:
    root = ElementTree.Element("robot", name=mechanism.name)
    for name, q in mechanism.named_configurations.items():
        state = ElementTree.SubElement(root, "group_state", name=name, group="all")
        for joint, values in _joint_values(mechanism, q, floating):
            ElementTree.SubElement(state, "joint", name=joint, value=_text(values))
    if files.srdf is not None:
        root.extend(copy.deepcopy(element) for element in read_xml(files.srdf).iter("disable_collisions"))
    return root


def _joint_values(mechanism: Mechanism, q: Vector, floating: bool) -> Iterator[tuple[str, Vector]]:
    for name, joint in list(zip(mechanism.model.names, mechanism.model.joints, strict=True))[1:]:
        values = q[joint.idx_q : joint.idx_q + joint.nq]
        kind = next((known for known in _SIMPLE_JOINTS if known in joint.shortname()), "")
        if not kind or (kind == "FreeFlyer" and floating):
            yield name, np.asarray(values)
            continue
        if kind == "Planar":
            numbers = [*values[:2], math.atan2(values[3], values[2])]
        else:
            turn = pin.Quaternion(np.array(values[-4:])).toRotationMatrix()
            # R = Rx(a) Ry(b) Rz(c), and its transpose is Rz(-c) Ry(-b) Rx(-a)
            numbers = [*values[:-4], *(-angle for angle in _roll_pitch_yaw(turn.T))]
        for (suffix, _, _), value in zip(_SIMPLE_JOINTS[kind], numbers, strict=True):
            yield name + suffix, np.array([value])


def _roll_pitch_yaw(rotation: Matrix) -> tuple[float, float, float]:
    """Return angles with R = Rz(yaw) Ry(pitch) Rx(roll), accurate to rounding even at 90 degrees of pitch."""
    yaw = math.atan2(rotation[1, 0], rotation[0, 0])
    pitch = math.atan2(-rotation[2, 0], math.hypot(rotation[0, 0], rotation[1, 0]))
    s, c = math.sin(yaw), math.cos(yaw)
    roll = math.atan2(s * rotation[0, 2] - c * rotation[1, 2], c * rotation[1, 1] - s * rotation[0, 1])
    return roll, pitch, yaw


def _text(numbers: Iterable[float]) -> str:
    return " ".join(repr(float(number) + 0.0) for number in numbers)
