"""Overconstrained loops whose equations turn with the pose have no determinant: walks end at singular poses even so.

The machine is of the kind of the Exechon: two legs U-P-R in a plane that turns about a line of the base, a third one
S-P-R beside it. By hand it has four equations for the plane's angle and the platform's place and tilt in the plane, and
their determinant has a sign.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot

X, Y, Z = np.eye(3)


class TwoLegsInAPlane:
    """A machine drawn at random, with the tool in the middle of the platform."""

    def __init__(self, seed: int) -> None:
        draw = np.random.default_rng(seed).uniform
        left, right, out = draw(0.2, 0.4, 3)
        near, far, side = draw(0.08, 0.16, 3)
        depth = draw(0.5, 0.8)
        self.base = np.array([-left * X, right * X, out * Y])
        self.platform = np.array([-near * X, far * X, side * Y])
        self.home = np.array([0.0, 0.0, -depth, 0.0])
        self.lengths = self.equations(self.home[None])[0, :3]
        self.sign = np.sign(self.determinants(self.home[None]))

    def equations(self, x: np.ndarray) -> np.ndarray:
        """Return the lengths of the legs, and what the third one lacks of a right angle to its axis, shape=(n, 4).

        x are angles, places in the plane and tilts of the platform, shape=(n, 4).
        """
        turn = Rotation.from_euler("x", x[:, :1])
        tilted = turn * Rotation.from_euler("y", x[:, 3:])
        middle = turn.apply(x[:, 1:2] * X + x[:, 2:3] * Z)
        legs = [middle + tilted.apply(tip) - base for tip, base in zip(self.platform, self.base, strict=True)]
        angle = np.sum(legs[2] * tilted.apply(X), axis=1)
        return np.column_stack([*(np.linalg.norm(leg, axis=1) for leg in legs), angle])

    def determinants(self, x: np.ndarray) -> np.ndarray:
        rates = [(self.equations(x + s) - self.equations(x - s)) / 2e-6 for s in 1e-6 * np.eye(4)]
        return np.linalg.det(np.stack(rates, axis=1))

    def coordinates(self, transforms: np.ndarray) -> np.ndarray:
        """Return x at placements of the platform, which keeps the plane's normal."""
        R, p = transforms[:, :3, :3], transforms[:, :3, 3]
        angle = np.arctan2(R[:, 2, 1], R[:, 1, 1])
        height = np.cos(angle) * p[:, 2] - np.sin(angle) * p[:, 1]
        return np.column_stack([angle, p[:, 0], height, np.arctan2(R[:, 0, 2], R[:, 0, 0])])

    def robot(self) -> Robot:
        model, middle = pin.Model(), self.home[2] * Z
        pivots = [
            [pin.JointModelRX(), pin.JointModelRY()],
            [pin.JointModelRX(), pin.JointModelRY()],
            [pin.JointModelSpherical()],
        ]
        ends = []
        for k, (base, tip) in enumerate(zip(self.base, middle + self.platform, strict=True)):
            parent, place = 0, np.zeros(3)
            slide = pin.JointModelPrismaticUnaligned((tip - base) / np.linalg.norm(tip - base))
            for n, joint in enumerate([*pivots[k], slide, pin.JointModelRX() if k == 2 else pin.JointModelRY()]):
                at = tip if n == len(pivots[k]) + 1 else base
                parent = model.addJoint(
                    parent, joint, pin.SE3(np.eye(3), at - place), f"{'drive' if joint is slide else n}{k}"
                )
                place = at
            ends.append(
                model.addFrame(pin.Frame(f"end{k}", parent, pin.SE3(np.eye(3), middle - tip), pin.FrameType.OP_FRAME))
            )
        loops = [LoopClosure("end0", f"end{k}", "6d") for k in (1, 2)]
        return Robot(model, loops, actuated_joints=[f"drive{k}" for k in range(3)], tool_frame="end0")


@pytest.mark.parametrize(
    ("seed", "engine", "count", "size"),
    [(0, "program", 15_000, 0.9), (1, "program", 15_000, 0.9), (1, "pinocchio", 8, 0.15)],
)
def test_no_pose_beyond_a_singular_one(seed: int, engine: str, count: int, size: float) -> None:
    machine = TwoLegsInAPlane(seed)
    commands = np.random.default_rng(seed).uniform(-size, size, (count, 3))
    check(machine, machine.robot().forward(commands, on_failure="nan", engine=engine), commands)


def test_grids_end_there_too() -> None:
    machine = TwoLegsInAPlane(0)
    robot = machine.robot()
    grid = robot.grid(drive0=(-0.5, 0.9, 29), drive1=(-0.5, 0.9, 29), drive2=(-0.5, 0.9, 29))
    check(machine, robot.solve(grid, on_failure="nan"), grid.values)


def check(machine: TwoLegsInAPlane, poses: Poses, commands: np.ndarray) -> None:
    found = poses.solved.ravel()
    assert found.sum() > 3
    x = machine.coordinates(poses.transforms.reshape(-1, 4, 4)[found])
    lengths = np.abs(machine.lengths + commands.reshape(-1, 3)[found])
    np.testing.assert_allclose(machine.equations(x), np.column_stack([lengths, np.zeros(len(x))]), atol=1e-9)
    assert (machine.determinants(x) * machine.sign > -1e-9).all()
