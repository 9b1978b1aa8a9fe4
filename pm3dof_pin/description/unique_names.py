"""Names of joints that bodies and frames have too, as is usual in MJCF, and SDFormat refuses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import msgspec

from pm3dof_pin.description.description import Description
from pm3dof_pin.description.readers.elements import free_name


def shared_joint_names(description: Description) -> dict[str, str]:
    """Return unused names for the joints whose names a body or a frame has, by their names."""
    taken = {part.name for parts in (description.bodies, description.frames) for part in parts}
    shared = [joint.name for joint in description.joints if joint.name in taken]
    taken |= {joint.name for joint in description.joints}
    return {name: free_name(f"{name}_joint", taken) for name in shared}


def with_joint_names(description: Description, names: Mapping[str, str]) -> Description:
    """Return a description with other names of joints.

    Frames of closures, tools and springs keep theirs: a name that a body has as well as a joint means the body.
    """

    def new(name: str) -> str:
        return names.get(name, name)

    def renamed(spring: Mapping[str, Any]) -> dict[str, Any]:
        entry = dict(spring)
        if "joint" in entry:
            entry["joint"] = new(entry["joint"])
        if isinstance(length := entry.get("length"), Mapping):
            entry["length"] = dict(length) | {"joint": new(length["joint"])}
        return entry

    return replace(
        description,
        joints=tuple(replace(joint, name=new(joint.name)) for joint in description.joints),
        couplings=tuple(
            replace(coupling, joint=new(coupling.joint), joints=tuple(map(new, coupling.joints)))
            for coupling in description.couplings
        ),
        drives=tuple(replace(drive, joint=new(drive.joint)) for drive in description.drives),
        actuated_joints=tuple(map(new, description.actuated_joints)),
        commands=tuple(msgspec.structs.replace(command, joint=new(command.joint)) for command in description.commands),
        motion_coordinates=tuple(map(new, description.motion_coordinates)),
        coordinates=tuple(
            coordinate if coordinate.joint is None else replace(coordinate, joint=new(coordinate.joint))
            for coordinate in description.coordinates
        ),
        limit_groups=tuple(replace(group, joints=tuple(map(new, group.joints))) for group in description.limit_groups),
        springs=tuple(map(renamed, description.springs)),
        configurations={
            name: {new(joint): numbers for joint, numbers in values.items()}
            for name, values in description.configurations.items()
        },
    )
