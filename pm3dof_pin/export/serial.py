"""A closed robot as the tree that simulators and training code take, with the constants that its loops give."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pm3dof_pin.capability.mapping_fit import MappingFit
from pm3dof_pin.capability.serial_constants import UNITS, SerialConstants
from pm3dof_pin.description.description import Description, Drive, Joint, Placement
from pm3dof_pin.exceptions import InvalidValueError, first_words
from pm3dof_pin.export.mjcf import mjcf_text
from pm3dof_pin.export.plain_urdf import description_texts
from pm3dof_pin.export.robot_document import document_of
from pm3dof_pin.files import write_text_atomically
from pm3dof_pin.kinematics.robot import Robot

_SAME_PLACE = 1e-6  # relative to the robot's size: the tool of the tree and that of the closed robot


def serial_tree(robot: Robot, part: Robot, rigid: Sequence[str] = ()) -> Description:
    """Return a robot without the loops of a part of it, whose joints in loops but its coordinates are fixed at home.

    Args:
        robot: the whole robot, which was read from files.
        part: the robot itself, or what one of its links carries, with joints as coordinates
            (:func:`~pm3dof_pin.capability.transmission.joint_driven`). Loops outside of it remain.
        rigid: other joints that are fixed, as they are in the part.

    Raises:
        InvalidValueError: a coordinate is not a joint, or the tool does not hang on these joints.
    """
    joints = [coordinate.name for coordinate in part.coordinates]
    if joints != [coordinate.joint for coordinate in part.coordinates]:
        raise InvalidValueError("joints", ", ".join(joints), f"joints of the tree: {_that_could_serve(part)}")
    held = (_joints_in_loops(part) | set(rigid)) - set(joints)
    kept = {joint.name for joint in robot.description.joints if not joint.is_fixed} - held
    closed = {(loop.frame_a, loop.frame_b) for loop in part.closures}
    coupled = {coupling.joint for coupling in part.couplings}
    actuated = [name for name in robot.actuated_joints if name not in part.actuated_joints]
    home = robot.home
    fixed = {}
    for joint in robot.description.joints:
        if joint.name in held:
            inside = home.frame_placement(joint.parent).actInv(home.frame_placement(joint.child))
            fixed[joint.name] = Joint(
                joint.name, "fixed", joint.parent, joint.child, Placement.from_se3(inside), origin=joint.origin
            )
    tree = replace(
        robot.description.with_joints(fixed),
        closures=tuple(loop for loop in robot.closures if (loop.frame_a, loop.frame_b) not in closed),
        couplings=tuple(coupling for coupling in robot.couplings if coupling.joint not in coupled),
        drives=tuple(drive for drive in robot.description.drives if drive.joint in set(actuated)),
        actuated_joints=(*actuated, *joints),
        tool_frame=robot.tool_frame,
        commands=(),
        motion_coordinates=(),
        coordinates=(),
        limit_groups=(),
        tool_motions=(),
        springs=(),
        configurations={
            name: {joint: values for joint, values in entries.items() if joint in kept}
            for name, entries in {**robot.description.configurations, **_home_of_its_own(robot)}.items()
        },
        files=None,
    )
    _require_same_tool(part, Robot.load(replace(tree, tool_frame=None)), held)
    return tree


def _that_could_serve(part: Robot) -> str:
    """Return in words which joints could stand for a part's coordinates: their own, or those that carry the tool."""
    count, own = len(part.coordinates), [c.joint for c in part.coordinates if c.joint is not None]
    if len(own) == count:
        return f"--joints {','.join(own)}"
    model, tree = part.model, {joint.name for joint in part.description.joints if joint.is_single}
    carrying = model.supports[model.frames[part.tool_frame_id].parentJoint] if part.tool_frame else ()
    names = [model.names[k] for k in carrying if model.names[k] in tree]
    if len(names) == count:
        return f"--joints {','.join(names)}, which carry {part.tool_frame}"
    if len(names) < count:
        return "name them with --joints A,B, or one leg with --subtree LINK"
    return f"--joints A,B with {count} of {first_words(names)}, which determine the others"


def _home_of_its_own(robot: Robot) -> dict[str, dict[str, tuple[float, ...]]]:
    """Return the home of a robot as an entry of its description, if :meth:`Robot.with_home` gave it another one."""
    if "home" not in robot.named_configurations:
        return {}
    q, described = robot.named_configurations["home"], robot.description.configurations.get("home", {})
    found = {}
    for name, joint in zip(list(robot.model.names)[1:], list(robot.model.joints)[1:], strict=True):
        found[name] = tuple(q[joint.idx_q : joint.idx_q + joint.nq].tolist()) if joint.nq == joint.nv else ()
    return {"home": dict(described) | {name: values for name, values in found.items() if values}}


