"""The 6 x 6 elastic stiffness over the workspace: closed form on all processors against Pinocchio in a Python loop."""

from __future__ import annotations

import os
import resource
import tempfile
import time
from pathlib import Path

import numpy as np
import pinocchio as pin

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.elastic_stiffness import elastic_stiffness
from pm3dof_pin.chapter.kinematics import joint_positions
from pm3dof_pin.chapter.limits import broken_limits
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.atlas import Atlas, AtlasGrid, compute_atlas

BLOCK = 262_144


def closed_form(tripod: Tripod, poses: np.ndarray, workers: int, blocks: int = 40) -> float:
    """Seconds a pose, the result going into one block of memory again and again."""
    out = np.empty((len(poses), 6, 6))
    elastic_stiffness(tripod, poses, unreachable="nan", workers=workers, out=out)
    start = time.perf_counter()
    for _ in range(blocks):
        elastic_stiffness(tripod, poses, unreachable="nan", workers=workers, out=out)
    return (time.perf_counter() - start) / (blocks * len(poses))


def pinocchio_loop(mechanism: Robot, tripod: Tripod, poses: np.ndarray) -> float:
    """Seconds a pose for what Pinocchio has to do: constraint and tool Jacobians, and one KKT solve with NumPy."""
    qs = [mechanism.place_joints(mechanism.home.q, joint_positions(tripod, pose))[0] for pose in poses]
    model, data = mechanism.model, mechanism.model.createData()
    tool = mechanism.tool_frame_id
    frames = [(mechanism.frame_id(loop.frame_a), mechanism.frame_id(loop.frame_b)) for loop in mechanism.closures]
    kkt = np.eye(model.nv + 9)
    right = np.zeros((model.nv + 9, 6))
    start = time.perf_counter()
    for q in qs:
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        rows = [
            pin.getFrameJacobian(model, data, b, pin.LOCAL_WORLD_ALIGNED)[:3]
            - pin.getFrameJacobian(model, data, a, pin.LOCAL_WORLD_ALIGNED)[:3]
            for a, b in frames
        ]
        jacobian = pin.getFrameJacobian(model, data, tool, pin.LOCAL_WORLD_ALIGNED)
        constraint = np.concatenate(rows)
        kkt[model.nv :, : model.nv], kkt[: model.nv, model.nv :] = constraint, constraint.T
        right[: model.nv] = jacobian.T
        jacobian @ np.linalg.solve(kkt, right)[: model.nv]
    return (time.perf_counter() - start) / len(qs)


def main() -> None:
    tripod, mechanism = Tripod.load(), Robot.load("pm3dof")
    generator = np.random.default_rng(0)
    poses = generator.uniform([-0.6, -0.6, 0.41], [0.6, 0.6, 0.56], (BLOCK, 3))
    poses = np.resize(poses[broken_limits(tripod, poses) == 0], (BLOCK, 3))
    cores = os.cpu_count() or 1
    one, all_cores = closed_form(tripod, poses, 1), closed_form(tripod, poses, cores)
    loop = pinocchio_loop(mechanism, tripod, poses[:2000])
    for threads, seconds in ((1, one), (cores, all_cores)):
        rate = 1e-6 / seconds
        print(f"closed form, {threads} threads: {1e6 * seconds:6.3f} us a pose, {rate:5.2f} million poses a second")
    print(f"Pinocchio, Python loop: {1e6 * loop:4.1f} us a pose, {loop / all_cores:.0f} times as long")
    with tempfile.TemporaryDirectory(dir=".") as folder:
        for count in (100, 136, 200, 272):
            path = Path(folder) / "atlas.zarr"
            grid = AtlasGrid.over_workspace(tripod, (count, count, count))
            start = time.perf_counter()
            compute_atlas(Atlas(tripod, grid, ("felt_stiffness",), path))
            seconds = time.perf_counter() - start
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
            print(
                f"atlas on disk, {count**3 / 1e6:5.2f} million poses: {seconds:6.1f} s, "
                f"{1e6 * seconds / count**3:5.2f} us a pose, peak memory {peak:.0f} MiB"
            )


if __name__ == "__main__":
    main()
