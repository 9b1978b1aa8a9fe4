"""Compliance, holding forces and masses of large robots against dense linear algebra on bare Pinocchio calls.

    python scripts/benchmarks/families_dense.py [FAMILY SIZE ...]

For each robot, the programs' results at random poses are compared with null spaces of the loops' Jacobian by singular
values, relative to the largest entry; then the time of a pose, one thread, with that of Pinocchio's Jacobians and one
dense solution of the conditions of least energy (stiffness, loops' Jacobian and multipliers) in NumPy. Programs are
timed in batches whose results fit into memory that is there: filling new memory takes as long as a short program.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pinocchio as pin
from families import FAMILIES
from timing import least_times

import pm3dof_pin as pm
from pm3dof_pin.dynamics.batch import actuator_forces, drive_mass_matrices

LARGEST = {"legs": 48, "scissor": 32, "four_bars": 32, "stacked": 6, "arm": 60, "walker": 6}
FEW, MANY, BATCH, ROUNDS = 5, 40_000, 500, 3  # many: so that programs are compiled with optimisation
_NO_RATE = 1e-9  # of the greatest singular value


class Dense:
    """A robot's compliance, holding forces and masses by null spaces."""

    def __init__(self, model: pm.ElasticModel) -> None:
        robot = model.rigid
        self.robot, self.data = robot, robot.model.createData()
        self.driven = list(robot.actuated_indices)
        self.stiffness = np.zeros(robot.model.nv)
        for spring in robot.springs:
            self.stiffness[robot.velocity_indices([spring["joint"]])] = spring["stiffness"]

    def jacobians(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the loops' Jacobian, shape=(c, nv), and the tool's, shape=(6, nv)."""
        model, robot = self.robot.model, self.robot
        pin.computeJointJacobians(model, self.data, q)
        pin.updateFramePlacements(model, self.data)
        frame = partial(pin.getFrameJacobian, model, self.data)
        rows = [
            frame(robot.frame_id(c.frame_b), pin.LOCAL_WORLD_ALIGNED)[:3]
            - frame(robot.frame_id(c.frame_a), pin.LOCAL_WORLD_ALIGNED)[:3]
            for c in robot.closures
        ]
        tool = frame(robot.tool_frame_id, pin.LOCAL_WORLD_ALIGNED)
        return np.concatenate([np.zeros((0, model.nv)), *rows]), tool

    def quantities(self, q: np.ndarray) -> dict[str, np.ndarray]:
        """Return compliance, holding forces and masses at a pose, by null spaces."""
        loops, tool = self.jacobians(q)
        _, sizes, right = np.linalg.svd(loops)
        motions = right[np.sum(sizes > _NO_RATE * sizes.max(initial=0.0)) :].T
        energy = np.linalg.pinv(motions.T @ (self.stiffness[:, None] * motions), rcond=_NO_RATE)
        followed = motions @ np.linalg.pinv(motions[self.driven], rcond=_NO_RATE)
        gravity = pin.computeGeneralizedGravity(self.robot.model, self.data, q)
        mass = np.array(pin.crba(self.robot.model, self.data, q))
        mass = np.triu(mass) + np.triu(mass, 1).T
        return {
            "compliance": tool @ motions @ energy @ motions.T @ tool.T,
            "holding forces": followed.T @ gravity,
            "masses": followed.T @ mass @ followed,
        }

    def solve(self, poses: np.ndarray) -> None:
        """Take Pinocchio's Jacobians and solve the conditions of least energy at each pose."""
        nv = self.robot.model.nv
        for q in poses:
            loops, tool = self.jacobians(q)
            matrix = np.zeros((nv + len(loops),) * 2)
            matrix[np.arange(nv), np.arange(nv)] = self.stiffness
            matrix[nv:, :nv], matrix[:nv, nv:] = loops, loops.T
            matrix[np.diag_indices(len(matrix))] -= 1e-9  # of idle motions and redundant closures
            right = np.zeros((len(matrix), 6))
            right[:nv] = tool.T
            tool @ np.linalg.solve(matrix, right)[:nv]


def in_batches(compute: Callable[..., np.ndarray], poses: np.ndarray) -> None:
    for first in range(0, len(poses), BATCH):
        compute(poses[first : first + BATCH], threads=1)


def study(family: str, size: int, folder: Path) -> str:
    model = pm.ElasticModel.load(FAMILIES[family][0](size).write(folder))
    robot, dense = model.rigid, Dense(model)
    poses = pm.reachable_poses(robot, FEW, np.random.default_rng(0)).q
    every = np.tile(poses, (MANY // FEW, 1))
    programs = {
        "compliance": partial(pm.compliance, model),
        "holding forces": partial(actuator_forces, robot),
        "masses": partial(drive_mass_matrices, robot),
    }
    own = [dense.quantities(q) for q in poses]
    words = []
    for name, compute in programs.items():
        expected, found = np.array([each[name] for each in own]), compute(every, threads=1)[:FEW]
        words.append(f"{np.abs(found - expected).max() / np.abs(expected).max():.0e}")
    times = least_times(
        {"dense": partial(dense.solve, poses)}
        | {name: partial(in_batches, compute, every) for name, compute in programs.items()},
        ROUNDS,
    )
    each = {name: seconds / (FEW if name == "dense" else MANY) for name, seconds in times.items()}
    faster = ", ".join(f"{each['dense'] / each[name]:.0f}" for name in programs)
    micro = ", ".join(f"{1e6 * each[name]:.2f}" for name in programs)
    return f"| {family} {size} | {', '.join(words)} | {1e6 * each['dense']:.0f} | {micro} | {faster} |"


def main() -> None:
    words = sys.argv[1:]
    chosen = dict(zip(words[::2], map(int, words[1::2]), strict=True)) or LARGEST
    print("| robot | differences: compliance, forces, masses | dense [µs] | programs [µs] | times faster |")
    print("| --- | --- | --- | --- | --- |")
    for family, size in chosen.items():
        with tempfile.TemporaryDirectory() as folder:
            print(study(family, size, Path(folder) / "robot"), flush=True)


if __name__ == "__main__":
    main()