def _with_constants(tree: Description, constants: SerialConstants) -> Description:
    """Return a tree with the constants of its joints: limits, armature, losses, and drives with gains.

    Losses of a joint that is a drive itself are among those of the drives, and do not count twice.
    """
    found, drives, drives_of_closed = {}, [], set(constants.drives)
    for k, name in enumerate(constants.model.joints):
        numbers: dict[str, Any] = {key: float(value[k]) for key, value in constants.values.items()}
        gains = {key: numbers.pop(key, None) for key in ("kp", "kd")}
        joint = tree.joint(name)
        own = {key: 0.0 if name in drives_of_closed else getattr(joint, key) for key in ("damping", "friction")}
        losses = {key: value + numbers.pop(key, 0.0) for key, value in own.items()}
        ends = {"lower": float(constants.lower[k]), "upper": float(constants.upper[k])}
        found[name] = replace(joint, **{"effort": None, "velocity": None} | ends | numbers | losses)
        force = None if "effort" not in numbers else (-numbers["effort"], numbers["effort"])
        if gains["kp"] is None:
            drives.append(Drive(name, name, force_range=force))
        else:
            kp, kd = gains["kp"], gains["kd"]
            drives.append(
                Drive(name, name, kind="position", proportional_gain=kp, derivative_gain=kd, force_range=force)
            )
    return replace(tree.with_joints(found), drives=(*tree.drives, *drives))


def write_serial(
    robot: Robot,
    tree: Description,
    constants: SerialConstants,
    folder: str | Path,
    *,
    fit: MappingFit | None = None,
    meshes: bool = True,
) -> list[Path]:
    """Write a serial model as URDF and MJCF, the closed robot next to it, and the constants as JSON.

    Args:
        robot: the closed robot, which was read from files.
        tree: it without its loops, of :func:`serial_tree`.
        constants: of :func:`~pm3dof_pin.capability.serial_constants.serial_constants`.
        folder: output folder, created if missing.
        fit: polynomials of the mapping, written with the constants.
        meshes: whether mesh shapes are written, and their files copied.

    Returns:
        The files written.

    Raises:
        InvalidValueError: the robot was not read from files.
        DescriptionError: MJCF or URDF cannot express the robot.
        OutputError: a file cannot be written.
    """
    if robot.files is None:
        raise InvalidValueError("robot", robot.name, "a robot that was read from files")
    closed = document_of(robot, robot.files, meshes=meshes, floating="root")
    serial = document_of(Robot.load(_with_constants(tree, constants)), robot.files, meshes=meshes, floating="root")
    name, banner = closed.file_name, "\n".join([f"{robot.name} without its loops.", *constant_lines(constants, fit)])
    texts = {f"{name}_serial.xml": mjcf_text(serial, banner)}
    # in a folder of its own: a closures file counts for the MJCF of its name too
    for file, text in description_texts(serial, "../", banner).items():
        texts[f"urdf/{name}_serial{file.removeprefix(serial.file_name)}"] = text
    texts[f"{name}_closed.xml"] = mjcf_text(closed)
    texts[f"{name}_serial.json"] = json.dumps(serial_entries(constants, fit), indent=2) + "\n"
    target = Path(folder)
    written = [write_text_atomically(target / file, text) for file, text in texts.items()]
    return [*written, *closed.meshes.write(target)]


