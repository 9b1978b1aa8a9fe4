"""The engine of a robot: everything computed for it, and for its copies, is computed by that engine."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.dynamics.batch import actuator_forces
from pm3dof_pin.kinematics import reference
from pm3dof_pin.kinematics.pose_search import waypoints
from pm3dof_pin.maps.grid_map import quantity_map
from pm3dof_pin.maps.quantity import MappedRobot
from pm3dof_pin.programs.llvm import Compiled

FIVE_BAR = Path(__file__).parents[1] / "machines" / "five_bar"


@pytest.fixture
def no_programs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every compiled program fail that is run."""

    def refuse(self: Compiled, *arguments: object, **options: object) -> None:
        raise AssertionError("a compiled program ran")

    monkeypatch.setattr(Compiled, "_run", refuse)


@pytest.mark.usefixtures("no_programs")
def test_nothing_of_a_robot_on_pinocchio_runs_a_program() -> None:
    named = pm.load("pm3dof", engine="pinocchio")
    copies = (named, pickle.loads(pickle.dumps(named)), named.replace(), named.displaced(named.model))
    for robot in (*copies, pm.load("pm3dof").with_engine("pinocchio")):
        assert robot.engine == "pinocchio"
        grid = robot.grid(theta_x=(-0.01, 0.01, 6), z_e=(0.5, 0.51, 7))  # enough poses for a program
        poses = robot.solve(grid)
        assert np.isfinite(pm.compliance(robot, poses)).all()
        assert np.isfinite(actuator_forces(robot, poses)).all()
        assert np.isfinite(robot.forward(poses.commands).transforms).all()
        errors = pm.GeometricErrors(robot, pm.GeometricErrors.load("pm3dof").parameters)
        assert np.isfinite(pm.error_map(errors, poses.reshape(-1)).tip_rms).all()
        assert np.isfinite(quantity_map(MappedRobot(robot), grid, ["compliance"])["compliance"]).all()


@pytest.mark.usefixtures("no_programs")
def test_the_usual_engine_is_the_program() -> None:
    robot = pm.load("pm3dof")
    with pytest.raises(AssertionError, match="a compiled program ran"):
        robot.solve(np.tile(robot.home_coordinates, (40, 1)))
    assert robot.solve(np.tile(robot.home_coordinates, (40, 1)), engine="pinocchio").solved.all()


def test_waypoints_are_tried_from_every_neighbour() -> None:
    """A lattice point two cells from home that only one of its neighbours leads to, and one that none leads to."""
    robot = pm.load("pm3dof")
    joints = robot.command_coordinates[:2]
    every, _ = waypoints(robot, joints, robot.home.q, lambda starts, targets: np.resize(targets, starts.shape))
    axes = [np.unique(axis) for axis in every.T]
    home = robot.read(joints, robot.home.q)
    k, m = (int(np.abs(axis - value).argmin()) for axis, value in zip(axes, home, strict=True))
    far, only, closed = (axes[0][k + 2], axes[1][m]), (axes[0][k + 3], axes[1][m]), (axes[0][0], axes[1][0])

    def walk(starts: np.ndarray, targets: np.ndarray) -> np.ndarray:
        q = np.full(starts.shape, np.nan)
        for row, (start, target) in enumerate(zip(starts, targets, strict=True)):
            if tuple(target) != closed and (tuple(target) != far or tuple(start[:2]) == only):
                q[row, :2], q[row, 2:] = target, 0.0
        return q

    values, q = waypoints(robot, joints, robot.home.q, walk)
    assert set(map(tuple, every)) - set(map(tuple, values)) == {closed}
    np.testing.assert_array_equal(q[:, :2], values)


def test_both_engines_have_the_same_waypoints() -> None:
    """By which way a waypoint is reached decides between poses of one branch with the same commands."""
    robot = pm.load(FIVE_BAR)
    joints = robot.command_coordinates
    solver = robot.continuation(joints)
    assert solver is not None
    values, q = solver.lattice
    expected, poses = reference.Reference(robot, joints).lattice
    assert len(values) > 800
    np.testing.assert_array_equal(values, expected)
    np.testing.assert_allclose(q, poses, rtol=0.0, atol=1e-9)
