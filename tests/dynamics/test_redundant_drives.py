"""Forces, masses and motions of more drives than degrees of freedom, against their null spaces."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.dynamics.batch import drive_mass_matrices
from pm3dof_pin.dynamics.traced import of_drives
from pm3dof_pin.kinematics.degrees_of_freedom import DegreesOfFreedom
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "benchmarks"))
from families import Drawing, legs, walker

PRECISION = 1e-9
BAR, BASE = 0.3, 0.5  # lengths [m]


@pytest.mark.parametrize(("draw", "size"), [(legs, 8), (walker, 6)])
def test_redundant_drives_against_their_null_space(draw: Callable[[int], Drawing], size: int, tmp_path: Path) -> None:
    """Least motions at the drives are the pseudo-inverse of the rates of the motions that singular values find."""
    robot = Robot.load(draw(size).write(tmp_path))
    poses = reachable_poses(robot, 4, np.random.default_rng(0))
    holding = of_drives("holding_forces", robot, robot.model, poses.q)
    mass = of_drives("mass_matrix", robot, robot.model, poses.q)
    moved = of_drives("drive_motions", robot, robot.model, poses.q)
    data = robot.model.createData()
    for k, q in enumerate(poses.q):
        dof = DegreesOfFreedom(Configuration(robot, q))
        rates = dof.actuators @ dof.basis
        motions = dof.scale[:, None] * (dof.basis @ np.linalg.pinv(rates)) / dof.scale[robot.actuated_indices]
        upper = np.triu(pin.crba(robot.model, data, q))
        masses = upper + np.triu(upper, 1).T
        expected = [
            motions.T @ pin.computeGeneralizedGravity(robot.model, data, q),
            (motions.T @ masses @ motions).ravel(),
            np.vstack([motions, Configuration(robot, q).tool_jacobian @ motions]).ravel(),
        ]
        for (values, sound), own in zip((holding, mass, moved), expected, strict=True):
            assert sound[k]
            np.testing.assert_allclose(values[k].ravel(), own, atol=PRECISION * np.abs(own).max())


def test_no_pose_of_many_legs_is_wrong_or_in_doubt(tmp_path: Path) -> None:
    """Joints of some legs would be a basis that is nearly singular at one of a hundred poses, the platform's is not."""
    robot = Robot.load(legs(12).write(tmp_path))
    poses = reachable_poses(robot, 500, np.random.default_rng(0))
    masses, sound = of_drives("mass_matrix", robot, robot.model, poses.q)
    own = drive_mass_matrices(robot, poses, engine="pinocchio").reshape(masses.shape)
    assert sound.all()
    assert (np.abs(masses - own).max(axis=1) <= 1e-3 * PRECISION * np.abs(own).max(axis=1)).all()


def _five_bar() -> Robot:
    """Two chains of two bars in a plane that meet; all four joints are driven."""
    model, bar = pin.Model(), pin.SE3(np.eye(3), np.array([BAR, 0.0, 0.0]))
    for side, x in (("a", 0.0), ("b", BASE)):
        placement, parent = pin.SE3(np.eye(3), np.array([x, 0.0, 0.0])), 0
        for number in (1, 2):
            parent = model.addJoint(parent, pin.JointModelRZ(), placement, f"{side}{number}")
            model.appendBodyToJoint(parent, pin.Inertia(1.0, np.array([0.5 * BAR, 0.0, 0.0]), 0.01 * np.eye(3)), bar)
            placement = bar
        model.addFrame(pin.Frame(f"{side}_end", parent, 0, bar, pin.FrameType.OP_FRAME))
    model.referenceConfigurations["home"] = _closed(0.9)
    names = ["a1", "a2", "b1", "b2"]
    return Robot(model, [LoopClosure("a_end", "b_end", "3d")], actuated_joints=names, tool_frame="a_end")


def _closed(elbow: float) -> np.ndarray:
    """Joint angles with a given one at the elbow of the second chain, whose foot is far along the x axis."""
    shoulder = 2.2
    ends = np.exp(1j * shoulder) * BAR * (1.0 + np.exp(1j * elbow)) + BASE
    half = np.arccos(0.5 * abs(ends) / BAR)
    return np.array([np.angle(ends) + half, -2.0 * half, shoulder, elbow])


def test_a_basis_that_is_singular_at_a_pose_is_in_doubt_there() -> None:
    """Where a chain is stretched its joints do not place its end, but do place the machine with those of the other."""
    robot = _five_bar()
    q = np.array([_closed(elbow) for elbow in (*np.geomspace(2e-5, 1e-2, 25), *np.linspace(0.1, 1.2, 50))])
    masses, sound = of_drives("mass_matrix", robot, robot.model, q)
    data = robot.model.createData()
    for values, is_sound, pose in zip(masses, sound, q, strict=True):
        dof = DegreesOfFreedom(Configuration(robot, pose))
        motions = dof.basis @ np.linalg.pinv(dof.basis)
        mass = np.triu(pin.crba(robot.model, data, pose))
        own = motions.T @ (mass + np.triu(mass, 1).T) @ motions
        assert not is_sound or np.abs(values - own.ravel()).max() <= PRECISION * np.abs(own).max()
    assert sound[25:].all()
    assert not sound[0]