def constant_lines(constants: SerialConstants, fit: MappingFit | None = None) -> list[str]:
    """Return what is typed for each joint, its range over the box and its error there, a line each."""
    model, place = constants.model, ""
    if constants.at is not None:
        place = " at " + ", ".join(f"{joint} {q:.4g}" for joint, q in zip(model.joints, constants.at, strict=True))
    words = {"at": f"those{place}", "least-wrong": "the least wrong", "worst": "the cautious ends"}
    box = ", ".join(f"{joint} {a:.4g} to {b:.4g}" for joint, a, b in zip(model.joints, *_ends(constants), strict=True))
    lines = [f"Constants are {words[constants.choice]} over the box {box} (m, rad)."]
    if model.unreached:
        lines.append(
            f"{100 * model.unreached:.1f} % of that box is out of reach; limits are those of a part within reach."
        )
    for k, (joint, unit) in enumerate(zip(model.joints, model.units, strict=True)):
        for name, value in constants.values.items():
            spread, shown = constants.spreads[name], UNITS[name][unit == "rad"]
            error = 100.0 * constants.errors[name][k]
            over = f"{spread.least[k]:.4g} to {spread.greatest[k]:.4g}"
            lines.append(f"{joint}: {name} {value[k]:.4g} {shown}; over the box {over}, off by up to {error:.0f} %")
    if starts := constants.accelerations:
        ends = zip(model.joints, starts.least, starts.greatest, strict=True)
        ratios = ", ".join(f"{joint} {low:.2f} to {high:.2f}" for joint, low, high in ends)
        lines.append(f"Under the same torque joints start {ratios} times as fast as the closed robot's, over the box.")
    for name, share in constants.together.items():
        lines.append(f"All joints at once have {100 * share:.0f} % of these limits of {name} everywhere in the box.")
    if model.coupling:
        lines.append(f"Rotors couple the joints by up to {100 * model.coupling:.0f} %, which is left out here.")
    if fit is not None:
        degree, worst = int(fit.powers.sum(axis=1).max()), ", ".join(f"{error:.2g}" for error in fit.worst)
        lines.append(f"Polynomials of degree {degree} give {', '.join(fit.drives)} to {worst} (m, rad).")
    lines.append("Armature is that of rotors and bodies of the loops; URDF has no words for it.")
    return lines


def _ends(constants: SerialConstants) -> tuple[Any, Any]:
    return constants.model.lower, constants.model.upper


def serial_entries(constants: SerialConstants, fit: MappingFit | None = None) -> dict[str, Any]:
    """Return the constants for JSON, in SI units and radians."""
    model = constants.model
    result: dict[str, Any] = {
        "units": "m, rad, kg, N, N m",
        "joints": model.joints,
        "choice": constants.choice,
        "at": None if constants.at is None else constants.at.tolist(),
        "box": [model.lower.tolist(), model.upper.tolist()],
        "limits": [constants.lower.tolist(), constants.upper.tolist()],
        "share_out_of_reach": model.unreached,
        "together": dict(constants.together),
        "rotor_coupling": model.coupling,
    }
    if starts := constants.accelerations:
        ends = {"least": starts.least.tolist(), "greatest": starts.greatest.tolist()}
        result["acceleration_by_that_of_closed_robot"] = ends
    for name, value in constants.values.items():
        spread = constants.spreads[name]
        result[name] = {
            "value": value.tolist(),
            "least": spread.least.tolist(),
            "greatest": spread.greatest.tolist(),
            "relative_error": constants.errors[name].tolist(),
        }
    return result | ({} if fit is None else {"mapping": fit.entries()})


def _joints_in_loops(robot: Robot) -> set[str]:
    """Return the joints that a closure or a coupling moves together with others."""
    model = robot.model
    found = {name for coupling in robot.couplings for name in (coupling.joint, *coupling.joints)}
    for loop in robot.closures:
        ends = [model.frames[robot.frame_id(frame)].parentJoint for frame in (loop.frame_a, loop.frame_b)]
        one, other = (set(model.supports[end]) for end in ends)
        found |= {model.names[k] for k in one ^ other}
    return found


def _require_same_tool(part: Robot, tree: Robot, held: Sequence[str] | set[str]) -> None:
    """Check that the joints carry the tool, at a pose away from home."""
    if part.tool_frame is None:
        return
    home = part.home_coordinates
    poses = part.solve(home + 0.02 * np.linspace(1.0, 0.5, len(home)), on_failure="nan")
    if not np.isfinite(poses.q).all():
        return
    closed, q = poses.configuration(), np.array(tree.home.q)
    for coordinate, value in zip(part.coordinates, poses.coordinates, strict=True):
        tree.single_joint(coordinate.joint or "").set_coordinate(q, float(value))
    moved = tree.configuration(q).frame_placement(part.tool_frame).actInv(closed.frame_placement(part.tool_frame))
    if np.abs(moved.homogeneous - np.eye(4)).max() > _SAME_PLACE * max(1.0, part.characteristic_length):
        raise InvalidValueError(
            "joints",
            ", ".join(c.name for c in part.coordinates),
            f"joints that carry {part.tool_frame}, which moves with {', '.join(sorted(held))} of the loops too",
        )
