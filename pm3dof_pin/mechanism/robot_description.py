"""The content of a robot's files, in any supported format, as arguments of a mechanism."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pinocchio as pin

from pm3dof_pin.description.closures import ClosuresFile, read_closures
from pm3dof_pin.description.robots import RobotFiles
from pm3dof_pin.mechanism.model_files import UNLIMITED, read_model, read_named_configurations

_logger = logging.getLogger(__name__)


def read_description(files: RobotFiles, tool_frame: str | None = None) -> dict[str, Any]:
    """Read all files of a robot into the arguments of :class:`~pm3dof_pin.mechanism.mechanism.Mechanism`.

    `tool_frame` replaces the tool frame of the description if given.

    Raises:
        DescriptionError: a file is unreadable or malformed.
        JointNotFoundError: the closures file names a joint that the tree does not have.
    """
    closures_file = read_closures(files.closures) if files.closures is not None else ClosuresFile(files.path)
    if files.format == "mjcf":
        from pm3dof_pin.mechanism.mjcf_model import read_mjcf_model  # few robots need it

        model, closures_file = read_mjcf_model(files, closures_file)
    else:
        model = read_model(files.urdf, joint_types=closures_file.joint_types, source=files.source)
    _free_joints_without_limits(model, closures_file.actuated_joints, files.path)
    if files.srdf is not None:
        read_named_configurations(model, files.srdf)
    arguments = vars(closures_file) | {
        "tool_frame": tool_frame or closures_file.tool_frame,
        "model": model,
        "files": files,
    }
    return {name: value for name, value in arguments.items() if name not in ("path", "joint_types")}


def _free_joints_without_limits(model: pin.Model, actuated_joints: Sequence[str], path: Path) -> None:
    """Treat limits 0 .. 0 of all actuated joints as not given."""
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit
    joints = list(zip(model.names, model.joints, strict=True))[1:]
    single = {name: joint.idx_q for name, joint in joints if joint.nq == joint.nv == 1}
    blocked = {name for name, index in single.items() if lower[index] == upper[index] == 0.0}
    if blocked and blocked >= (set(actuated_joints) & single.keys() or single.keys()):
        _logger.warning(
            "%s: limits 0 .. 0 of %d joints, including all actuated ones, are treated as not given", path, len(blocked)
        )
        for name in blocked:
            lower[single[name]], upper[single[name]] = -UNLIMITED, UNLIMITED
