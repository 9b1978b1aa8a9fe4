"""HAL lines that set up LinuxCNC's own kinematics of hexapods."""

from __future__ import annotations

import itertools

import numpy as np

from pm3dof_pin.export.template import one_line
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.tolerances import SAME
from pm3dof_pin.typing import Matrix, Vector

_POSES, _SEED = 12, 1


def genhexkins_hal(robot: Robot) -> str | None:
    """Return HAL lines for LinuxCNC's own genhexkins, if the robot is a hexapod with straight struts."""
    if len(robot.commands) != 6 or len(robot.coordinates) != 6 or robot.tool_frame is None:
        return None
    found = _struts(robot)
    if found is None:
        return None
    base, platform, offsets = found
    lines = [
        f"# {one_line(robot.name)} in LinuxCNC's own genhexkins: KINEMATICS = genhexkins, and these lines in its HAL",
        "# file [mm].",
        "# Its joints are lengths of the struts: the commands here plus "
        + ", ".join(f"{1e3 * o:.9f}" for o in offsets),
        "# Its angles are those of R = Rz(C) Ry(B) Rx(A), not of R = Rx(A) Ry(B) Rz(C).",
        "# Its first forward call ignores the pose before, and may find another assembly: home first.",
    ]
    for k, (fixed, moving) in enumerate(zip(base, platform, strict=True)):
        for word, point in (("base", fixed), ("platform", moving)):
            lines += [f"setp genhexkins.{word}.{k}.{c} {1e3 * p:.12f}" for c, p in zip("xyz", point, strict=True)]
    return "\n".join([*lines, ""])


def _struts(robot: Robot) -> tuple[Matrix, Matrix, Vector] | None:
    """Return points of the base, of the platform relative to the tool, and what to add to commands for lengths [m].

    None unless lengths between such points are the commands up to constants, at random poses.
    """
    home, model, drives = robot.home, robot.model, [robot.single_joint(c.joint) for c in robot.commands]
    tool = home.tool_placement
    supports = {
        name: list(model.supports[model.frames[robot.frame_id(name)].parentJoint])
        for loop in robot.closures
        for name in (loop.frame_a, loop.frame_b)
    }
    base, platform = [], []
    for drive in drives:
        index = model.getJointId(drive.name)
        ends = [
            (leg, other)
            for loop in robot.closures
            for leg, other in itertools.permutations((loop.frame_a, loop.frame_b))
            if index in supports[leg] and index not in supports[other]
        ]
        if len(ends) != 1:
            return None
        leg, other = ends[0]
        first = next(joint for joint in supports[leg] if joint != 0)
        base.append(np.array(model.jointPlacements[first].translation))
        platform.append(np.array(tool.actInv(home.frame_placement(other).translation)))
    fixed, moving = np.array(base), np.array(platform)
    poses = reachable_poses(robot, _POSES, np.random.default_rng(_SEED))
    points = np.einsum("nij,kj->nki", poses.rotations, moving) + poses.positions[:, None]
    scales = np.array([c.scale for c in robot.commands])
    extra = np.linalg.norm(points - fixed, axis=-1) - poses.commands * np.sign(scales)
    if np.ptp(extra, axis=0).max() > SAME or (scales < 0.0).any():
        return None
    return fixed, moving, extra.mean(axis=0)
