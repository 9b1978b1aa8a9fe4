"""An MJCF file in Pinocchio: tree, loop closures, drives, springs and named configurations."""

from __future__ import annotations

import logging
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.closures import ClosuresFile, LoopClosure
from pm3dof_pin.description.coordinates import Command
from pm3dof_pin.description.mjcf import EqualityConstraint, Mjcf, read_mjcf
from pm3dof_pin.description.robots import RobotFiles
from pm3dof_pin.exceptions import DescriptionError, FrameNotFoundError, JointNotFoundError
from pm3dof_pin.mechanism.model import UNLIMITED

_logger = logging.getLogger(__name__)
_INITIAL = "qpos0"
_HOME = "home"


def read_mjcf_model(files: RobotFiles, closures_file: ClosuresFile) -> tuple[pin.Model, ClosuresFile]:
    """Read the model of an MJCF file, and complete the closures file next to it, whose entries take precedence.

    Joints are where MuJoCo has them: q is qpos except for the order of quaternion components, and home is the key of
    that name, or the initial configuration. Connects and welds become closures, by default as they are in the initial
    configuration; joint springs become springs, actuated joints drives.

    Raises:
        DescriptionError: the file is unreadable or uses unsupported features.
        FrameNotFoundError: a closure refers to an unknown body.
        JointNotFoundError: an actuator refers to an unknown joint.
    """
    mjcf = read_mjcf(files.path, files.own_folders)
    model = _tree(mjcf)
    for name, settings in mjcf.joints.items():
        joint = model.joints[model.getJointId(name)]
        if settings.unlimited or joint.nq > 1:  # Pinocchio limits free joints to 1.01 m from the origin
            entries = slice(joint.idx_q, joint.idx_q + joint.nq)
            model.lowerPositionLimit[entries], model.upperPositionLimit[entries] = -UNLIMITED, UNLIMITED
        elif settings.range is not None:
            model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q] = settings.range
    closures = _closures(model, mjcf)
    drives = _drives(model, mjcf)
    springs = [
        {
            "name": name,
            "type": "joint",
            "joint": name,
            "stiffness": settings.stiffness,
            "unit": "N/m" if _slides(model, name) else "N m/rad",
        }
        for name, settings in mjcf.joints.items()
        if settings.stiffness > 0.0
    ]
    return model, replace(
        closures_file,
        closures=(*closures, *closures_file.closures),
        actuated_joints=closures_file.actuated_joints or tuple(drive.joint for drive in drives),
        commands=closures_file.commands or (() if closures_file.actuated_joints else drives),
        tool_frame=closures_file.tool_frame or mjcf.tool,
        springs=(*springs, *closures_file.springs),
    )


def _tree(mjcf: Mjcf) -> pin.Model:
    with tempfile.TemporaryDirectory(prefix="pm3dof_") as folder:
        copy = Path(folder) / "model.xml"
        copy.write_text(mjcf.text, encoding="utf-8")
        try:
            model = pin.buildModelFromMJCF(str(copy))
        except (ValueError, RuntimeError, LookupError) as error:
            reason = " ".join(str(error).split()).rpartition("message: ")[2]
            raise DescriptionError(mjcf.path, "MJCF", f"expected a model that Pinocchio reads ({reason})") from error
    if lost := [name for name in mjcf.joints if not model.existJointName(name)]:
        raise DescriptionError(
            mjcf.path, f"joint '{lost[0]}'", "is not supported: expected a hinge, slide, ball or free joint"
        )
    for body, inertia in zip(list(model.names)[1:], list(model.inertias)[1:], strict=True):
        if not np.isfinite(inertia.toDynamicParameters()).all():
            raise DescriptionError(mjcf.path, f"body of joint '{body}'", "its inertia is not a number: expected one")
    model.name = mjcf.name
    model.gravity.linear = np.array(mjcf.gravity)
    references = {entry.key(): np.array(entry.data()) for entry in model.referenceConfigurations}
    for name, q in references.items():
        model.referenceConfigurations[name] = pin.normalize(model, q)
    if _HOME not in references:
        model.referenceConfigurations[_HOME] = references.get(_INITIAL, pin.neutral(model))
    return model


def _closures(model: pin.Model, mjcf: Mjcf) -> list[LoopClosure]:
    """Add the frames at which the equality constraints hold the bodies."""
    data = model.createData()
    references = {entry.key(): np.array(entry.data()) for entry in model.referenceConfigurations}
    pin.framesForwardKinematics(model, data, references.get(_INITIAL, pin.neutral(model)))
    closures = []
    for equality in mjcf.equalities:
        ids = [_frame_id(model, place, mjcf, equality) for place in equality.places]
        frames = equality.places
        if not equality.by_sites:
            first, second = (data.oMf[index] for index in ids)
            placements = _placements(equality, first.actInv(second))
            frames = (
                _add_frame(model, f"{equality.name}_{frames[0]}", ids[0], placements[0]),
                _add_frame(model, f"{equality.name}_{frames[1]}", ids[1], placements[1]),
            )
        closures.append(LoopClosure(*frames, "3d" if equality.kind == "connect" else "6d"))
    return closures


def _placements(equality: EqualityConstraint, initial: pin.SE3) -> tuple[pin.SE3, pin.SE3]:
    """Placements of the closure's frames in its two bodies; the second body is at `initial` in the first."""
    anchor = pin.SE3(np.eye(3), np.array(equality.anchor))
    if equality.kind == "connect":
        return anchor, initial.actInv(anchor)
    if equality.relative_pose is None:
        return initial * anchor, anchor
    position, (w, x, y, z) = np.array(equality.relative_pose[:3]), equality.relative_pose[3:]
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized().toRotationMatrix(), position), anchor


def _frame_id(model: pin.Model, place: str, mjcf: Mjcf, equality: EqualityConstraint) -> int:
    if not model.existFrame(place, pin.FrameType.BODY):
        bodies = [frame.name for frame in model.frames if frame.type == pin.FrameType.BODY]
        raise FrameNotFoundError(place, f"{mjcf.path}: <{equality.kind} name='{equality.name}'>", bodies)
    return int(model.getFrameId(place, pin.FrameType.BODY))


def _add_frame(model: pin.Model, name: str, body: int, placement: pin.SE3) -> str:
    frame = model.frames[body]
    model.addFrame(pin.Frame(name, frame.parentJoint, body, frame.placement * placement, pin.FrameType.OP_FRAME))
    return name


def _drives(model: pin.Model, mjcf: Mjcf) -> tuple[Command, ...]:
    drives = []
    for joint, name in mjcf.actuators.items():
        if not model.existJointName(joint):
            raise JointNotFoundError(joint, f"{mjcf.path}: <actuator>", list(model.names)[1:])
        if model.joints[model.getJointId(joint)].nv > 1:
            _logger.warning("%s: actuator '%s' drives a ball or free joint and is ignored", mjcf.path, name)
        else:
            drives.append(Command(name, joint, "m" if _slides(model, joint) else "rad"))
    return tuple(drives)


def _slides(model: pin.Model, joint: str) -> bool:
    return bool(model.joints[model.getJointId(joint)].shortname().startswith("JointModelP"))
