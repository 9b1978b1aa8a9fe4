"""The engine of a robot: everything computed for it, and for its copies, is computed by that engine."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.dynamics.batch import actuator_forces
from pm3dof_pin.kinematics import reference
from pm3dof_pin.kinematics.pose_search import waypoint_lattice
from pm3dof_pin.maps.grid_map import quantity_map
from pm3dof_pin.maps.quantity import MappedRobot
from pm3dof_pin.programs.llvm import Compiled


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


def test_the_reference_tries_a_waypoint_from_every_neighbour(monkeypatch: pytest.MonkeyPatch) -> None:
    """A corner next to home is reached along one axis only, from the second of the two neighbours that are nearer."""
    robot = pm.load("pm3dof")
    joints = robot.command_coordinates[:2]
    home = robot.read(joints, robot.home.q)
    axes = list(waypoint_lattice(robot, joints, home).axes.values())
    k, m = (int(np.abs(axis - value).argmin()) for axis, value in zip(axes, home, strict=True))
    corner, only = (axes[0][k + 1], axes[1][m + 1]), (axes[0][k], axes[1][m + 1])

    def to(walk: reference._Walk, target: np.ndarray) -> np.ndarray:
        blocked = tuple(target) == corner and tuple(walk._start[:2]) != only
        return np.full(robot.model.nq, np.nan) if blocked else np.resize(target, robot.model.nq)

    monkeypatch.setattr(reference._Walk, "to", to)
    values, _ = reference.Reference(robot, joints).lattice
    assert corner in set(map(tuple, values))
    assert len(values) == len(axes[0]) * len(axes[1])
