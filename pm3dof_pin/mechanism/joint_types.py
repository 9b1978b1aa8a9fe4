"""Replaces joints of a tree by the spherical and universal joints they stand for, which URDF does not have."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import pinocchio as pin

from pm3dof_pin.exceptions import DescriptionError, JointNotFoundError

_AXES = {"X": pin.JointModelRX, "Y": pin.JointModelRY, "Z": pin.JointModelRZ}
_LIMITS_OF_Q = ("lowerPositionLimit", "upperPositionLimit", "positionLimitMargin")
VELOCITY_CONSTANTS = (
    *("lowerEffortLimit", "upperEffortLimit", "lowerVelocityLimit", "upperVelocityLimit"),
    *("lowerDryFrictionLimit", "upperDryFrictionLimit", "damping", "armature", "rotorInertia", "rotorGearRatio"),
)
"""The attributes a model has for each entry of v."""


def with_joint_types(model: pin.Model, joint_types: Mapping[str, str], source: Path | str) -> pin.Model:
    """Return a copy of a model with joints replaced, as the loader of example-parallel-robots does.

    The new joints have the frames of the old ones, and no limits. A universal joint becomes two joints, `name_X` and
    `name_Y` for UJOINT_XY (or any two of the axes); the frame `name` moves with the second. Inertias and frames are
    kept, named configurations are dropped.

    Raises:
        JointNotFoundError: the model has no such joint.
        DescriptionError: the type is unknown.
    """
    for name, kind in joint_types.items():
        if not model.existJointName(name):
            raise JointNotFoundError(name, f"{source}: joint_name", list(model.names)[1:])
        if kind.upper() not in ("SPHERICAL", "FIXED") and not _universal_axes(kind):
            raise DescriptionError(
                source,
                "joint_type",
                f"'{kind}' of '{name}' is unknown, expected SPHERICAL, FIXED or UJOINT_XY (two of X, Y, Z)",
            )
    changed = pin.Model()
    changed.name, changed.gravity = model.name, model.gravity
    carriers = [0]  # by old joint, the new joint that carries its children
    for old in range(1, model.njoints):
        name, kind = model.names[old], joint_types.get(model.names[old], "")
        parent, placement = carriers[model.parents[old]], model.jointPlacements[old]
        if axes := _universal_axes(kind):
            parent = changed.addJoint(parent, _AXES[axes[0]](), placement, f"{name}_{axes[0]}")
            carrier = changed.addJoint(parent, _AXES[axes[1]](), pin.SE3.Identity(), f"{name}_{axes[1]}")
        elif kind.upper() == "SPHERICAL":
            carrier = changed.addJoint(parent, pin.JointModelSpherical(), placement, name)
        else:
            carrier = changed.addJoint(parent, model.joints[old], placement, name)
            _copy_limits(model, old, changed, carrier)
        changed.appendBodyToJoint(carrier, model.inertias[old], pin.SE3.Identity())
        carriers.append(carrier)
    _copy_frames(model, changed, carriers, joint_types)
    fixed = [changed.getJointId(name) for name, kind in joint_types.items() if kind.upper() == "FIXED"]
    return pin.buildReducedModel(changed, fixed, pin.neutral(changed)) if fixed else changed


def _universal_axes(kind: str) -> str:
    found = re.fullmatch(r"UJOINT_([XYZ])(?!\1)([XYZ])", kind.upper())
    return found[1] + found[2] if found else ""


def _copy_limits(model: pin.Model, old: int, changed: pin.Model, new: int) -> None:
    source, target = model.joints[old], changed.joints[new]
    for names, (first, to, count) in (
        (_LIMITS_OF_Q, (source.idx_q, target.idx_q, source.nq)),
        (VELOCITY_CONSTANTS, (source.idx_v, target.idx_v, source.nv)),
    ):
        for name in names:
            getattr(changed, name)[to : to + count] = getattr(model, name)[first : first + count]


def _copy_frames(model: pin.Model, changed: pin.Model, carriers: list[int], joint_types: Mapping[str, str]) -> None:
    indices = [0]
    for frame in list(model.frames)[1:]:
        parent, kind = indices[frame.parentFrame], frame.type
        if kind == pin.FrameType.JOINT and (axes := _universal_axes(joint_types.get(frame.name, ""))):
            kind = pin.FrameType.OP_FRAME
            for axis in axes:
                joint = changed.getJointId(f"{frame.name}_{axis}")
                parent = changed.addFrame(
                    pin.Frame(f"{frame.name}_{axis}", joint, parent, pin.SE3.Identity(), pin.FrameType.JOINT), False
                )
        copy = pin.Frame(frame.name, carriers[frame.parentJoint], parent, frame.placement, kind, frame.inertia)
        indices.append(changed.addFrame(copy, False))
