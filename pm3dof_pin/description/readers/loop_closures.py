"""`loop_closures.yaml` of scikit-robot: hinges that close the loops of a URDF next to it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.description.description import Description, Frame, Placement, Unread
from pm3dof_pin.description.origin import Origin
from pm3dof_pin.description.readers.elements import free_name
from pm3dof_pin.description.schema import Length, Name, Schema, checked
from pm3dof_pin.description.yaml_file import read_mapping

FILE_NAME = "loop_closures.yaml"
"""The name of such files."""


class _Closure(Schema):
    link_a: Name
    link_b: Name
    point: tuple[Length, Length, Length]
    axis: tuple[float, float, float]


class _File(Schema):
    closures: list[_Closure]
    independent: tuple[Name, ...] = ()
    dependent: tuple[Name, ...] = ()


def with_loop_closures(description: Description, path: Path) -> Description:
    """Return a description with the closures of a file.

    Each is a hinge, given by a point and an axis in the root where all joints are at zero; the independent joints are
    the actuated ones.

    Raises:
        DescriptionError: the file is unreadable, an entry is malformed, or a link does not exist.
        JointNotFoundError: an independent joint does not exist.
    """
    data, origin = read_mapping(path), Origin(path)
    known: dict[str, Any] = {key: value for key, value in data.items() if key in _File.__struct_fields__}
    file = checked(known, _File, path)
    frames, closures = list(description.frames), list(description.closures)
    for index, entry in enumerate(file.closures):
        if not any(entry.axis):
            raise origin.error(f"closures[{index}].axis", "expected a direction, not zero")
        names = []
        for key, link in (("link_a", entry.link_a), ("link_b", entry.link_b)):
            if link not in description.body_by_name:
                raise origin.error(f"closures[{index}].{key}", f"expected an existing link, not '{link}'")
            placement = description.zero_placements[link].actInv(_hinge(entry))
            name = free_name(f"closure{index + 1}_{key[-1]}", {*description.body_by_name, *description.joint_by_name})
            frames.append(Frame(name, link, Placement.from_se3(placement), origin))
            names.append(name)
        closures.append(LoopClosure(names[0], names[1], "hinge", origin=origin))
    for name in file.independent:
        description.joint(name, f"{path}: independent")
    unread = tuple(Unread(key, origin, "unknown key") for key in data if key not in known)
    return replace(
        description,
        frames=tuple(frames),
        closures=tuple(closures),
        actuated_joints=file.independent or description.actuated_joints,
        unread=(*description.unread, *unread),
    )


def _hinge(entry: _Closure) -> pin.SE3:
    """Return a frame at a closure's point whose z axis is the hinge's."""
    axis = np.array(entry.axis) / np.linalg.norm(entry.axis)
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis)
    return pin.SE3(turn.toRotationMatrix(), np.array(entry.point))
