"""All that the files of a robot say, whatever they are written in, as a mechanism takes it."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pinocchio as pin

from pm3dof_pin.description.closures import ClosuresFile, LoopClosure, read_closures
from pm3dof_pin.description.coordinates import Command, Coordinate, LimitGroup, ToolComponent
from pm3dof_pin.description.robots import RobotFiles
from pm3dof_pin.mechanism.model_files import UNLIMITED, read_model, read_named_configurations

_logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Description:
    """What the files of a robot say, as the arguments of :class:`~pm3dof_pin.mechanism.mechanism.Mechanism`."""

    model: pin.Model
    closures: tuple[LoopClosure, ...]
    actuated_joints: tuple[str, ...]
    tool_frame: str | None
    motion_coordinates: tuple[str, ...]
    springs: tuple[Mapping[str, Any], ...]
    commands: tuple[Command, ...]
    coordinates: tuple[Coordinate, ...]
    limit_groups: tuple[LimitGroup, ...]
    tool_motions: tuple[ToolComponent, ...]
    files: RobotFiles


def read_description(files: RobotFiles, tool_frame: str | None = None) -> Description:
    """Read all files of a robot, its tool frame another than described if given.

    Raises:
        DescriptionError: a file is unreadable or not of its form.
        JointNotFoundError: the closures file names a joint that the tree does not have.
    """
    said = read_closures(files.closures) if files.closures is not None else ClosuresFile(files.path)
    if files.format == "mjcf":
        from pm3dof_pin.mechanism.mjcf_model import read_mjcf_model  # few robots need it

        model, said = read_mjcf_model(files, said)
    else:
        model = read_model(files.urdf, joint_types=said.joint_types, source=files.source)
    _free_joints_without_limits(model, said.actuated_joints, files.path)
    if files.srdf is not None:
        read_named_configurations(model, files.srdf)
    return Description(
        model=model,
        closures=said.closures,
        actuated_joints=said.actuated_joints,
        tool_frame=tool_frame or said.tool_frame,
        motion_coordinates=said.motion_coordinates,
        springs=said.springs,
        commands=said.commands,
        coordinates=said.coordinates,
        limit_groups=said.limit_groups,
        tool_motions=said.tool_motions,
        files=files,
    )


def _free_joints_without_limits(model: pin.Model, actuated_joints: Sequence[str], path: Path) -> None:
    """Take limits 0 .. 0 for what they mean where every actuated joint has them: that none were given."""
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit
    joints = list(zip(model.names, model.joints, strict=True))[1:]
    single = {name: joint.idx_q for name, joint in joints if joint.nq == joint.nv == 1}
    blocked = {name for name, index in single.items() if lower[index] == upper[index] == 0.0}
    if blocked and blocked >= (set(actuated_joints) & single.keys() or single.keys()):
        _logger.warning(
            "%s: limits 0 .. 0 at %d joints, all actuated ones among them, are taken as none given", path, len(blocked)
        )
        for name in blocked:
            lower[single[name]], upper[single[name]] = -UNLIMITED, UNLIMITED
